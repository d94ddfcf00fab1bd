"""The simulated bus: published and measured bit counts, queues, and independence of the steps."""

from __future__ import annotations

import ctypes as c

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.bus.frames import (
    REQUEST,
    BusEvent,
    BusFrame,
    ControllerState,
    DropCause,
    ErrorCode,
    ErrorRole,
)
from cosim.bus.settings import (
    AcceptanceFilter,
    BusNodeSettings,
    ErrorRate,
    Interruption,
    LineLevel,
    QueueKind,
    ScriptedError,
)
from cosim.bus.shared import library
from cosim.bus.simulation import BusSimulationError, SimulatedBus
from cosim.bus.structs import BitsStruct
from cosim.bus.timing import BusTiming, FrameFormat, TimingError, frame_bits
from tests.cosim.bus.test_timing import frames

BIT = 1_000_000
ONE = BusTiming(1e6)
FD = BusTiming(500e3, 2e6, fd=True)
BRS = FrameFormat(fd=True, brs=True)
WIDE = FrameFormat(fd=True, brs=True, extended=True)
EXTENDED = FrameFormat(extended=True)


def bus(nodes: int = 3, timing: BusTiming = ONE, **more) -> SimulatedBus:
    return SimulatedBus(timing, [BusNodeSettings(f"n{i}") for i in range(nodes)], **more)


def of(events, kind: BusEvent, **fields: int):
    found = events[events["kind"] == kind]
    for name, value in fields.items():
        found = found[found[name] == value]
    return found


