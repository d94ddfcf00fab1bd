"""Runs of the importer over FMUs whose calls are written down, and what they violate."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import pytest

from cosim.base.errors import CosimError
from cosim.engine.engine import Engine
from cosim.fmi import FmuOptions
from tests.cosim.fmi.exporter import plan_of
from tests.fmi import machine2, machine3
from tests.fmi.described import described
from tests.fmi.watch import Call, calls, watched

MACHINES = {"2": machine2, "3": machine3}


def judged(found: list[Call], fmu: Path) -> list[str]:
    """The calls of an FMU that its standard does not allow."""
    known = described(fmu)
    return MACHINES[known.fmi].violations(found, known)


class Watch:
    """An FMU whose calls are recorded: see :mod:`tests.fmi.watch`."""

    def __init__(self, fmu: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.fmu, self.path = fmu, watched(fmu, folder / f"watched-{fmu.name}")
        self._log = folder / f"{fmu.stem}.calls"
        self._log.touch()
        monkeypatch.setenv("FMI_CALLS", str(self._log))

    def calls(self) -> list[Call]:
        """The calls so far."""
        return calls(self._log)

    def violations(self) -> list[str]:
        """Calls that are not allowed; an FMU that was never entered proves nothing."""
        found = self.calls()
        assert any(call.name == "EnterInitializationMode" for call in found)
        return judged(found, self.fmu)


def ran(
    watch: Watch, steps: int = 10, h: float = 0.1, values: dict[str, float] | None = None,
    start: dict[str, float] | None = None, period: int = 1, **options: object,
) -> list[str]:  # fmt: skip
    """The FMU alone for some steps, also one that ends or fails; what is violated."""
    given, begin = ({k: (float(v),) for k, v in (x or {}).items()} for x in (values, start))
    plan = plan_of(
        watch.path,
        steps,
        h,
        given,
        begin,
        FmuOptions(**options),
        period=period,  # type: ignore[arg-type]
    )
    with suppress(CosimError), Engine(plan) as engine:
        engine.initialize()
        engine.run(steps)
    return watch.violations()
