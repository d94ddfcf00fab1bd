"""The simulated bus against a bus of single bits (wires.py): same events, times and counters."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.bus.frames import BusEvent, BusFrame
from cosim.bus.settings import BusNodeSettings, ErrorRate, Interruption, LineLevel, ScriptedError
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming, FrameFormat
from tests.cosim.bus.wires import Wires

FIELDS = ["time", "kind", "node", "request", "code", "tec", "rec", "bit", "role"]
NOMINAL, DATA = 2_000_000, 500_000
TIMING = BusTiming(500e3, 2e6, fd=True)


def frame(random: np.random.Generator, names: int) -> BusFrame:
    extended, fd, brs, remote = (bool(x) for x in random.integers(0, 2, 4))
    remote = remote and not fd and random.random() < 0.3
    fd = fd and random.random() < 0.5
    name = int(random.integers(0, names)) << (18 if extended and random.random() < 0.5 else 0)
    size = int(random.integers(0, 9)) if not fd else int(random.choice([0, 3, 8, 12, 20]))
    content = bytes(random.choice([0x00, 0xFF, 0x0F, 0x55, 0x1F], size).tolist())
    kind = FrameFormat(extended, fd, fd and brs, remote)
    return BusFrame(name, b"" if remote else content, kind, size if remote else 0)


def disturbances(random: np.random.Generator, end: int, nodes: int, per_frame: float, names: int):
    """Short inversions at random times, scripted bits, and a few longer interruptions."""
    count = random.poisson(per_frame * end / (110 * NOMINAL))
    for at in np.sort(random.integers(0, end, count)).tolist():
        node = None if random.random() < 0.5 else int(random.integers(0, nodes))
        length = int(random.choice([1, 1, 1, 6, 30])) * NOMINAL
        level = LineLevel(int(random.integers(0, 4 if node is not None else 3)))
        yield Interruption(at, at + length, level, node)
    for _ in range(random.poisson(3)):
        node = None if random.random() < 0.5 else int(random.integers(0, nodes))
        identifier, bit = int(random.integers(0, names)), int(random.integers(0, 150))
        attempt = int(random.integers(0, 4)) if random.random() < 0.3 else 1
        yield ScriptedError(identifier, bit, attempt, int(random.integers(1, 4)), False, node)
    for _ in range(random.poisson(0.5)):
        node = None if random.random() < 0.5 else int(random.integers(0, nodes))
        yield ErrorRate(float(random.choice([1e-4, 1e-3, 1e-2])), int(random.choice([1, 5])), node)


def clocks(random: np.random.Generator, nodes: int) -> list[dict[str, float]]:
    """Equal clocks, or some that are off by up to what no receiver follows."""
    if random.random() < 0.6:
        return [{}] * nodes
    return [
        {
            "clock_ppm": float(random.choice([0, 0, -100, 100, -5e3, 5e3, -2e4, 2e4, 6e4])),
            "sample_point": float(random.choice([0.8, 0.875, 0.5])),
            "sjw": float(random.choice([0.05, 0.125, 0.2])),
        }
        for _ in range(nodes)
    ]


def compare(seed: int, requests: int) -> int:
    """Run both; returns how many frames were sent."""
    random = np.random.default_rng(seed)
    nodes, names = int(random.integers(2, 6)), int(random.integers(2, 40))
    shots = [bool(random.random() < 0.15) for _ in range(nodes)]
    gap = NOMINAL * float(random.choice([60, 150, 600]))
    end = int((requests + 20) * gap * 1.3)
    disturbed = [*disturbances(random, end, nodes, random.choice([0, 0.03, 0.3, 1]), names)]
    settings = [
        BusNodeSettings(f"n{i}", one_shot=shot, queue_length=4000, inbox=4000, **clock)
        for i, (shot, clock) in enumerate(zip(shots, clocks(random, nodes), strict=True))
    ]
    bus = SimulatedBus(TIMING, settings, disturbances=disturbed, seed=seed)
    wires = Wires(NOMINAL, DATA, settings, disturbed, seed)
    at = 0
    for _ in range(requests):
        if random.random() < 0.7:  # else at the same time as the last
            at += int(random.exponential(gap))
        node, what = int(random.integers(0, nodes)), frame(random, names)
        number = bus.request(node, at, what)
        wires.ask(node, at, number, what)
    wires.run(end)
    found = bus.advance(wires.t)
    expected = [tuple(x) for x in wires.happened if x.time <= wires.t]
    rows = found[FIELDS].tolist()
    for i, (mine, theirs) in enumerate(zip(rows, expected, strict=False)):
        assert mine == theirs, (
            f"seed {seed}, event {i} of {len(expected)}: {expected[max(0, i - 6) : i]}"
        )
    assert len(rows) == len(expected), f"seed {seed}: {rows[len(expected) :][:3]}"
    assert [bus.state(i)[:2] for i in range(nodes)] == [(n.tec, n.rec) for n in wires.nodes]
    received = [bus.frame(x) for x in found[found["kind"] == BusEvent.RECEIVED]]
    assert [(f.identifier, int.from_bytes(b"\1" + f.data)) for f in received] == wires.read
    return int((found["kind"] == BusEvent.SENT).sum())


@pytest.mark.parametrize("seed", range(20))
def test_random_traffic_gives_the_events_of_single_bits(seed):
    assert compare(seed, 60) > 0


@pytest.mark.slow
def test_a_node_that_joins_a_start_of_frame_does_not_count_its_attempt_twice():
    assert compare(1010, 250) > 0


@pytest.mark.slow
def test_a_node_that_joins_sends_what_waited_before_the_start_of_frame():
    assert compare(1014, 250) > 0


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_hundred_thousand_frames_give_the_events_of_single_bits():
    sent, seed = 0, 1000
    while sent < 100_000:
        sent += compare(seed, 250)
        seed += 1
    print(f"{sent} frames, {seed - 1000} buses")
