"""Engine: what happens when a component fails, chunks do not show, links keep their promises."""

import threading
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import RunError, ScenarioError
from cosim.engine import tables
from cosim.engine.engine import Engine
from cosim.fmi.alike import CommonInstance
from cosim.loading.files import load
from cosim.scenario.assemble import assemble
from tests.bridge.zenoh.rehearsed import CONFIGS
from tests.cosim import blocks
from tests.cosim.oracle import execute
from tests.cosim.scenarios import plan

LOOP = {
    "plant": {"model": "Integrator", "inputs": {"u": "control.y"}, "start": {"x": 1.0}},
    "control": {"model": "Gain", "parameters": {"gain": -0.8}, "inputs": {"u": "plant.y"}},
    "other": {"model": "Gain", "period": 0.5},
    "wide": {"model": "Wide", "period": 1.5},
}
LINKS = [
    {
        "from": "control.y",
        "to": "other.u",
        "delay": {"law": "uniform", "low": 0.5, "high": 3.0, "hold": 0.75},
        "semantics": "last-arrival",
    }
]


def chunks(p, sizes):
    """Record a plan, run in chunks of the given sizes (the last one takes the rest)."""
    record = np.empty((p.ticks + 1, p.n_signals))
    with Engine(p) as engine:
        engine.initialize()
        for n in (*sizes, p.ticks):
            first = engine.tick
            engine.run(min(n, p.ticks - first), record[first:])
        record[p.ticks] = engine.signals
    return record


@given(st.lists(st.integers(1, 17), max_size=12))
def test_chunks_do_not_show(sizes):
    assert (
        chunks(plan(LOOP, LINKS, stop=40.0), sizes).tobytes()
        == chunks(plan(LOOP, LINKS, stop=40.0), []).tobytes()
    )


DELAYS = st.one_of(
    st.builds(lambda d: {"law": "constant", "delay": d / 8}, st.integers(0, 40)),
    st.builds(
        lambda low, more, hold: {"law": "uniform", "low": low, "high": low + more, "hold": hold},
        st.floats(0.25, 2.0),
        st.floats(0.0, 4.0),
        st.sampled_from([0.25, 0.5, 0.8]),
    ),
)


@given(
    DELAYS,
    st.sampled_from(["signal", "last-arrival", "newest-stamp", "fifo"]),
    st.integers(1, 4),
    st.integers(1, 4),
    st.sampled_from(["sampled", "jacobi"]),
)
def test_links_of_any_kind_equal_the_oracle(delay, semantics, sender, receiver, algorithm):
    components = {
        "plant": {"model": "Integrator", "inputs": {"u": "b.y"}, "start": {"x": 1.0}},
        "a": {"model": "Gain", "period": 0.25 * sender, "inputs": {"u": "plant.y"}},
        "b": {"model": "Gain", "period": 0.25 * receiver, "parameters": {"gain": -0.3}},
    }
    link = {"from": "a.y", "to": "b.u", "delay": delay, "semantics": semantics}
    args = {"stop": 30.0, "algorithm": algorithm, "seed": 4}
    one, two = (plan(components, [link], **args) for _ in range(2))
    assert chunks(one, [7, 1, 40]).tobytes() == execute(two).tobytes()


def test_the_pre_history_is_the_senders_start_or_what_is_given():
    components = {
        "plant": {"model": "Integrator", "start": {"x": 5.0}},
        "b": {"model": "Gain"},
    }
    link = {"from": "plant.y", "to": "b.u", "delay": {"law": "constant", "delay": 1.0}}
    for extra, value in (({}, 5.0), ({"initial": -2.0}, -2.0)):
        p = plan(components, [{**link, **extra}])
        record = chunks(p, [])
        held = record[:, p.slots()["b.u"].start]
        assert held[:4].tolist() == [value] * 4
        assert held[5] == 5.0


@pytest.mark.parametrize("semantics", ["signal", "newest-stamp"])
def test_the_age_of_what_is_held_is_a_signal(semantics):
    components = {
        "clock": {"model": "Clock", "period": 0.5},
        "late": {"model": "Pair"},
    }
    link = {
        "from": "clock.y[0]",
        "to": "late.u",
        "age": "late.age",
        "delay": {"law": "uniform", "low": 0.5, "high": 3.0, "hold": 1.0},
        "semantics": semantics,
    }
    args = {"stop": 50.0, "seed": 3}
    p = plan(components, [link], **args)
    record = chunks(p, [11])
    assert record.tobytes() == execute(plan(components, [link], **args)).tobytes()
    t = 0.25 * np.arange(p.ticks)
    sent, age = (record[:-1, p.slots()[name].start] for name in ("late.u", "late.age"))
    arrived = sent >= 0  # the clock sends its own time; before that, its start value -1
    assert arrived.any() and not arrived.all()
    assert age[arrived] == pytest.approx((t - sent)[arrived])
    assert age[~arrived] == pytest.approx(t[~arrived])