def starts(events) -> list[int]:
    """Times of the starts of frame, bits."""
    return sorted({int(t) // BIT for t in of(events, BusEvent.STARTED)["time"]})


def gaps(events) -> list[int]:
    return np.diff(starts(events)).tolist()


@pytest.mark.parametrize(
    ("identifier", "data", "kind", "dlc", "bits"),
    [
        (0x123, b"\x55" * 8, {}, 0, 112),
        (0x000, bytes(8), {}, 0, 127),
        (0x0D0, bytes.fromhex("00FFF00F00230FFF"), {}, 0, 122),
        (0x18DAF110, bytes.fromhex("0322F190AAAAAAAA"), {"extended": True}, 0, 134),
        (0, bytes(8), {"extended": True}, 0, 150),
        (0x123, b"", {"remote": True}, 8, 48),
        (0x100, b"", {"remote": True}, 1, 49),
        (0x123, b"", {}, 0, 48),
        (0x100, b"\x22", {}, 0, 58),
        (0x100 << 18, b"\x11", {"extended": True}, 0, 81),
        (0x7FF, b"\x55" * 8, {}, 0, 113),
        (0x7FF, b"\x55", {}, 0, 58),
        (0x123, b"\x11", {}, 0, 56),
    ],
)
def test_a_classic_frame_takes_the_bits_measured_on_a_controller(identifier, data, kind, dlc, bits):
    b = bus(2)
    b.request(0, 0, BusFrame(identifier, data, FrameFormat(**kind), dlc))
    sent = of(b.advance(10**9), BusEvent.SENT)
    assert sent["time"].tolist() == [(bits - 3) * BIT]
    assert b.whole_frames == 1


@pytest.mark.parametrize(
    ("identifier", "data", "kind", "us"),
    [
        (0x123, b"\x55" * 64, BRS, 333.0),
        (0x123, bytes(64), BRS, 384.0),
        (0x123, b"\xff" * 64, BRS, 384.5),
        (0x123, bytes(16), BRS, 151.0),
        (0x123, bytes(20), BRS, 172.5),
        (0, bytes(64), WIDE, 53 * 2 + 652 / 2),
        (0x1FFFFFFF, b"\xff" * 64, WIDE, 54 * 2 + 653 / 2),
        (0, b"", BRS, 31 * 2 + 33 / 2),
        (0x123, b"\x55" * 64, FrameFormat(fd=True), 579 * 2),
    ],
)
@pytest.mark.parametrize("single", [False, True])
def test_an_fd_frame_takes_its_time_computed_as_a_whole_and_bit_by_bit(
    identifier, data, kind, us, single
):
    wide = kind.extended
    far = ScriptedError(identifier, 5000, extended=wide)  # beyond the frame: disturbs nothing
    b = bus(2, FD, disturbances=[far] if single else [])
    b.request(0, 0, BusFrame(identifier, data, kind))
    sent = of(b.advance(10**10), BusEvent.SENT)
    assert sent["time"].tolist() == [int((us - 6) * BIT)]
    assert b.whole_frames == (not single)


@given(frames())
def test_the_length_in_c_is_that_of_python(frame):
    identifier, data, kind, dlc = frame
    row = np.array([BusFrame(identifier, data, kind, dlc if kind.remote else 0).row()])
    found = BitsStruct()
    library().bus_frame_bits(row.ctypes.data, c.byref(found))
    assert (found.nominal, found.data) == frame_bits(identifier, data, kind, dlc)


def test_a_lone_node_goes_passive_and_stays_on_the_bus():
    b = bus(1)
    b.request(0, 0, BusFrame(0x123, b"\x55" * 8))
    events = b.advance(4000 * BIT)
    assert gaps(events)[:25] == [118] * 15 + [126] * 10
    errors = of(events, BusEvent.ERROR)
    assert set(errors["code"]) == {ErrorCode.ACK}
    assert errors["tec"].tolist() == [min(8 * i, 128) for i in range(1, len(errors) + 1)]
    assert b.state(0) == (128, 0, ControllerState.PASSIVE, 1)


def test_two_nodes_with_one_identifier_collide_until_both_are_passive():
    b = bus(3)
    b.request(0, 0, BusFrame(0x123, b"\x11"))
    b.request(1, 0, BusFrame(0x123, b"\x22"))
    events = b.advance(749 * BIT)
    assert gaps(events) == [43] * 15 + [51]
    errors = of(events, BusEvent.ERROR)
    assert errors["tec"][errors["node"] == 0].tolist() == [8 * i for i in range(1, 17)]
    assert errors["rec"][errors["node"] == 2].tolist() == list(range(1, 17))
    first = of(events, BusEvent.SENT)
    assert (first["node"].tolist(), first["tec"].tolist()) == ([0], [127])


@pytest.mark.parametrize(
    ("bit", "gap", "counters"),
    [
        (30, 52, (8, 1)), (35, 59, (8, 1)), (98, 117, (8, 1)), (107, 125, (8, 1)),
        (108, 126, (8, 0)), (109, 127, (0, 0)),
    ],
)  # fmt: skip
def test_one_inverted_bit(bit, gap, counters):
    b = bus(3, disturbances=[ScriptedError(0x123, bit)])
    frame = BusFrame(0x123, b"\x55" * 8)
    b.request(0, 0, frame)
    if bit == 109:
        b.request(0, 0, frame)
    events = b.advance((gap + 5) * BIT)
    assert gaps(events) == [gap]
    assert [b.state(i)[:2] for i in range(3)] == [(counters[0], 0)] + [(0, counters[1])] * 2
    events = np.concatenate([events, b.advance(1000 * BIT)])
    assert b.state(0)[:2] == ((7, 0) if counters[0] else (0, 0))
    assert b.state(1)[:2] == (0, 0)
    received = of(events, BusEvent.RECEIVED, node=1)
    assert len(received) == (2 if bit >= 108 else 1)
    assert len(of(events, BusEvent.SENT)) == (2 if bit == 109 else 1)
    assert len(of(events, BusEvent.OVERLOAD)) == (0 if bit < 108 else 2 if bit == 108 else 3)


def test_every_attempt_disturbed_leads_to_bus_off_and_back():
    b = bus(2, disturbances=[ScriptedError(0x123, 30, attempt=0)])
    b.request(0, 0, BusFrame(0x123, b"\x55" * 8))
    events = b.advance(3500 * BIT)
    assert gaps(events)[:31] == [52] * 15 + [60] + [62] * 15
    off = of(events, BusEvent.STATE, node=0, code=ControllerState.OFF)
    back = of(events, BusEvent.RECOVERED)
    assert len(of(events[: np.argmax(events["time"] > off["time"][0])], BusEvent.STARTED)) == 32
    at_off = of(events, BusEvent.ERROR, node=1)
    assert at_off["rec"][31] == 32
    # six recessive bits of the passive flag, six dominant ones of the receiver, then 128 times 11
    assert (back["time"] - off["time"]).tolist() == [(12 + 1408) * BIT]
    assert (int(back["tec"][0]), int(back["rec"][0])) == (0, 0)


def test_without_recovery_a_node_stays_off_until_it_is_reset():
    nodes = [BusNodeSettings("a", recovers=False), BusNodeSettings("b")]
    b = SimulatedBus(ONE, nodes, disturbances=[ScriptedError(0x123, 30, attempt=0)])
    b.request(0, 0, BusFrame(0x123, b"\x55" * 8))
    b.advance(10**10)
    assert b.state(0).state == ControllerState.OFF
    b.reset(0)
    events = b.advance(b.now_ps + 1408 * BIT)
    assert of(events, BusEvent.DROPPED)["code"].tolist() == [DropCause.RESET]
    assert of(events, BusEvent.RECOVERED)["time"].tolist() == [10**10 + 1408 * BIT]


def test_the_order_of_arbitration_and_where_it_is_lost():
    b = bus(4)
    b.request(0, 0, BusFrame(0x100 << 18, b"\x11", EXTENDED))
    b.request(1, 0, BusFrame(0x100, b"", FrameFormat(remote=True), 1))
    b.request(2, 0, BusFrame(0x100, b"\x22"))
    events = b.advance(10**9)
    assert starts(events) == [0, 58, 58 + 49]
    assert of(events, BusEvent.SENT)["node"].tolist() == [2, 1, 0]
    # RTR and SRR are bit 12, after a stuff bit in the seven zeros of the identifier
    assert of(events, BusEvent.LOST)[["node", "bit"]].tolist() == [(0, 13), (1, 13), (0, 14)]


def test_a_missing_partner_on_fd_and_classic_frames_of_one_identifier_collide():
    b = bus(3, FD)
    b.request(0, 0, BusFrame(0x123, b"\x11", BRS))
    b.request(1, 0, BusFrame(0x123, b"\x11"))
    events = b.advance(10**9)
    first = of(events, BusEvent.ERROR)[0]
    assert (int(first["node"]), int(first["code"]), int(first["bit"])) == (0, ErrorCode.BIT, 14)
    assert first["role"] == ErrorRole.PRIMARY | ErrorRole.SENDER


def test_identical_frames_are_sent_as_one():
    b = bus(3)
    for node in (0, 1):
        b.request(node, 0, BusFrame(0x123, b"\x11"))
    events = b.advance(10**9)
    sent, received = of(events, BusEvent.SENT), of(events, BusEvent.RECEIVED)
    assert sent["time"].tolist() == [53 * BIT] * 2
    assert len(received) == 1
    assert {*sent["frame"], *received["frame"]} == {0}  # equal frames are kept once


def test_a_passive_transmitter_waits_eight_bits_longer():
    b = bus(1)
    b.request(0, 0, BusFrame(0x123))
    b.advance(3000 * BIT)
    b = bus(2, disturbances=[ScriptedError(0x123, 30, attempt=i) for i in range(1, 18)])
    for _ in range(3):
        b.request(0, 0, BusFrame(0x123, b"\x55" * 8))
    events = b.advance(10**10)
    assert gaps(events)[-2:] == [120, 120]
    b = bus(2, disturbances=[ScriptedError(0x123, 30, attempt=i) for i in range(1, 18)])
    for _ in range(2):
        b.request(0, 0, BusFrame(0x123, b"\x55" * 8))
    b.request(1, 1000 * BIT, BusFrame(0x124, b"\x55" * 8))  # the other node goes first
    assert of(b.advance(10**10), BusEvent.SENT)["node"].tolist() == [0, 1, 0]


@pytest.mark.parametrize(
    ("queue", "order", "dropped"),
    [
        (QueueKind.FIFO, [0, 1, 2], [(3, DropCause.OVERFLOW), (4, DropCause.OVERFLOW)]),
        (QueueKind.SORTED, [0, 2, 1], [(3, DropCause.OVERFLOW), (4, DropCause.OVERFLOW)]),
        (QueueKind.MAILBOXES, [0, 2, 4], [(1, DropCause.REPLACED), (3, DropCause.OVERFLOW)]),
    ],
)
def test_queues(queue, order, dropped):
    b = SimulatedBus(ONE, [BusNodeSettings("a", queue, 3), BusNodeSettings("b")])
    for i, (at, identifier) in enumerate([(0, 5), (1, 7), (2, 6), (3, 4), (4, 7)]):
        if queue != QueueKind.MAILBOXES or i != 3:
            b.request(0, at * BIT, BusFrame(identifier, bytes([i])))
        else:
            b.request(0, at * BIT, BusFrame(4, b"\3"))
    events = b.advance(10**9)
    if queue == QueueKind.MAILBOXES:
        dropped = [dropped[1], dropped[0]]
    assert of(events, BusEvent.SENT)["request"].tolist() == order
    assert of(events, BusEvent.DROPPED)[["request", "code"]].tolist() == dropped


def test_a_mailbox_whose_frame_was_sent_is_free():
    """A newer frame of the same identifier replaces nothing."""
    b = SimulatedBus(ONE, [BusNodeSettings("a", QueueKind.MAILBOXES, 3), BusNodeSettings("b")])
    for at in (0, 200, 400):
        b.request(0, at * BIT, BusFrame(5, b"\x55"))
    events = b.advance(10**9)
    assert of(events, BusEvent.SENT)["request"].tolist() == [0, 1, 2]
    assert not len(of(events, BusEvent.DROPPED))


def test_a_request_leaves_those_alone_that_wait():
    """The inbox is a ring: a new frame comes to lie before older ones that have not begun."""
    nodes = [BusNodeSettings("a", inbox=3), BusNodeSettings("b")]
    b = SimulatedBus(FD, nodes)
    wanted = [BusFrame(i, bytes([i]) * 64, BRS) for i in range(1, 5)]
    for i in range(3):
        b.request(0, i * 1000 * BIT, wanted[i])
    found = [b.frame(e) for e in of(b.advance(500 * BIT), BusEvent.SENT)]
    b.request(0, 3000 * BIT, wanted[3])
    found += [b.frame(e) for e in of(b.advance(5000 * BIT), BusEvent.SENT)]
    assert found == wanted


def test_an_error_that_the_crc_does_not_see_gives_one_node_another_frame():
    """Bits inverted at one receiver as in x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1.

    The CRC is the remainder of a division by this polynomial. The bits are those of bytes 1 and 2,
    whose last bit is bit 42 of the frame.
    """
    powers = (15, 14, 10, 8, 7, 4, 3, 0)
    wrong = [ScriptedError(0x123, 42 - power, node=1) for power in powers]
    b = bus(3, disturbances=wrong)
    b.request(0, 0, BusFrame(0x123, b"\x55" * 8))
    events = b.advance(10**9)
    assert not len(of(events, BusEvent.ERROR))
    received = of(events, BusEvent.RECEIVED)
    assert len(set(received["time"].tolist())) == 1
    found = {int(e["node"]): b.frame(e).data for e in received}
    assert found == {1: bytes.fromhex("5590CC5555555555"), 2: b"\x55" * 8}


@pytest.mark.parametrize("level", [LineLevel.DOMINANT, LineLevel.RECESSIVE])
@pytest.mark.parametrize(("where", "first"), [(None, 0), (1, 1), (2, 2)])
def test_a_level_forced_at_one_node_is_an_error_there_first(level, where, first):
    """Forced on the bus it is the sender that sees another bit than it sends."""
    b = bus(3, disturbances=[ScriptedError(0x123, 30, length=6, node=where, level=level)])
    b.request(0, 0, BusFrame(0x123, b"\x55" * 8))
    errors = of(b.advance(10**9), BusEvent.ERROR)
    assert errors["node"][0] == first
    assert errors["code"][0] == (ErrorCode.BIT if where is None else ErrorCode.STUFF)


def test_one_shot_abort_filters_and_the_receive_fifo():
    nodes = [
        BusNodeSettings("a", one_shot=True),
        BusNodeSettings("b"),
        BusNodeSettings("c", filters=(AcceptanceFilter(0x120, 0x7F0, False),), receive_length=1),
    ]
    b = SimulatedBus(ONE, nodes, disturbances=[ScriptedError(0x111, 20)])
    for identifier in (0x130, 0x111):
        b.request(0, 0 if identifier == 0x130 else 300 * BIT, BusFrame(identifier))
    waiting = [b.request(1, 0, BusFrame(0x120 + i, bytes([i]))) for i in range(4)]
    first = b.advance(10 * BIT)
    assert b.abort(1, waiting[3]) and b.abort(1, waiting[0]) and not b.abort(1, 99)
    events = np.concatenate([first, b.advance(10**9)])
    dropped = of(events, BusEvent.DROPPED)
    causes = dict(zip(dropped["request"].tolist(), dropped["code"].tolist(), strict=True))
    assert causes[0] == causes[1] == DropCause.ONE_SHOT
    assert causes[waiting[3]] == DropCause.ABORTED
    assert causes[waiting[1]] == DropCause.RECEIVE_OVERFLOW
    assert not any(b.abort(1, request) for request in waiting), "these are over"
    assert of(events, BusEvent.SENT)["request"].tolist() == waiting[:3]
    received = of(events, BusEvent.RECEIVED, node=2)
    assert [b.frame(e).data for e in received] == [bytes([i]) for i in range(3)]
    (kept,) = b.received(2)
    assert (kept.frame, kept.request) == (BusFrame(0x120, b"\0"), waiting[0])
    assert b.received(2) == []


def test_a_request_at_the_present_takes_part():
    b = bus(2)
    b.request(0, 5 * BIT, BusFrame(0x200))
    assert b.advance(5 * BIT).size == 0
    b.request(1, 5 * BIT, BusFrame(0x100))
    assert of(b.advance(10**9), BusEvent.SENT)["node"].tolist() == [1, 0]


@pytest.mark.parametrize("seed", range(6))
def test_a_frame_may_be_requested_as_late_as_at_its_time(seed):
    """What is sent, lost and dropped is as if requested long before, errors included."""
    found = []
    for late in (False, True):
        random = np.random.default_rng(seed)
        nodes = [BusNodeSettings(f"n{i}", QueueKind(i), 1 + i) for i in range(3)]
        b = SimulatedBus(ONE, nodes, disturbances=[ErrorRate(1e-3)], seed=seed)
        parts, at = [], 0
        for _ in range(300):
            at += int(random.choice([0, 1, 2, 3, 45, 50, 55])) * BIT
            if late:
                parts.append(b.advance(at))
            name, data = random.integers([0, 0], [3, 2])
            b.request(int(random.integers(3)), at, BusFrame(int(name), bytes(data)))
        parts.append(b.advance(at + 1000 * BIT))
        found.append(np.concatenate(parts))
        found[-1]["frame"] = 0
        kinds = {int(kind) for kind in found[-1]["kind"]}
        assert kinds > {BusEvent.SENT, BusEvent.LOST, BusEvent.DROPPED, BusEvent.ERROR}
    assert found[0].tolist() == found[1].tolist()


def test_requests_of_the_time_at_which_a_bus_becomes_free_come_after_those_before():
    """The nodes' queues are full: what is requested last, of the first node, is dropped first."""
    found = []
    for late in (False, True):
        b = SimulatedBus(ONE, [BusNodeSettings(name, queue_length=1) for name in "ab"])
        free, parts = 56 * BIT, []
        for at in (0, free - 2 * BIT, free):
            b.request(1, at, BusFrame(0x123, b"\x11"))
        b.request(0, free - 2 * BIT, BusFrame(0x124))
        if late:
            parts.append(b.advance(free))
        b.request(0, free, BusFrame(0x125))
        parts.append(b.advance(1000 * BIT))
        dropped = of(np.concatenate(parts), BusEvent.DROPPED)
        found.append(dropped[["time", "node"]].tolist())
    assert found[0] == found[1] == [(free, 0), (free, 1)]


def test_a_short_circuit_and_a_broken_wire():
    short = Interruption(100 * BIT, 1000 * BIT, LineLevel.DOMINANT)
    b = bus(2, disturbances=[short])
    events = b.advance(2000 * BIT)
    assert of(events, BusEvent.ERROR)["time"][0] == 106 * BIT
    assert b.state(0).rec > 127
    alone = Interruption(0, 10**12, LineLevel.DISCONNECTED, node=1)
    b = bus(3, disturbances=[alone])
    b.request(0, 0, BusFrame(0x100))
    b.request(1, 0, BusFrame(0x080))
    events = b.advance(10**10)
    assert of(events, BusEvent.SENT)["node"].tolist() == [0]
    assert of(events, BusEvent.STATE, node=1)["code"].max() == ControllerState.OFF


def test_what_cannot_be_requested_is_said():
    b = bus(2)
    b.advance(10)
    with pytest.raises(
        BusSimulationError, match="found a request at 9 ps, expected 10 ps or later"
    ):
        b.request(0, 9, BusFrame(1))
    with pytest.raises(BusSimulationError, match="found node 2, expected 0 to 1"):
        b.request(2, 10, BusFrame(1))
    with pytest.raises(BusSimulationError, match="FD frame on a classic bus"):
        b.request(0, 10, BusFrame(1, b"", BRS))
    with pytest.raises(BusSimulationError, match="of frames that CAN has"):
        row = (10, 0, 0, BusFrame(1, b"", BRS).row())
        row[3]["flags"] |= BusFrame(1, b"", FrameFormat(remote=True)).flags
        bus(2, FD).request_many(np.array([row], REQUEST))
    with pytest.raises(BusSimulationError, match="10 ps"):
        b.advance(9)
    with pytest.raises(BusSimulationError, match="rate"):
        bus(2, disturbances=[ErrorRate(1.5)])
    with pytest.raises(TimingError, match="11 bits"):
        BusFrame(0x800)


RANDOM = st.integers(0, 2**32)


def traffic(seed: int, **more) -> SimulatedBus:
    """Four nodes with different queues, errors of all kinds, classic and FD frames."""
    random = np.random.default_rng(seed)
    nodes = [
        BusNodeSettings("a", QueueKind.FIFO, 4),
        BusNodeSettings("b", QueueKind.SORTED, 4),
        BusNodeSettings("c", QueueKind.MAILBOXES, 4, receive_length=3),
        BusNodeSettings("d", one_shot=True),
    ]
    disturbances = [
        ErrorRate(10.0 ** -random.integers(2, 5)),
        ErrorRate(1e-3, length=5, node=2),
        ScriptedError(3, int(random.integers(0, 60)), attempt=0, node=int(random.integers(0, 4))),
        Interruption(300 * BIT, 420 * BIT, LineLevel(int(random.integers(0, 3)))),
    ]
    b = SimulatedBus(FD, nodes, disturbances=disturbances, seed=seed, **more)
    for node in range(4):
        at = 0
        for _ in range(40):
            at += int(random.exponential(150 * BIT))
            fd = bool(random.integers(0, 2))
            kind = FrameFormat(bool(random.integers(0, 2)), fd, fd and bool(random.integers(0, 2)))
            b.request(node, at, BusFrame(int(random.integers(0, 8)), random.bytes(6), kind))
    return b


@settings(max_examples=15, deadline=None)
@given(RANDOM, st.lists(st.integers(3, 4000), min_size=1, max_size=30))
def test_nothing_depends_on_how_the_time_is_cut(seed, steps):
    whole, cut = traffic(seed), traffic(seed)
    end = 4000 * BIT
    expected = whole.advance(end)
    parts, i = [], 0
    while cut.now_ps < end:
        parts.append(cut.advance(min(end, cut.now_ps + steps[i % len(steps)] * 250_001)))
        i += 1
    found = np.concatenate(parts)
    expected["frame"] = found["frame"] = 0
    assert found.tobytes() == expected.tobytes()
    assert (np.diff(found["time"]) >= 0).all()
    assert all(whole.state(i) == cut.state(i) for i in range(4))
    assert whole.received(2) == cut.received(2)


@given(RANDOM)
def test_the_same_seed_gives_the_same_bytes(seed):
    assert traffic(seed).advance(10**10).tobytes() == traffic(seed).advance(10**10).tobytes()


@settings(max_examples=20, deadline=None)
@given(RANDOM, st.integers(0, 4000))
def test_a_reset_in_the_middle_does_not_depend_on_the_path(seed, bits):
    """Restarting a node amid a transmission: as a whole, or all bit by bit."""
    ends = []
    for single in (False, True):
        far = [ScriptedError(i, 10**6, attempt=0, extended=e) for i in range(8) for e in (0, 1)]
        b = bus(3, disturbances=far if single else [])
        random = np.random.default_rng(seed)
        for node in range(3):
            for at in np.sort(random.integers(0, 6000, 20)):
                b.request(node, int(at) * BIT, BusFrame(int(random.integers(0, 8)), b"\x0f" * node))
        first = b.advance(bits * BIT)
        b.reset(int(seed) % 3)
        events = np.concatenate([first, b.advance(10_000 * BIT)])
        events["frame"] = 0
        ends.append(events)
        assert (b.whole_frames == 0) == single or not len(of(events, BusEvent.SENT))
    assert ends[0].tolist() == ends[1].tolist()


@pytest.mark.parametrize("after", [0, 1])
@pytest.mark.parametrize("kind", [BusEvent.STARTED, BusEvent.LOST])
def test_a_reset_repeats_no_event_of_the_transmission_that_it_meets(kind, after):
    """At the time of an event of arbitration, and right behind it."""
    found = []
    for reset in (False, True):
        b = bus(3)
        b.request(0, 5 * BIT, BusFrame(0x100))
        b.request(1, 5 * BIT, BusFrame(0x101))
        if reset:
            first = b.advance(int(of(found[0], kind)["time"][0]) + after)
            b.reset(2)
            events = np.concatenate([first, b.advance(50 * BIT)])
        else:
            events = b.advance(50 * BIT)
        found.append(events)
    starts = [of(events, BusEvent.STARTED) for events in found]
    losses = [of(events, BusEvent.LOST) for events in found]
    assert len(starts[0]) == 2 and len(losses[0]) == 1
    assert (starts[1].tolist(), losses[1].tolist()) == (starts[0].tolist(), losses[0].tolist())


def test_looking_for_the_next_event_changes_nothing() -> None:
    """The events are those of a bus that was never asked, random errors included."""
    found = []
    for asked in (False, True):
        bus = SimulatedBus(
            ONE,
            [BusNodeSettings("a"), BusNodeSettings("b")],
            disturbances=[ErrorRate(1e-3)],
            seed=3,
        )
        for i in range(20):
            bus.request(i % 2, i * 100 * BIT, BusFrame(i, b"next"))
        rows = []
        until = 4000 * BIT
        while bus.now_ps < until:
            after = bus.now_ps + 1
            to = max(bus.next_event(until, [BusEvent.SENT]), after) if asked else after + 70 * BIT
            rows += bus.advance(min(to, until)).tolist()
            if asked and to < until:
                assert BusEvent.SENT in [r[7] for r in rows if r[0] == to]
        found.append(sorted((r[0], r[4], r[7], r[1]) for r in rows))
    assert found[0] == found[1] and len(found[0]) > 60
