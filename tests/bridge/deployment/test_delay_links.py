"""Links of a plan as delay lines: every law, loss and semantics gives its table's rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.deployment.latency import DelaySpec, delays_for, zero_delay
from bridge.native import delay as native
from cosim.base.errors import ScenarioError
from cosim.loading import files as scenario
from cosim.scenario.assemble import assemble
from cosim.schedule.parts import Link, Slot, Wire
from tests.cosim.links.queues import QUEUES
from tests.cosim.links.stored import save_table
from tests.cosim.links.tables import table_of

CONFIGS = Path(__file__).parents[3] / "configs"
SOURCE = Slot("a.xi", "a", "xi", 0, (2,), "rad/s")
TARGET = Slot("b.xi_in[0]", "b", "xi_in", 2, (2,), "rad/s")

LAWS = {
    "constant": {"law": "constant", "delay": "17 ms"},
    "zero": {"law": "constant", "delay": 0},
    "uniform": {"law": "uniform", "low": 0.01, "high": 0.2},
    "paper": {"law": "uniform", "low": 0.3, "high": 1.2, "hold": "30 ms"},
    "gamma": {"law": "gamma", "shift": 0.02, "shape": 2, "scale": 0.005, "maximum": 0.2},
    "lognormal": {"law": "lognormal", "shift": 0, "median": 0.01, "sigma": 0.8, "maximum": 0.3},
    "markov": {"law": "markov", "levels": [0.01, 0.06], "dwell": [0.1, 0.05], "step": "10 ms"},
}
LOSSES = {
    "none": None,
    "independent": {"law": "independent", "p": "30 %"},
    "gilbert-elliott": {"law": "gilbert-elliott", "p": 0.05, "r": 0.2, "1-h": 0.9},
    "outage": {"law": "outage", "length": 0.2, "every": 0.7},
}
SEMANTICS = ("signal", "last-arrival", "newest-stamp", "fifo", "playout", "queue")


def link(name="a->b", folder=Path(), **said):
    return Link(name, SOURCE, TARGET, table_of(name=name, folder=folder, **said))


def held(spec, ticks):
    """The rows of a line over a network that takes no time."""
    d, rows, j = spec.line(), [], 0
    for row in range(-(-ticks // spec.look)):
        while j * spec.period <= row * spec.look:
            at = round(j * spec.period * spec.h * 1e9)
            d.put(j, at, at, [float(j), -float(j)])
            j += 1
        rows.append(d.take(row))
        assert rows[-1] < 0 or d.values().tolist() == [rows[-1], -rows[-1]]
    assert d.struct.forgotten == d.struct.ignored == 0
    return rows


@given(
    law=st.sampled_from(sorted(LAWS)),
    loss=st.sampled_from(sorted(LOSSES)),
    semantics=st.sampled_from(SEMANTICS),
    periods=st.tuples(st.integers(1, 7), st.integers(1, 7)),
    h=st.sampled_from([0.001, 0.005, 0.0007, 1 / 300]),
    seed=st.integers(0, 2**40),
    ticks=st.integers(1, 700),
    buffer=st.sampled_from([0.31, 1.21]),
    queue=st.sampled_from(QUEUES),
)
def test_a_link_is_its_table(law, loss, semantics, periods, h, seed, ticks, buffer, queue):
    said = {"delay": LAWS[law], "semantics": semantics, "seed": seed, "h": h}
    if semantics not in ("signal", "fifo"):
        said["loss"] = LOSSES[loss]
    if semantics == "playout":
        said["playout"] = buffer
    if semantics == "queue":
        said |= queue.facts()
    x = link(sender_period=periods[0], receiver_period=periods[1], **said)
    looks = -(-ticks // periods[1])
    assert held(delays_for(x, ticks), ticks) == x.table.stream(looks).rows(looks).tolist()


@settings(max_examples=20)
@given(
    semantics=st.sampled_from(SEMANTICS[:3]),
    periods=st.tuples(st.integers(1, 7), st.integers(1, 7)),
    seed=st.integers(0, 99),
)
def test_a_stored_table_is_played_again(tmp_path_factory, semantics, periods, seed):
    said = {"seed": seed, "h": 0.005, "sender_period": periods[0], "receiver_period": periods[1]}
    loss = None if semantics == "signal" else LOSSES["gilbert-elliott"]
    drawn = link(delay=LAWS["uniform"], loss=loss, semantics=semantics, **said)
    folder = tmp_path_factory.mktemp("table")
    looks = -(-600 // periods[1])
    save_table(folder / "x.parquet", drawn.table, looks)
    stored = link(
        delay={"law": "table", "file": "x.parquet"}, semantics="signal", folder=folder, **said
    )
    expected = drawn.table.stream(looks).rows(looks).tolist()
    assert held(delays_for(stored, 600), 600) == expected


def test_a_measured_trace_is_played_again(tmp_path):
    trace = tmp_path / "wifi.csv"
    trace.write_text(
        "t_send,delay\n" + "".join(f"{k / 100},{0.004 * (k % 7)}\n" for k in range(90))
    )
    x = link(
        delay={"law": "trace", "file": "wifi.csv", "repeat": True},
        semantics="last-arrival",
        folder=tmp_path,
        seed=1,
        h=0.001,
        sender_period=5,
        receiver_period=2,
    )
    assert held(delays_for(x, 2000), 2000) == x.table.stream(1000).rows(1000).tolist()


@pytest.mark.parametrize("name", ["teleoperation", "network"])
def test_links_of_the_scenarios(name):
    plan = assemble(scenario.load(CONFIGS / f"{name}.toml"))
    assert plan.links
    for x in plan.links:
        looks = -(-3000 // x.table.grid.n_r)
        assert held(delays_for(x, 3000), 3000) == x.table.stream(looks).rows(looks).tolist()


def constant(**more):
    said = {"delay": LAWS["paper"], "semantics": "signal", "seed": 0, "h": 0.001}
    return link(**{**said, "sender_period": 5, "receiver_period": 5, **more})


def test_what_a_line_keeps_covers_law_and_margin():
    spec = delays_for(constant(), 1000, margin=2.0)
    assert spec.capacity == 1024  # 1.2 s and 2 s of 5 ms
    assert (spec.width, spec.period, spec.look, spec.h) == (2, 5, 5, 0.001)
    assert len(spec.delays) == 200


def test_a_constant_needs_one_number_however_long_the_run():
    assert len(delays_for(constant(delay=LAWS["constant"]), 10**9).delays) == 1


def test_messages_that_go_every_other_hit_are_a_slower_sender():
    slower = constant(sender_period=10)
    assert held(delays_for(constant(), 3000, every=2), 3000) == (
        slower.table.stream(600).rows(600).tolist()
    )


def test_a_trace_that_is_too_short_is_refused_as_offline(tmp_path):
    (tmp_path / "t.csv").write_text("t_send,delay\n0,0.1\n0.005,0.1\n0.010,0.1\n")
    x = constant(delay={"law": "trace", "file": "t.csv"}, folder=tmp_path)
    with pytest.raises(ScenarioError, match="expected a shorter run"):
        delays_for(x, 1000)


def test_a_table_of_another_kind_is_refused():
    class Foreign:
        grid = constant().table.grid

    with pytest.raises(ScenarioError, match="Foreign has no delay line"):
        delays_for(Link("x", SOURCE, TARGET, Foreign()), 10)


def test_a_wire_holds_the_newest():
    spec = zero_delay(Wire(SOURCE, TARGET), 5, 1, 0.001)
    assert isinstance(spec, DelaySpec) and spec.kind == native.NONE
    assert held(spec, 500) == [r // 5 for r in range(500)]


def test_the_same_seed_draws_the_same_delays():
    a, b = (delays_for(constant(), 5000).delays for _ in range(2))
    assert np.array_equal(a, b)
    assert not np.array_equal(a, delays_for(constant(seed=1), 5000).delays)
