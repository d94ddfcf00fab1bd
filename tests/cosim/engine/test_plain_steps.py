"""Steps of FMUs that are called through FMI only, and follow each other in one loop."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.component import Port
from cosim.base.errors import RunError
from cosim.engine.engine import Engine
from cosim.fmi import layout
from cosim.native.enums import Code, UnitKind
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from cosim.schedule.plan import Plan
from tests.cosim.fmi.exporter import VARIABLE, export, strict2, strict3
from tests.cosim.scenarios import plan

#: What is called in which loop.
FORMS = {
    UnitKind.FMI2: strict2(),
    UnitKind.FMI3: strict3(),
    UnitKind.DIRECT: strict3('hasEventMode="true"'),
}
#: Of x' = gain x, in steps of 0.1 s from 1 on: the third one leaves the range of numbers.
GAIN = 1e150


def four(folder: Path, text: str, bad: int) -> Plan:
    """x0 to x3, of which one leaves the range of numbers."""
    path = export(text, folder / "x.fmu")
    components: dict[str, Any] = {
        f"x{i}": {
            "model": str(path),
            "parameters": {"gain": GAIN if i == bad else 2.0},
            "inputs": {"u": f"x{i}.y"},
        }
        for i in range(4)
    }
    document = {"run": {"step": 0.1, "stop": 3.0}, "components": components}
    return assemble(build(document, folder / "s.toml"))


@pytest.mark.parametrize("kind", FORMS, ids=lambda kind: kind.name)
@pytest.mark.parametrize("bad", [0, 1, 3])
def test_a_value_that_is_not_finite_ends_the_run_at_its_step(
    tmp_path: Path, kind: UnitKind, bad: int
) -> None:
    """FMUs before it have made the step, FMUs behind it have not."""
    p = four(tmp_path, FORMS[kind], bad)
    rows = np.full((p.ticks, p.n_signals), np.nan)
    with Engine(p) as engine:
        engine.initialize()
        with pytest.raises(RunError, match=rf"x{bad}: .*y.* at tick 2 \(t = 0.2 s\)"):
            engine.run(p.ticks, rows)
        steps = [op for op in engine.bound.operations if op["code"] == Code.STEP]
        assert [int(op["count"]) for op in steps] == [3, 2, 1, 0]
        assert {unit.plain for unit in engine.bound.units} == {kind}
        assert engine.tick == 2 and engine.rows == 3
        assert np.isfinite(rows[:3]).all() and np.isnan(rows[3:]).all()
        for i in set(range(4)) - {bad}:
            y = engine.signals[p.slots()[f"x{i}.y"].start]
            assert y == pytest.approx(1.2 ** (3 if i < bad else 2))


def events(flags: str) -> str:
    """The FMU of ``events3.c`` with its time events only."""
    outputs = "".join(
        f'<Float64 name="{name}" valueReference="{13 + i}" causality="output"/>'
        for i, name in enumerate(("bells", "integral", "calls"))
    )
    return f"""<fmiModelDescription fmiVersion="3.0" modelName="events" instantiationToken="t">
<CoSimulation modelIdentifier="events3" {flags}/><ModelVariables>{outputs}
<Float64 name="half" valueReference="20" causality="parameter" variability="fixed" start="0"/>
</ModelVariables><ModelStructure/></fmiModelDescription>"""


@pytest.mark.parametrize("half", [0.0, 1.0])
@pytest.mark.parametrize(
    "flags",
    [f'{VARIABLE} hasEventMode="true"', 'hasEventMode="true"',
     f'{VARIABLE} hasEventMode="true" canReturnEarlyAfterIntermediateUpdate="true"',
     f'{VARIABLE} canReturnEarlyAfterIntermediateUpdate="true"'],
)  # fmt: skip
@pytest.mark.parametrize("step", [0.0625, 0.25, 0.7])
def test_events_and_early_returns_are_those_of_other_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, half: float, flags: str, step: float
) -> None:
    """Time events every 0.3 s and, with `half`, steps of which every other call does one half."""
    path = export(events(flags), tmp_path / "x.fmu")
    component = {"model": str(path), "parameters": {"half": half}}
    document = {
        "run": {"step": step, "stop": 60 * step},
        "components": {"a": component, "b": component},
    }

    def ran(direct: bool) -> tuple[bytes, int]:
        p = assemble(build(document, tmp_path / "s.toml"))
        rows = np.empty((p.ticks, p.n_signals))
        with Engine(p) as engine:
            engine.initialize()
            assert {unit.direct for unit in engine.bound.units} == {direct}
            engine.run(p.ticks, rows)
            integral = engine.signals[p.slots()["b.integral"].start]
            assert integral == pytest.approx(60 * step)
            return rows.tobytes() + engine.signals.tobytes(), int(engine.signals[2])

    fast, calls = ran(True)
    monkeypatch.setattr(layout, "_is_direct", lambda _: False)
    assert ran(False) == (fast, calls)
    assert calls >= 60


class Numbers:
    """Sampled: y = the numbers given."""

    kind = "sampled"
    inputs: tuple[Port, ...] = ()
    outputs: tuple[Port, ...] = ()
    parameters = ()
    numbers = np.zeros(1)

    def initialize(self, values: object) -> None:
        """Do nothing: there is nothing to start."""

    def initial(self, u: object) -> dict[str, np.ndarray]:
        return {p.name: np.zeros(p.shape) for p in self.outputs}

    def step(self, t: float, h: float, u: object) -> dict[str, np.ndarray]:
        return {p.name: self.numbers for p in self.outputs}


class Sink(Numbers):
    """Sampled: takes numbers."""


HERE = "tests.cosim.engine.test_plain_steps"


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 6, 7, 8, 9, 13, 31, 32, 33, 40])
def test_each_of_many_numbers_is_moved_and_tested(monkeypatch: pytest.MonkeyPatch, n: int) -> None:
    """Numbers are moved and tested in blocks that overlap; more than 32 are copied by a call."""
    monkeypatch.setattr(Numbers, "outputs", (Port("y", (n,)),))
    monkeypatch.setattr(Sink, "outputs", ())
    monkeypatch.setattr(Sink, "inputs", (Port("u", (n,)),))
    numbers = np.arange(1.0, n + 1.0) * np.where(np.arange(n) % 2, -1.0, 1.0)
    numbers[-1] = -np.finfo(float).max
    components = {
        "a": {"model": f"{HERE}:Sink", "inputs": {"u": "b.y"}},
        "b": {"model": f"{HERE}:Numbers"},
        "c": {"model": f"{HERE}:Sink"},
    }

    def step() -> np.ndarray:
        with Engine(plan(components)) as engine:
            engine.initialize()
            engine.run(2)
            return engine.signals.copy()

    monkeypatch.setattr(Numbers, "numbers", numbers)
    assert np.array_equal(step(), np.r_[numbers, numbers, np.zeros(n)])
    for i in range(n):
        for value in (np.nan, np.inf, -np.inf)[: 3 if i == n - 1 else 1]:
            monkeypatch.setattr(Numbers, "numbers", np.where(np.arange(n) == i, value, numbers))
            with pytest.raises(RunError, match=r"b: .*at tick 0"):
                step()
