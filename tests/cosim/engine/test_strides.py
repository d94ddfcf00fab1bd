"""Ticks of parts that are run as one: the rows, signals and failures of tick by tick."""

from __future__ import annotations

from math import gcd

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.errors import RunError
from cosim.engine import binding
from cosim.engine.engine import Engine
from cosim.loading.files import load
from cosim.scenario.assemble import assemble
from cosim.schedule.plan import Plan
from tests.bridge.zenoh.rehearsed import CONFIGS

TICKS = 400
APART = {"least": 2, "alone": 2}
TICK_BY_TICK = {"least": 10**6, "alone": 10**6}


def many(*changes: str) -> Plan:
    return assemble(load(CONFIGS / "many.toml", ("graphs.net.n=9", "run.stop=0.4", *changes)))


def run(
    plan: Plan, cuts: list[int], *, every: int, threads: int, least: int, alone: int
) -> tuple[int, str, int, bytes, bytes]:
    """In calls that end at `cuts`: ticks run as one, the failure, its tick, rows, signals."""
    rows = np.zeros((TICKS, plan.n_signals))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(binding, "LEAST", least)
        patch.setattr(binding, "ALONE", alone)
        with Engine(plan, threads=threads, every=every) as engine:
            engine.initialize()
            stride = engine._team._team.stride if engine._team else 1
            try:
                for first, end in zip([0, *cuts], [*cuts, TICKS], strict=True):
                    assert engine.run(end - first, rows[first:end]) == end - first
                said = ""
            except RunError as error:
                said = str(error)
            kept = rows[: engine.tick : every].tobytes()
            return stride, said, engine.tick, kept, b"" if said else engine.signals.tobytes()


@settings(max_examples=12)
@given(
    threads=st.integers(1, 3), period=st.integers(1, 8), every=st.integers(1, 60),
    low=st.integers(8, 70), cuts=st.sets(st.integers(1, TICKS - 1), max_size=4),
)  # fmt: skip
def test_rows_and_signals_are_those_of_tick_by_tick(
    threads: int, period: int, every: int, low: int, cuts: set[int]
) -> None:
    changes = (f'components.control.period="{period} ms"', f'links.0.delay.low="{low} ms"')
    expected = run(many(*changes), [], every=every, threads=1, **TICK_BY_TICK)
    found = run(many(*changes), sorted(cuts), every=every, threads=threads, **APART)
    assert found[0] == (gcd(every, period) if period > 1 else 1)
    assert found[1:] == expected[1:] and not found[1]


@settings(max_examples=12)
@given(
    threads=st.integers(1, 3), fmi=st.sampled_from(["2.0", "3.0"]), cuts=st.sets(st.integers(1, 9)),
    fast=st.dictionaries(st.integers(1, 9), st.floats(3.0, 7.0), min_size=1, max_size=4),
)  # fmt: skip
def test_the_first_that_fails_is_named_with_its_tick(
    threads: int, fmi: str, cuts: set[int], fast: dict[int, float]
) -> None:
    """Some arms are so fast that they leave the range of numbers, in one of the first ticks."""
    each = ", ".join(f"{i} = {{ start = {{ dq = [{10**x}, 0.0] }} }}" for i, x in fast.items())
    changes = (f"components.robot.each={{ {each} }}", f'components.robot.fmi="{fmi}"')
    expected = run(many(*changes), [], every=20, threads=1, **TICK_BY_TICK)
    found = run(many(*changes), sorted(cuts), every=20, threads=threads, **APART)
    assert found[0] == 5 and found[1:4] == expected[1:4]
    assert "robot" in found[1]


def test_more_ticks_than_a_call_of_an_fmu_makes() -> None:
    """Controllers that step each 100 ms: 64 ticks and 36 are run as one."""
    changes = ('components.control.period="100 ms"', 'links.0.delay.low="300 ms"')
    changes += ('links.0.delay.high="400 ms"',)
    expected = run(many(*changes), [], every=200, threads=1, **TICK_BY_TICK)
    found = run(many(*changes), [130], every=200, threads=2, **APART)
    assert found[0] == 100 and found[1:] == expected[1:]


def test_what_reads_an_arm_in_each_tick_keeps_ticks_apart() -> None:
    """ξ of a component that steps with the arm: nothing is run as one."""
    probe = '{ model = "fmus.models.xi", inputs = { q = "robot1.q", dq = "robot1.dq" } }'
    plan = many(f"components.probe={probe}")
    assert run(plan, [], every=50, threads=2, **APART)[0] == 1
