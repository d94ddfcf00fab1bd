"""FMUs in macro steps (``algorithm = "adaptive"``): which calls they get, and how runs end.

``strict2.c`` and ``strict3.c`` write down every call and mark those that the standard does not
allow: a step that does not begin where the FMU is, and a state that is gone back to although the
importer said that it would not be, are such.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.errors import RunError, ScenarioError
from cosim.engine import binding
from cosim.engine.engine import Engine, Termination
from cosim.schedule.plan import Plan
from tests.cosim.algorithms.networks import column, record
from tests.cosim.fmi.exporter import exchange2, exchange3, export, strict2, strict3
from tests.cosim.oracle import execute
from tests.cosim.scenarios import plan

RETURNS, ENDS, EVENT, LONG = 5, 6, 7, 8
DISCARD, ERROR, FATAL = 2, 3, 4
SAVES = {"2.0": 'canGetAndSetFMUstate="true"', "3.0": 'canGetAndSetFMUState="true"'}
BOTH = pytest.mark.parametrize("fmi", ["2.0", "3.0", "3.0 events"])


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("rollback")
    events = f'{SAVES["3.0"]} hasEventMode="true"'
    texts = {
        "2.0": strict2(SAVES["2.0"]), "3.0": strict3(SAVES["3.0"]), "3.0 events": strict3(events),
        "no state": strict2(),
        "2.0 exchange": exchange2(SAVES["2.0"]), "3.0 exchange": exchange3(SAVES["3.0"]),
        "exchange without state": exchange2(),
    }  # fmt: skip
    return {
        name: export(text, folder / f"{name.replace(' ', '')}.fmu") for name, text in texts.items()
    }


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], list[str]]:
    """The calls so far."""
    path = tmp_path / "calls"
    path.touch()
    monkeypatch.setenv("STRICT_CALLS", str(path))
    return lambda: path.read_text().splitlines()


def oscillator(path: Path, **given: Any) -> dict[str, dict[str, Any]]:
    """x' = v, v' = -x, from x = 1 and v = 0, of two FMUs; `given`: parameters of the second one."""
    return {
        "x": {"model": str(path), "parameters": {"gain": 1.0}, "inputs": {"u": "v.y"}},
        "v": {"model": str(path), "parameters": {"gain": 1.0, **given}, "start": {"x": 0.0},
              "inputs": {"u": {"from": "x.y", "gain": -1.0}}},
    }  # fmt: skip


def adaptive(
    components: Mapping[str, Any], tolerance: float = 1e-4, stop: float = 4.0, **settings: Any
) -> Plan:
    given = {"tolerance": tolerance, **settings}
    return plan(components, algorithm="adaptive", adaptive=given, step=0.5, stop=stop)


@BOTH
def test_an_oscillator_of_fmus_is_exact_to_the_tolerance_and_all_calls_are_legal(
    fmus: dict[str, Path], fmi: str, calls: Callable[[], list[str]]
) -> None:
    p = adaptive(oscillator(fmus[fmi]))
    found = column(p, record(p), "x.y")
    t = np.arange(p.ticks + 1) * p.h
    assert found == pytest.approx(np.cos(t), abs=3e-4)
    written = calls()
    assert not [call for call in written if "ILLEGAL" in call or "LEAK" in call]
    names = [call.split()[0] for call in written]
    state = "FMUstate" if fmi == "2.0" else "FMUState"
    steps = int(column(p, record(adaptive(oscillator(fmus[fmi]))), "v.macro_steps").sum())
    rejected = int(column(p, record(adaptive(oscillator(fmus[fmi]))), "v.macro_rejections").sum())
    assert names.count(f"Get{state}") == 2 * steps
    assert names.count(f"Set{state}") == 2 * (steps + 2 * rejected)
    assert names.count("DoStep") == 4 * (steps + rejected)
    assert names.count(f"Free{state}") == 2


@BOTH
def test_fmus_equal_the_oracle_to_the_bit(fmus: dict[str, Path], fmi: str) -> None:
    one, two = (adaptive(oscillator(fmus[fmi])) for _ in range(2))
    assert record(one, [3]).tobytes() == execute(two).tobytes()


@BOTH
def test_a_discarded_trial_step_is_done_again_with_half_the_length(
    fmus: dict[str, Path], fmi: str, calls: Callable[[], list[str]]
) -> None:
    p = adaptive(oscillator(fmus[fmi], how=LONG, when=0.1), tolerance=1.0)
    rows = record(p)
    assert column(p, rows, "v.macro_size")[1:].max() == 0.0625
    assert not [call for call in calls() if "ILLEGAL" in call or "LEAK" in call]


@BOTH
@pytest.mark.parametrize("status", [DISCARD, ERROR, FATAL])
def test_a_failure_in_a_trial_step_ends_the_run(
    fmus: dict[str, Path], fmi: str, status: int, calls: Callable[[], list[str]]
) -> None:
    p = adaptive(oscillator(fmus[fmi], how=RETURNS, when=2.1, status=status))
    rows = np.empty((p.ticks + 1, p.n_signals))
    with Engine(p) as engine:
        engine.initialize()
        with pytest.raises(RunError, match="v: doStep returned") as caught:
            engine.run(p.ticks, rows)
        assert (engine.tick, engine.rows, caught.value.tick) == (4, 5, 4)
    written = calls()
    good = record(adaptive(oscillator(fmus[fmi])))
    assert rows[:5].tobytes() == good[:5].tobytes()
    assert not [call for call in written if "ILLEGAL" in call]
    after = written[max(i for i, call in enumerate(written) if call == "DoStep") :]
    freed = [call for call in after if call.startswith(("Free", "Terminate"))]
    assert bool(freed) == (status != FATAL)


@pytest.mark.parametrize("fmi", ["3.0"])
def test_an_fmu_that_ends_the_simulation_in_a_repeated_step_ends_it_in_one_that_is_kept(
    fmus: dict[str, Path], fmi: str, calls: Callable[[], list[str]]
) -> None:
    p = adaptive(oscillator(fmus[fmi], how=ENDS, when=2.1))
    with Engine(p) as engine:
        engine.initialize()
        rows = np.empty((p.ticks + 1, p.n_signals))
        engine.run(p.ticks, rows)
        assert engine.ended is not None
        assert engine.ended.component == "v"
        assert 2.1 <= engine.ended.time < 2.2
        assert engine.tick == 5
        at_end = engine.signals[p.slots()["x.y"].start]
    assert at_end == pytest.approx(np.cos(engine.ended.time), abs=0.02)
    assert not [call for call in calls() if "ILLEGAL" in call or "LEAK" in call]


def test_an_fmu_of_fmi_2_that_ends_the_simulation_ends_it_before_the_step(
    fmus: dict[str, Path], calls: Callable[[], list[str]]
) -> None:
    p = adaptive(oscillator(fmus["2.0"], how=ENDS, when=2.1))
    with Engine(p) as engine:
        engine.initialize()
        rows = np.empty((p.ticks + 1, p.n_signals))
        assert engine.run(p.ticks, rows) == 5
        assert isinstance(engine.ended, Termination)
        assert engine.ended.component == "v"
        assert engine.tick == 4
    assert not [call for call in calls() if "ILLEGAL" in call]


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("no state", "canGetAndSetFMUstate"),
        ("exchange without state", "canGetAndSetFMUstate"),
    ],
)
def test_fmus_that_cannot_go_back_are_refused_by_name(
    fmus: dict[str, Path], name: str, reason: str
) -> None:
    given = oscillator(fmus["2.0"])
    if name == "no state":
        given["v"]["model"] = str(fmus[name])
    else:
        given["v"] = {"model": str(fmus[name]), "parameters": {"model": 1},
                      "inputs": {"u": "x.y"}}  # fmt: skip
        given["x"]["inputs"]["u"] = "v.x1"
    with pytest.raises(ScenarioError, match=rf"v cannot save its state \({reason}\)"):
        adaptive(given)


def test_an_isolated_fmu_is_refused_by_name(fmus: dict[str, Path]) -> None:
    given = oscillator(fmus["2.0"])
    given["x"]["isolate"] = True
    with pytest.raises(ScenarioError, match="x is in a process of its own"):
        adaptive(given)


@pytest.mark.parametrize("solver", ["rk4", "cvode"])
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_model_exchange_takes_part(
    fmus: dict[str, Path], fmi: str, solver: str, calls: Callable[[], list[str]]
) -> None:
    # x1' = u of the FMU for model exchange, and x' = -x1 of the other one
    given = oscillator(fmus[fmi])
    given["v"] = {
        "model": str(fmus[f"{fmi} exchange"]), "parameters": {"model": 1}, "solver": solver,
        "inputs": {"u": {"from": "x.y", "gain": -1.0}}, "tolerance": 1e-8,
    }  # fmt: skip
    given["x"]["inputs"]["u"] = "v.x1"
    p = adaptive(given)
    rows = record(p)
    t = np.arange(p.ticks + 1) * p.h
    assert column(p, rows, "x.y") == pytest.approx(np.cos(t), abs=3e-4)
    assert column(p, rows, "v.x1") == pytest.approx(-np.sin(t), abs=3e-4)
    assert not [call for call in calls() if "ILLEGAL" in call or "LEAK" in call]


def many(path: Path, links: bool) -> Plan:
    """Eight oscillators, each with macro steps of its own; with `links`, to samplers over links."""
    components: dict[str, Any] = {}
    wired = []
    for i in range(8):
        pair = oscillator(path, rate=0.1 * i)
        for name, spec in pair.items():
            port = spec["inputs"]["u"]
            given = {**port, "from": f"x{i}.y"} if isinstance(port, dict) else f"v{i}.y"
            components[f"{name}{i}"] = {**spec, "inputs": {"u": given}}
        law = {"law": "uniform", "low": 1.0, "high": 2.0}
        wired.append({"from": f"x{i}.y", "to": f"s{i}.u", "delay": law})
        components[f"s{i}"] = {"model": "Gain", "period": 0.5}
    return plan(components, wired if links else (), algorithm="adaptive", step=0.5, stop=20.0,
                adaptive={"tolerance": 1e-3})  # fmt: skip


@pytest.mark.parametrize("links", [True, False])
@pytest.mark.parametrize("threads", [1, 2, 5])
def test_any_number_of_threads_gives_the_same_bytes(
    fmus: dict[str, Path], links: bool, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = many(fmus["3.0"], links)
    monkeypatch.setattr(binding, "LEAST", 2)
    p = many(fmus["3.0"], links)
    rows = np.empty((p.ticks, p.n_signals))
    with Engine(p, threads=threads) as engine:
        engine.initialize()
        engine.run(p.ticks, rows)
        assert engine.shares == (threads > 1)
    assert len(p.groups) == 8
    monkeypatch.setattr(binding, "LEAST", 1000)
    assert rows.tobytes() == record(alone)[:-1].tobytes()
