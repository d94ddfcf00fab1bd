"""Buses that are simulated inside the ticks: as ahead where both apply; bits that are signals."""

import struct

import numpy as np
import pytest

from cosim.base.component import Port
from cosim.base.errors import CosimError
from cosim.bus.settings import FrameEncoding
from cosim.bus.timing import frame_bits
from cosim.engine.engine import Engine
from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.record import Run
from cosim.scenario.assemble import assemble
from cosim.scenario.recorded import with_recorded_links
from tests.cosim.blocks import Gain


class Wave(Gain):
    """Sampled: two values that change all the time."""

    inputs = ()
    outputs = (Port("y", (2,)),)

    def initial(self, u):
        return {"y": np.zeros(2)}

    def step(self, t, h, u):
        return {"y": np.array([np.sin(700 * t), -40000 * t])}


class Hold(Gain):
    """Sampled: receives two values."""

    inputs = (Port("u", (2,)),)
    outputs = ()

    def initial(self, u):
        return {}

    def step(self, t, h, u):
        return {}


SCENARIO = """
title = "Links on a bus"
[run]
step = "1 ms"
stop = "1 s"
[components.plant]
model = "tests.cosim.blocks:Integrator"
[components.a]
model = "tests.cosim.blocks:Gain"
period = "2 ms"
[components.b]
model = "tests.cosim.blocks:Gain"
[components.a.inputs]
u = "plant.y"
[bus.can0]
bitrate = 250e3
simulated = "SIMULATED"
BUS
[[links]]
name = "urgent"
from = "a.y"
to = "plant.u"
bus = "can0"
frame = { id = 0x301, bytes = 8, DATA }
[[links]]
name = "other"
from = "plant.y"
to = "b.u"
bus = "can0"
frame = { id = 0x102, bytes = 8, offset = "2.3 ms", DATA }
"""
LOAD = '[[bus.can0.traffic]]\nkind = "random"\nshare = 0.4\n'
NOISE = '[[bus.can0.errors]]\nkind = "rate"\nrate = 3e-4\n'
OFF = """[[bus.can0.errors]]
kind = "interruption"
start = 0.2
stop = 0.4
node = "a"
level = "inverted"
"""
FIFO = '[bus.can0.nodes.plant]\nqueue = "fifo"\nlength = 3\n'
MAILBOXES = '[bus.can0.nodes.a]\nqueue = "mailboxes"\nlength = 1\n'
BABBLER = """[[bus.can0.traffic]]
kind = "babbling"
id = 1
start = 0.3
stop = 0.35
"""
SCRIPT = """[[bus.can0.errors]]
kind = "script"
id = 0x301
bit = 30
attempt = 7
"""
OWN = '[[bus.can0.traffic]]\nkind = "periodic"\nid = 0x50\nperiod = "5 ms"\nnode = "plant"\n'


def tables_of(tmp_path, bus="", data='data = "zeros"', simulated="auto", chunk=1000, **put):
    """The tables of a run, (rows,) each, and its last signals."""
    text = SCENARIO.replace("BUS", bus).replace("DATA", data).replace("SIMULATED", simulated)
    for old, new in put.items():
        text = text.replace(old, new)
    path = tmp_path / "bus.toml"
    path.write_text(text)
    plan = assemble(load(path))
    kept = {link.name: [] for link in plan.links}

    def keep(held):
        for rows, part in zip(kept.values(), held.parts(), strict=True):
            rows.append(part)

    with Engine(plan, keep) as engine:
        engine.initialize()
        while engine.tick < plan.ticks:
            engine.run(min(chunk, plan.ticks - engine.tick))
        last = engine.signals.copy()
    return {name: np.concatenate(rows) for name, rows in kept.items()}, last, plan


