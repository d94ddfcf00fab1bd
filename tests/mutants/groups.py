"""Groups of sources, the tests that have to notice their changes, and what these import."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tests.mutants.changes import Mutant, mutants


@dataclass(frozen=True, slots=True)
class Group:
    """Sources that are changed, and the tests that are to notice it, best ones first.

    `imported`: packages that no change touches, imported once for all mutants.
    """

    sources: tuple[str, ...]
    tests: tuple[str, ...]
    imported: tuple[str, ...] = ()

    def files(self, root: Path) -> list[Path]:
        """The sources, by name."""
        return sorted(path for pattern in self.sources for path in root.glob(pattern))

    def mutants(self, root: Path) -> list[Mutant]:
        """All mutants of the sources in the checkout `root`."""
        return [mutant for file in self.files(root) for mutant in mutants(file, root)]


_BRIDGE = ("native", "can", "safety", "faults", "drives", "replay", "deployment", "node", "vcan")
GROUPS = {
    "bridge": Group(
        ("bridge/c/*.c", "bridge/c/*.h"),
        tuple(f"tests/bridge/{room}" for room in _BRIDGE),
        ("bridge", "fmus"),
    ),
    "bus": Group(
        ("cosim/c/bus/*.c", "cosim/c/bus/*.h"),
        ("tests/cosim/bus", "tests/cosim/scenario/test_bus_ticks.py"),
        ("cosim", "fmus"),
    ),
    "engine": Group(
        ("cosim/c/*.c", "cosim/c/*.h", "cosim/c/engine/*.c"),
        (
            "tests/cosim/engine",
            "tests/cosim/algorithms",
            "tests/cosim/fmi",
            "tests/cosim/mujoco",
            "tests/system",
            "tests/cosim/study/test_batch.py",
            "tests/cosim/links/test_drawing.py",
        ),
        ("cosim", "fmus"),
    ),
    "replay": Group(("bridge/replay/*.py",), ("tests/bridge/replay",), ("cosim", "fmus")),
    "wiring": Group(
        ("bridge/wiring/*.py",),
        tuple(f"tests/bridge/{room}" for room in ("wiring", "replay", "node", "native", "drives")),
        ("cosim", "fmus"),
    ),
    "links": Group(("cosim/links/*.py", "cosim/links/*/*.py"), ("tests/cosim/links",)),
    "firmware": Group(
        ("fmus/firmware/*.py", "bridge/firmware/*.py"),
        ("tests/fmus/firmware", "tests/fmus/test_cli.py", "tests/bridge/firmware"),
        ("cosim", "bridge"),
    ),
    "kernels": Group(
        ("fmus/c/*.c", "fmus/c/*.h"),
        ("tests/fmus", "tests/cosim/fmi", "tests/ssp"),
        ("cosim", "fmus"),
    ),
}