def test_links_of_one_channel_share_their_delays():
    components = {"a": {"model": "Gain"}, "b": {"model": "Gain"}, "c": {"model": "Gain"}}
    law = {"law": "uniform", "low": 0.25, "high": 5.0}
    tables = {}
    for channel in ({}, {"channel": "there"}):
        links = [{"from": "a.y", "to": f"{x}.u", "delay": law, **channel} for x in "bc"]
        p = plan(components, links)
        tables[bool(channel)] = [x.table.stream().rows(99).tolist() for x in p.links]
    assert tables[True][0] == tables[True][1]
    assert tables[False][0] != tables[False][1]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", range(6))
def test_a_value_that_is_not_finite_is_found_at_any_place(monkeypatch, place, value):
    def step(self, t, h, u):
        y = np.full(6, -np.finfo(float).max)
        y[place] = value
        return {"y": y.reshape(2, 3)}

    monkeypatch.setattr(blocks.Wide, "step", step)
    with Engine(plan({"wide": {"model": "Wide"}})) as engine:
        engine.initialize()
        with pytest.raises(RunError, match=rf"y\[{place // 3},{place % 3}\] = {value}"):
            engine.run(1)


@pytest.mark.parametrize(
    ("how", "message"),
    [
        (0, "ZeroDivisionError: one over nothing"),
        (1, "returned no 'y'"),
        (2, "could not broadcast"),
        (3, "not a finite number: wide.y[1,2] = nan"),
    ],
)
def test_a_failing_component_is_named_with_tick_and_time(how, message):
    p = plan({"wide": {"model": "Wide", "parameters": {"fail_at": 1.0, "how": how}}})
    record = np.full((p.ticks + 1, p.n_signals), 7.0)
    with Engine(p) as engine:
        engine.initialize()
        with pytest.raises(RunError) as error:
            engine.run(p.ticks, record)
        assert engine.rows == 4  # ticks 0 to 3 are kept
    assert message in str(error.value)
    assert str(error.value).startswith("wide: ")
    assert str(error.value).endswith("at tick 4 (t = 1 s)")
    assert (error.value.component, error.value.tick, error.value.time) == ("wide", 4, 1.0)


def test_an_interrupt_passes_through():
    p = plan(LOOP)

    def interrupt(t, h, u):
        raise KeyboardInterrupt

    p.component("control").component.step = interrupt
    with Engine(p) as engine, pytest.raises(KeyboardInterrupt):
        engine.initialize()
        engine.run(1)


def test_stop_is_obeyed_between_ticks():
    p = plan(LOOP)
    with Engine(p) as engine:
        engine.initialize()
        control = p.component("control").component
        step = control.step

        def step_and_stop(t, h, u):
            if t >= 1.0:
                engine.stop()
            return step(t, h, u)

        control.step = step_and_stop
        engine.run(p.ticks)
        assert engine.tick == 5


def test_inputs_cannot_be_written_by_a_component():
    p = plan(LOOP)

    def spoil(t, h, u):
        u["u"][...] = 3.0
        return {"y": 0.0}

    p.component("control").component.step = spoil
    with Engine(p) as engine, pytest.raises(RunError, match="read-only"):
        engine.initialize()
        engine.run(1)


NETWORK = {
    "one": {"model": "Gain", "period": 0.5},
    "two": {"model": "Gain"},
    "none": {"model": "Gain"},
}
RING = {"graphs": "ring", "dwell": 0.75}


def network(weights, **topology):
    return {"topology": {**RING, **topology, "weights": weights}}


def test_weights_of_a_switching_graph_feed_inputs():
    weights = {"one.u": [2, 1], "two.u": [5, 4], "none.u": [1, 5]}
    args = {"stop": 60.0, "seed": 2}
    one, two = (plan(NETWORK, extra=network(weights), **args) for _ in range(2))
    record = chunks(one, [3, 50])
    assert record.tobytes() == execute(two).tobytes()
    w = {name: record[:-1, one.slots()[f"{name}.u"].start] for name in NETWORK}
    # (2, 1) and (5, 4) are edges of the same graph of three; (1, 5) is of none.
    assert w["none"].max() == 0.0
    assert set(w["two"]) == {0.0, 1.0}
    assert 0.15 < w["two"].mean() < 0.55
    switches = np.flatnonzero(np.diff(w["two"])) + 1
    assert (switches % 3 == 0).all()  # every 0.75 s at most
    assert (w["one"][::2] == w["two"][::2]).all()  # looked at every 0.5 s