@pytest.mark.parametrize(
    "bus",
    ["", LOAD, LOAD + NOISE, FIFO + OWN + LOAD, OFF + NOISE, MAILBOXES + BABBLER + SCRIPT],
    ids=range(6),
)
@pytest.mark.parametrize("data", ['data = "zeros"', 'data = "random"'])
def test_known_frames_give_the_same_bytes_in_the_tick_as_ahead_of_the_run(tmp_path, bus, data):
    ahead, signals, plan = tables_of(tmp_path, bus, data)
    assert not plan.buses
    within, same, plan = tables_of(tmp_path, bus, data, "in-tick", chunk=37)
    assert [b.name for b in plan.buses] == ["can0"]
    for name, rows in ahead.items():
        assert len(rows) == 1000
        assert (np.diff(rows) != 0).sum() > 50
        assert within[name].tobytes() == rows.tobytes()
    assert same.tobytes() == signals.tobytes()


def test_fd_frames_give_the_same_bytes_in_the_tick_as_ahead_of_the_run(tmp_path):
    """At a data bit rate of 2 Mbit/s, with errors."""
    fd = {
        "bitrate = 250e3": "bitrate = 250e3\nfd = true\ndata_bitrate = 2e6",
        "bytes = 8": "bytes = 48, fd = true",
    }
    ahead, signals, _ = tables_of(tmp_path, LOAD + NOISE, 'data = "random"', **fd)
    within, same, plan = tables_of(tmp_path, LOAD + NOISE, 'data = "random"', "in-tick", **fd)
    assert plan.buses
    for name, rows in ahead.items():
        assert within[name].tobytes() == rows.tobytes()
    assert same.tobytes() == signals.tobytes()


@pytest.mark.parametrize("bus", [LOAD, FIFO + OWN + LOAD, NOISE], ids=range(3))
def test_signals_that_are_zero_give_the_same_bytes_as_zeros_ahead_of_the_run(tmp_path, bus):
    """The values are encoded in the tick; the state of the plant is zero as its input is."""
    ahead, _, _ = tables_of(tmp_path, bus)
    encoded, _, plan = tables_of(tmp_path, bus, 'data = "float64"')
    assert plan.buses
    for name, rows in ahead.items():
        assert encoded[name].tobytes() == rows.tobytes()
    facts = {link.name: link.table.facts()["delay"] for link in plan.links}
    assert facts["urgent"]["computed"] == "in the tick"
    assert facts["urgent"]["data"] == "float64"


@pytest.mark.parametrize("node", ["plant", "a"])
def test_requests_of_one_time_stay_in_the_order_of_the_frames(tmp_path, node):
    """Of one FIFO node, at a tick in which a receiver may come before the sender."""
    bus, at_once = (FIFO + OWN).replace("plant", node), {"2.3 ms": "0 ms"}
    ahead, _, _ = tables_of(tmp_path, bus, **at_once)
    encoded, _, plan = tables_of(tmp_path, bus, 'data = "float64"', **at_once)
    assert plan.buses
    for name, rows in ahead.items():
        assert encoded[name].tobytes() == rows.tobytes()


@pytest.mark.parametrize("name", ["first", "zeros"])
@pytest.mark.parametrize("data", ["zeros", "float64"])
def test_frames_of_one_fifo_and_one_time_stay_in_the_order_of_their_links(tmp_path, name, data):
    """Two of links from one component, its values in one or in both, before or behind the other."""
    third = f"""[components.c]
model = "tests.cosim.blocks:Gain"
[[links]]
name = "{name}"
from = "plant.y"
to = "c.u"
bus = "can0"
frame = {{ id = 0x90, bytes = 8, data = "zeros" }}
"""
    put = {"2.3 ms": "0 ms", 'name = "urgent"': 'name = "nobody"'}
    ahead, _, _ = tables_of(tmp_path, FIFO + OWN + third, **put)
    third = third.replace('zeros" }', data + '" }')
    encoded, _, plan = tables_of(tmp_path, FIFO + OWN + third, 'data = "float64"', **put)
    assert plan.buses and len(ahead) == 3
    for link, rows in ahead.items():
        assert encoded[link].tobytes() == rows.tobytes()


