"""Published sets of messages: the simulated worst response reaches the analysis, no more."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.bus.frames import BusEvent, BusFrame
from cosim.bus.response import FrameStream, responses
from cosim.bus.settings import BusNodeSettings
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming, frame_bits

MS = 10**9
#: Tindell, Burns, Wellings 1995: sender, bytes, jitter, period (ms) of the 17 messages.
SAE = [
    (0, 1, 0.1, 50), (1, 2, 0.1, 5), (2, 1, 0.1, 5), (3, 2, 0.1, 5), (4, 1, 0.1, 5),
    (5, 2, 0.1, 5), (5, 6, 0.2, 10), (0, 1, 0.2, 10), (2, 2, 0.2, 10), (3, 2, 0.2, 10),
    (1, 1, 0.2, 50), (0, 4, 0.3, 100), (1, 1, 0.3, 100), (4, 1, 0.2, 100), (0, 3, 0.4, 1000),
    (4, 1, 0.3, 1000), (5, 1, 0.3, 1000),
]  # fmt: skip


def simulated(rate, messages, released, until):
    """Worst response of each message, ps; `released`: (time, when queued) of each, in ps.

    A response ends with the intermission, as in the analysis.
    """
    bus = SimulatedBus(BusTiming(rate), [BusNodeSettings(f"n{i}", inbox=5000) for i in range(7)])
    rows = sorted((queued, i, event) for i, times in enumerate(released) for event, queued in times)
    asked = {}
    for queued, i, event in rows:
        node, frame = messages[i]
        asked[bus.request(node, queued, frame)] = i, event
    sent = bus.advance(until)
    sent = sent[sent["kind"] == BusEvent.SENT]
    worst = [0] * len(messages)
    for row in sent:
        i, event = asked[int(row["request"])]
        worst[i] = max(worst[i], int(row["time"]) + 3 * round(1e12 / rate) - event)
    assert len(sent) == len(asked)
    return worst


@pytest.mark.parametrize("rate", [125e3, 250e3, 500e3, 1e6])
@pytest.mark.parametrize("seed", range(2))
def test_the_sae_messages_stay_within_the_analysis(rate, seed):
    random = np.random.default_rng(seed)
    messages, released, streams = [], [], []
    for i, (node, size, jitter, period) in enumerate(SAE):
        frame = BusFrame(16 * i, random.bytes(size))
        messages.append((node, frame))
        offset = 0 if seed == 0 else int(random.integers(0, period * MS))
        events = [offset + k * period * MS for k in range(-(-600 // period))]
        late = [int(random.random() * jitter * MS) for _ in events]
        released.append([(e, e + x) for e, x in zip(events, late, strict=True)])
        bits = frame_bits(frame.identifier, frame.data).nominal
        length = round(bits * 1e9 / rate)
        stream = FrameStream(str(i), 16 * i, period * 10**6, length, round(jitter * 1e6))
        streams.append(stream)
    worst = simulated(rate, messages, released, 2000 * MS)
    bounds = [r.worst for r in responses(streams, round(1e9 / rate))]
    assert all(found <= 1000 * bound for found, bound in zip(worst, bounds, strict=True))
    assert worst[0] > 0


def test_the_critical_instant_reaches_the_analysis():
    """Each message in turn: a longer one of lower priority began just before all others."""
    rate, bit = 125e3, 8_000_000
    frames = [BusFrame(16 * i, bytes([0x55] * size)) for i, (_, size, *_) in enumerate(SAE[:8])]
    lengths = [int(frame_bits(f.identifier, f.data).nominal) for f in frames]
    streams = [
        FrameStream(str(i), 16 * i, 40 * 10**6, bits * 8000) for i, bits in enumerate(lengths)
    ]
    bounds = [r.worst for r in responses(streams, 8000)]
    for i in range(len(frames) - 1):
        below = max(range(i + 1, len(frames)), key=lambda j: lengths[j])
        messages = [(j % 7, frame) for j, frame in enumerate(frames)]
        start = [bit if j <= i else 0 for j in range(len(frames))]
        released = [[(at, at)] if j <= i or j == below else [] for j, at in enumerate(start)]
        worst = simulated(rate, messages, released, 100 * MS)
        # the analysis lets it wait for the whole lower frame, of which one bit is over
        assert worst[i] + bit == 1000 * bounds[i]


@pytest.mark.parametrize("rate", [125e3, 250e3, 500e3, 1e6])
def test_each_sae_message_reaches_its_bound_at_its_critical_instant(rate):
    """The longest lower frame began a bit before; all higher ones come with their whole jitter."""
    bit = round(1e12 / rate)
    frames = [BusFrame(16 * i, bytes([0x55] * size)) for i, (_, size, *_) in enumerate(SAE)]
    lengths = [int(frame_bits(f.identifier, f.data).nominal) for f in frames]
    jitters, periods = ([round(row[k] * MS) for row in SAE] for k in (2, 3))
    streams = [
        FrameStream(str(i), 16 * i, periods[i] // 1000, n * bit // 1000, jitters[i] // 1000)
        for i, n in enumerate(lengths)
    ]
    bounds = [1000 * r.worst for r in responses(streams, bit // 1000)]
    messages = [(node, frame) for (node, *_), frame in zip(SAE, frames, strict=True)]
    for i, bound in enumerate(bounds):
        below = max(range(i + 1, len(SAE)), key=lambda j: lengths[j], default=None)
        begin = MS + (bit if below is not None else 0)
        released = [[] for _ in SAE]
        for j in range(i + 1):
            events = [begin - jitters[j] + k * periods[j] for k in range(-(-60 * MS // periods[j]))]
            released[j] = [(event, max(event, begin)) for event in events]
        if below is not None:
            released[below] = [(MS, MS)]
        worst = simulated(rate, messages, released, 2000 * MS)[i]
        # the analysis lets it wait for the whole lower frame, of which one bit is over
        assert worst + (bit if below is not None else 0) == bound


def test_the_set_of_davis_misses_its_deadline_in_the_second_instance():
    """Three messages of one length C: R = 2, 3, 3.5 C, the last in its second instance."""
    frames = [BusFrame(identifier, b"\x55" * 8) for identifier in (0x111, 0x122, 0x133)]
    lengths = {int(frame_bits(f.identifier, f.data).nominal) for f in frames}
    (bits,) = lengths
    c = bits * 8_000_000
    periods = (5 * c // 2, 7 * c // 2, 7 * c // 2)
    streams = [
        FrameStream(str(i), i, period // 1000, c // 1000) for i, period in enumerate(periods)
    ]
    bounds = [r.worst for r in responses(streams, 1)]
    released = [[(k * p, k * p) for k in range(8)] for p in periods]
    worst = simulated(125e3, list(enumerate(frames)), released, 100 * c)
    assert [1000 * b for b in bounds] == [2 * c, 3 * c, 7 * c // 2]
    assert worst == [
        1000 * b if i == 2 else w for i, (b, w) in enumerate(zip(bounds, worst, strict=True))
    ]
    assert all(w <= 1000 * b for w, b in zip(worst, bounds, strict=True))
