"""Sender, faults, checks, delay line: only sent samples are accepted, whatever is injected."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.can.codec import Codec
from bridge.native import delay, faults
from bridge.native.bus import Accept
from bridge.native.delay import DelayLine
from bridge.native.faults import FOREVER, INJECTED, Fault, Injector
from bridge.native.journal import Journal
from bridge.native.message import Decoded, Header, accept, receiver
from bridge.results.undetected import corrupted_frames, sequences, undetected
from tests.bridge.can.layouts import layout

PERIOD, START, N = 5_000_000, 10**12, 600  # ns
TAU = 0.4  # ms, what the bus takes
CODEC = Codec(layout("link_fd2.dbc", "LINK_2"))
LINK = Accept.of(CODEC.message)
LSB = 2.0**-20


def rule(kind, **more):
    said = {"count": 1, "t1_ns": FOREVER, "bus": -1, "accept": LINK}
    return Fault(kind=kind, **{**said, **more})


def sent(j):
    """Sample j: values that tell which one it is."""
    return (j + 1 + np.arange(len(CODEC.signals))) * LSB


def frames():
    for j in range(N):
        frame = CODEC.frame(sent(j), Header(counter=j & 0xFF, status=2, t_us=j * PERIOD // 1000))
        frame.t_ns, frame.sequence = START + j * PERIOD + int(TAU * 1e6), j
        yield frame


def run(rules, journal=None):
    """The receiver, the delay line, and what was accepted: (sequence, values) in order."""
    injector = Injector(rules, journal=journal)
    heard, accepted = receiver(PERIOD, CODEC.layout.profile, time_bits=CODEC.layout.time_bits), []
    line = DelayLine(delay.STAMP, len(CODEC.signals), 5, 5, 0.001, 64)
    coming, held = list(frames()), []
    for slot in range(N + 40):
        now = slot * PERIOD + 1_000_000
        while coming and coming[0].t_ns <= START + now:
            injector.put(coming.pop(0), START)
        while (frame := injector.get(START + now)) is not None:
            result, values, header = CODEC.decode(frame.payload)
            if result is not Decoded.OK:
                heard.crc += result is Decoded.CRC
                continue
            t = frame.t_ns - START
            j = accept(heard, header.counter, t, header.t_us)
            if j >= 0:
                accepted.append((j, values))
                line.put(j, j * PERIOD, t, values)
        held.append(line.take(slot))
    return injector, heard, accepted, held


#: Rules that a real campaign would have; one corrupts, by as many bits as the CRC always finds.
rules = st.lists(
    st.one_of(
        st.builds(rule, st.just(faults.DROP), probability=st.floats(0, 0.4)),
        st.builds(
            rule, st.just(faults.BURST), probability=st.floats(0, 0.02), count=st.integers(1, 60)
        ),
        st.builds(
            rule,
            st.sampled_from([faults.DELAY, faults.JITTER]),
            probability=st.floats(0, 1),
            b=st.floats(0, 0.03),
        ),
        st.builds(
            rule, st.just(faults.DUPLICATE), probability=st.floats(0, 0.3), b=st.floats(0, 0.02)
        ),
        st.builds(rule, st.just(faults.REORDER), probability=st.floats(0, 0.3), b=st.just(0.05)),
    ),
    max_size=3,
)
seeds = st.integers(0, 2**64 - 1)


@settings(max_examples=12)
@given(rules=rules, seed=seeds, bits=st.integers(1, 3), p=st.floats(0, 0.3))
def test_what_is_accepted_is_what_was_sent(tmp_path_factory, rules, seed, bits, p):
    rules.append(rule(faults.CORRUPT, count=bits, probability=p))
    for n, r in enumerate(rules):
        r.random = (seed + n) % 2**64
    path = tmp_path_factory.mktemp("injected") / "journal"
    with Journal.create(path, INJECTED, N) as journal:
        injector, heard, accepted, held = run(rules, journal.address)
        rows = journal.rows.copy()
    corrupted = sequences(corrupted_frames(rows, LINK), lambda data: data[2], 8, PERIOD)
    assert corrupted.tolist() == [r["sequence"] for r in corrupted_frames(rows, LINK)]
    assert undetected(corrupted, (j for j, _ in accepted)) == []
    assert heard.crc == sum(int(r["copies"]) for r in corrupted_frames(rows, LINK))
    assert len({j for j, _ in accepted}) == len(accepted)
    for j, values in accepted:
        assert np.array_equal(values, sent(j))
    assert held == sorted(held)
    assert injector.struct.overflow == 0


def test_without_faults_every_sample_comes():
    _, heard, accepted, held = run([])
    assert [j for j, _ in accepted] == list(range(N))
    assert (heard.ok, heard.lost, heard.crc) == (N, 0, 0)
    assert held[:4] == [-1, 0, 1, 2]  # the bus takes a part of the slot


def test_a_checker_that_accepts_anything_would_be_found():
    """The judge itself: an accepted sequence number of a corrupted frame is reported."""
    assert undetected(np.array([3, 9, 9, 700]), [1, 2, 9, 700, 701]) == [9, 700]


def test_sequence_numbers_come_from_counter_and_arrival():
    rows = np.zeros(3, INJECTED)
    rows["t_ns"] = [1000 * PERIOD, 1000 * PERIOD + 1, 3 * PERIOD]
    rows["length"], rows["data"][:, 2] = 3, [1000 % 256, 998 % 256, 1]
    found = sequences(rows, lambda data: data[2], 8, PERIOD)
    assert found.tolist() == [1000, 998, 1]