WAVE = """
title = "Bits that are signals"
[run]
step = "1 us"
stop = "40 ms"
[components.wave]
model = "tests.cosim.scenario.test_bus_ticks:Wave"
period = "1 ms"
[components.hold]
model = "tests.cosim.scenario.test_bus_ticks:Hold"
[bus.can0]
bitrate = 250e3
fd = true
[[links]]
name = "link"
from = "wave.y"
to = "hold.u"
bus = "can0"
frame = { id = 0x123, bytes = 16, fd = true, FRAME }
"""
#: Struct format and scale of each encoding.
FORMATS = {"float32": ("f", 1), "float64": ("d", 1), "int16": ("h", 0.02), "int32": ("i", 1e-6)}


def wave_plan(tmp_path, frame, **put):
    path = tmp_path / "wave.toml"
    text = WAVE.replace("FRAME", frame)
    for old, new in put.items():
        text = text.replace(old.replace("_", " "), new)
    path.write_text(text)
    loaded = load(path)
    return loaded, assemble(loaded)


@pytest.mark.parametrize("encoding", FORMATS)
def test_each_frame_takes_the_time_of_its_very_bits(tmp_path, encoding):
    """A tick of 1 us and bits of 4 us: the row of the table shows every stuff bit."""
    kind, scale = FORMATS[encoding]
    _, plan = wave_plan(tmp_path, f'data = "{encoding}", scale = {scale}')
    rows = []
    with Engine(plan, lambda found: rows.append(found.rows)) as engine:
        engine.initialize()
        engine.run(plan.ticks)
    held = np.concatenate(rows)
    lengths = set()
    for k in range(39):
        values = np.array([np.sin(700 * (1000 * k * 1e-6)), -40000 * (1000 * k * 1e-6)])
        if kind in "hi":
            limit = 2 ** (8 * struct.calcsize(kind) - 1)
            values = [int(np.clip(round(v / scale), -limit, limit - 1)) for v in values]
        data = struct.pack(f"<2{kind}", *values).ljust(16, b"\0")
        bits = frame_bits(0x123, data, fd_format()).nominal
        assert np.argmax(held == k) == 1000 * k + 4 * (bits - 3)
        lengths.add(int(bits))
    assert len(lengths) > 2
    assert FrameEncoding[encoding.upper()].size == struct.calcsize(kind)


def fd_format():
    from cosim.bus.timing import FrameFormat

    return FrameFormat(fd=True)


def test_a_run_stores_its_tables_and_another_run_can_use_them(tmp_path):
    loaded, plan = wave_plan(tmp_path, 'data = "float64"')
    outcome = simulate(loaded, tmp_path / "run", plan=plan)
    facts = Run.open(tmp_path / "run").metadata["links"]["link"]["delay"]
    assert (facts["computed"], facts["data"]) == ("in the tick", "float64")
    assert outcome.ages["link"].rows == plan.ticks
    again = with_recorded_links(plan, tmp_path / "run")
    assert not again.buses
    assert not again.gates
    stored = again.links[0].table.stream().rows(plan.ticks)
    fresh = []
    with Engine(plan, lambda found: fresh.append(found.rows)) as engine:
        engine.initialize()
        engine.run(plan.ticks)
    assert np.concatenate(fresh).tobytes() == stored.tobytes()


@pytest.mark.parametrize(
    ("frame", "put", "said"),
    [
        ('data = "float64"', {"bytes = 16": "bytes = 12"}, "found 12 bytes, expected 16 for 2"),
        ('data = "int16"', {"fd = true\n[[": 'fd = true\nsimulated = "ahead"\n[['}, "values in"),
        (
            'data = "int16"',
            {'name = "link"': 'name = "link"\nsemantics = "fifo"'},
            "semantics fifo",
        ),
        (
            'data = "int16"',
            {'name = "link"': 'name = "link"\nsemantics = "queue"\ndepth = 4'},
            "semantics queue on a bus that is simulated in the tick, expected newest-stamp",
        ),
        ('data = "int16", scale = 0', {}, "scale"),
    ],
)
def test_what_cannot_be_is_refused_with_a_sentence(tmp_path, frame, put, said):
    with pytest.raises(CosimError, match=said):
        wave_plan(tmp_path, frame, **put)
