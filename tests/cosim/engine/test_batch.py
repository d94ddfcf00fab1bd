"""Engines that run together, by themselves for a while, and together again: each as it is alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack

import numpy as np
import pytest

from cosim.base.errors import RunError
from cosim.engine.batch import run_many
from cosim.engine.engine import Engine
from cosim.schedule.plan import Plan
from tests.cosim.oracle import execute
from tests.cosim.scenarios import plan
from tests.system import runs

TICKS = 36
Started = Callable[..., list[Engine]]


def made(gain: float, **wide: float) -> Plan:
    """Components that step each, each second, third and fourth tick, and a link."""
    components = {
        "plant": {"model": "Integrator", "inputs": {"u": "control.y"}, "start": {"x": 1.0}},
        "control": {"model": "Gain", "parameters": {"gain": gain}, "inputs": {"u": "plant.y"}},
        "second": {"model": "Gain", "period": 0.5, "inputs": {"u": "plant.y"}},
        "wide": {"model": "Wide", "period": 0.75, "parameters": wide},
        "clock": {"model": "Clock", "period": 1.0},
        "far": {"model": "Gain", "period": 0.5},
    }
    delay = {"law": "uniform", "low": 0.5, "high": 3.0, "hold": 0.75}
    links = [{"from": "second.y", "to": "far.u", "delay": delay, "semantics": "last-arrival"}]
    return plan(components, links, stop=TICKS / 4)


@pytest.fixture
def started() -> Iterator[Started]:
    """Engines of plans, at their start; they are closed at the end of the test."""
    with ExitStack() as stack:

        def call(*plans: Plan) -> list[Engine]:
            engines = [stack.enter_context(Engine(p)) for p in plans]
            for engine in engines:
                engine.initialize()
            return engines

        yield call


def room(engines: Sequence[Engine], ticks: int) -> list[np.ndarray]:
    """(signals, ticks) each, with a column that nothing may write."""
    return [np.full((e.plan.n_signals, ticks + 1), -7.0) for e in engines]


@pytest.mark.parametrize("alone", [(4, 5), (5, 7), (0, 1), (11, 2), (6, 6)])
def test_each_is_what_it_is_by_itself_whoever_ran_it_before(
    started: Started, alone: tuple[int, int]
) -> None:
    """Ticks together do not move what is due next in any engine but the first one."""
    gains = (-0.8, -0.3, 0.2)
    engines = started(*map(made, gains))
    found: list[list[np.ndarray]] = [[] for _ in engines]
    for first in alone:
        for engine, rows in zip(engines, found, strict=True):
            record = np.empty((first, engine.plan.n_signals))
            assert engine.run(first, record) == first
            rows.append(record)
        records = room(engines, 7)
        assert run_many(engines, 7, records, 1) == [None] * 3
        assert all((record[:, 7] == -7.0).all() for record in records)
        for rows, record in zip(found, records, strict=True):
            rows.append(record[:, :7].T)
    for gain, engine, rows in zip(gains, engines, found, strict=True):
        rest = np.empty((TICKS - engine.tick, engine.plan.n_signals))
        engine.run(len(rest), rest)
        whole = np.concatenate([*rows, rest, engine.signals[np.newaxis]])
        assert whole.tobytes() == execute(made(gain)).tobytes()


@pytest.mark.parametrize("fails", [(0,), (1,), (2,), (0, 2), (0, 1, 2)])
@pytest.mark.parametrize("how", [0, 3])
def test_who_fails_is_left_out_and_the_others_go_on(
    started: Started, fails: tuple[int, ...], how: int
) -> None:
    def plans() -> list[Plan]:
        ends = [{"fail_at": 3.0 + 0.75 * k, "how": how} if k in fails else {} for k in range(3)]
        return [made(-0.1 * k, **end) for k, end in enumerate(ends)]

    engines = started(*plans())
    records = room(engines, TICKS)
    for k, (error, other) in enumerate(
        zip(run_many(engines, TICKS, records, 1), plans(), strict=True)
    ):
        if k not in fails:
            whole = np.append(records[k][:, :TICKS], engines[k].signals[:, np.newaxis], axis=1)
            assert error is None and whole.T.tobytes() == execute(other).tobytes()
            continue
        (alone,) = started(other)
        rows = np.empty((TICKS, other.n_signals))
        with pytest.raises(RunError) as raised:
            alone.run(TICKS, rows)
        assert isinstance(error, RunError) and f"{error}" == f"{raised.value}"
        assert error.tick == engines[k].tick == alone.tick == 12 + 3 * k
        assert engines[k].rows == alone.rows
        assert records[k][:, : alone.rows].T.tobytes() == rows[: alone.rows].tobytes()
        assert (records[k][:, alone.rows :] == -7.0).all()
        assert engines[k].signals.tobytes() == alone.signals.tobytes()


def test_who_is_told_to_stop_does_so_after_its_tick(started: Started) -> None:
    engines = started(*map(made, (-0.8, -0.3, 0.2)))
    records = room(engines, TICKS)
    engines[1].stop()
    assert run_many(engines, 9, records, 1) == [None] * 3
    assert [engine.tick for engine in engines] == [9, 1, 9]
    assert [engine.rows for engine in engines] == [9, 1, 9]
    assert engines[1].ended is None


# ---- FMUs that step several ticks of several engines in a call ---------------------------------

#: rad/s with which an arm leaves the range of numbers in tick 0, 2 and 6.
AT = {0: 1e7, 2: 1.8e3, 6: 1e3}
#: Of each engine the tick in which its arms fail, and which arm is named: the first one of a tick.
FAILS: Sequence[tuple[dict[str, int], str]] = (
    ({}, ""),
    ({"slave": 6}, "slave"),
    ({"slave": 0, "master": 2}, "slave"),
    ({"slave": 2, "master": 0}, "master"),
    ({"slave": 2, "master": 2}, "master"),
    ({"master": 6}, "master"),
    ({}, ""),
)


def arms(every: int, fmi: str, number: int) -> Plan:
    document = runs.teleoperation(stop=0.2, seed=number)
    document["run"]["record"] = {"every": every}
    for link in document["links"]:
        link["delay"] |= {"low": "30 ms", "high": "120 ms"}
    document["components"]["master"]["fmi"] = fmi
    for name, tick in FAILS[number][0].items():
        document["components"][name].setdefault("start", {})["dq"] = [AT[tick], 0.0]
    return runs.plan(document)


@pytest.mark.parametrize("every", [1, 5, 10])
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_steps_at_once_are_steps_one_by_one(started: Started, every: int, fmi: str) -> None:
    """Calls end between ticks that are run as one. The first arm that fails is named, in its tick;
    arms of two FMUs are stepped in two calls.
    """
    numbers = list(range(len(FAILS)))
    engines, left = started(*(arms(every, fmi, k) for k in numbers)), list(numbers)
    failed: dict[int, BaseException | None] = {}
    rows: list[list[np.ndarray]] = [[] for _ in engines]
    for ticks in (4, 19, 1, 36):
        records = room([engines[k] for k in left], ticks)
        found = run_many([engines[k] for k in left], ticks, records, every)
        for k, record, error in zip(left, records, found, strict=True):
            rows[k].append(record[:, : engines[k].rows].T)
            failed[k] = error
        left = [k for k in left if failed[k] is None]
    for k in numbers:
        (alone,) = started(arms(every, fmi, k))
        expected = np.empty((60, alone.plan.n_signals))
        fails, name = FAILS[k]
        if fails:
            with pytest.raises(RunError) as raised:
                alone.run(60, expected)
            assert f"{failed[k]}" == f"{raised.value}"
            assert (raised.value.component, raised.value.tick) == (name, min(fails.values()))
        else:
            alone.run(60, expected)
            assert failed[k] is None and engines[k].signals.tobytes() == alone.signals.tobytes()
        assert engines[k].tick == alone.tick
        kept = np.concatenate(rows[k])
        assert kept.tobytes() == expected[: alone.rows : every].tobytes()