@pytest.mark.parametrize(
    ("weights", "extra", "message"),
    [
        ({"two.u": [2, 7]}, {}, "at topology.weights.two.u: there is no robot 7; expected 1 to 6"),
        ({"two.v": [2, 1]}, {}, "no input of two 'v'"),
        ({"two.u": [2]}, {}, "at topology.weights"),
        ({"two.u": [2, 1]}, {"graphs": "star"}, "at topology: graphs = 'star'"),
        ({"two.u": [2, 1]}, {"dwell": -1}, "at topology: dwell"),
        ({"two.u": [2, 1]}, {"gap": 1}, "no key 'gap'"),
    ],
)
def test_a_wrong_topology_is_refused_with_its_place(weights, extra, message):
    with pytest.raises(ScenarioError) as error:
        plan(NETWORK, extra=network(weights, **extra))
    assert message in str(error.value)


@pytest.mark.parametrize("wrong", [1000, -8])
def test_a_table_that_names_a_sample_which_the_link_does_not_hold_stops_the_run(wrong, monkeypatch):
    """One that was not sent yet, or so long ago that it is forgotten."""
    monkeypatch.setattr("cosim.engine.tables.LONGEST", 1)  # no tables beyond each call
    p = plan(LOOP, [{**LINKS[0], "delay": {"law": "constant", "delay": 0.5}}], stop=40.0)
    with Engine(p) as engine:
        engine.initialize()
        engine.run(40)
        real = engine._tables._drawn

        def drawn(tick, ticks):
            found = real(tick, ticks)
            found.links.rows[:] += wrong
            return found

        engine._tables._drawn = drawn
        with pytest.raises(RunError, match=r"link control.y->other.u.*: no such sample at tick 4"):
            engine.run(40)


@pytest.mark.parametrize("many", [1, 100])
def test_tables_that_are_drawn_ahead_are_the_same(many, monkeypatch):
    """In a thread, a stretch before they are needed; and in calls of other lengths."""

    def rows():
        p = assemble(load(CONFIGS / "many.toml", ("graphs.net.n=5", "run.stop=0.9")))
        found, kept = np.empty((900, p.n_signals)), [[] for _ in p.links]

        def keep(held):
            for rows, part in zip(kept, held.parts(), strict=True):
                rows.extend(part.tolist())

        with Engine(p, keep) as engine:
            engine.initialize()
            for first, last in pairwise((0, 7, 300, 301, 900)):
                assert engine.run(last - first, found[first:last]) == last - first
        return found.tobytes(), kept

    expected = rows()
    monkeypatch.setattr(tables, "MANY", many)
    monkeypatch.setattr(tables, "STRETCH", 40)
    monkeypatch.setattr(tables, "LONGEST", 40)
    assert rows() == expected
    assert not [t for t in threading.enumerate() if t.name == "link tables"]


def test_what_fails_while_tables_are_drawn_ahead_stops_the_run(monkeypatch):
    monkeypatch.setattr(tables, "MANY", 1)
    monkeypatch.setattr(tables, "STRETCH", 40)
    monkeypatch.setattr(tables, "LONGEST", 40)
    p = plan(LOOP, [{**LINKS[0], "delay": {"law": "constant", "delay": 0.5}}], stop=100.0)
    calls = iter(range(100))

    def fails(self, rows, firsts, counts):
        if next(calls) == 1:
            raise RunError("no more rows")
        rows[:] = 0

    monkeypatch.setattr("cosim.links.drawing.TableDrawing.fill", fails)
    with Engine(p) as engine:
        engine.initialize()
        engine.run(40)
        with pytest.raises(RunError, match="no more rows"):
            engine.run(1)


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_our_own_fmus_give_the_same_bytes_without_their_further_functions(monkeypatch, fmi):
    """Values that are open between steps, and steps of several instances, save calls only."""

    def rows():
        version = (f"components.robot.fmi='{fmi}'", f"components.control.fmi='{fmi}'")
        p = assemble(load(CONFIGS / "many.toml", ("graphs.net.n=6", "run.stop=0.9", *version)))
        found = np.empty((900, p.n_signals))
        with Engine(p) as engine:
            engine.initialize()
            engine.run(900, found)
            units = engine._bound.units
            return found.tobytes(), {bool(u.values) for u in units}, any(u.steps for u in units)

    expected, opened, several = rows()
    assert opened == {True} and several
    for name in ("values_address", "steps_function"):
        monkeypatch.setattr(CommonInstance, name, lambda _: 0)
        assert rows()[0] == expected
    assert rows()[1:] == ({False}, False)


def test_what_a_link_sends_is_converted_by_factor_and_offset():
    link = {"from": "hot.y", "to": "read.u", "delay": {"law": "constant", "delay": 0.5}}
    p = plan({"hot": {"model": "Kelvin"}, "read": {"model": "Celsius"}}, [link], stop=4.0)
    record = chunks(p, [])
    start = {slot.name: slot.start for c in p.components for slot in (*c.inputs, *c.outputs)}
    sent, got = record[:, start["hot.y"]], record[:, start["read.y"]]
    np.testing.assert_allclose(got[3:-1], sent[1:-3] - 273.15)  # the last row is of no step
