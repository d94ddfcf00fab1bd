"""Settings that were read from a drive, next to those that profile and deployment expect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bridge.commission.interfaces import StepFinding
from bridge.commission.line_drives import LineDrive


@dataclass(frozen=True)
class Setting:
    """A setting of a drive: what it reads, and what profile and deployment expect."""

    name: str
    found: object
    expected: object

    @property
    def agrees(self) -> bool:
        """Tell if it reads what is expected."""
        if isinstance(self.found, float) and isinstance(self.expected, int | float):
            return abs(self.found - self.expected) <= 1e-3 * abs(self.expected)
        return self.found == self.expected

    def text(self) -> str:
        """``PMAX (21) 12.5``, or also what was expected."""
        said, expected = (
            "no answer" if x is None else f"{x:g}" if isinstance(x, float) else str(x)
            for x in (self.found, self.expected)
        )
        return f"{self.name} {said}" + ("" if self.agrees else f", expected {expected}")


def compared(drive: LineDrive, settings: Sequence[Setting], cure: str) -> StepFinding:
    """A finding on settings that were read."""
    name = f"{drive.name}: settings"
    wrong = [setting for setting in settings if not setting.agrees]
    if wrong:
        return StepFinding(name, "missing", "; ".join(s.text() for s in wrong), cure)
    return StepFinding(name, "good", ", ".join(s.text() for s in settings))
