"""Operations over the simulated bus, against the same bus driven directly."""

from __future__ import annotations

import pytest

from cosim.bus.frames import BusEvent, BusFrame, ControllerState
from cosim.bus.settings import BusNodeSettings, Disturbance, ScriptedError
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming, FrameFormat
from cosim.lsbus.codec import encode
from cosim.lsbus.exchange import Delivery, OperationBus
from cosim.lsbus.operations import (
    ArbitrationLost,
    BusErrorCode,
    BusErrorFlag,
    BusFault,
    CanFdTransmit,
    CanTransmit,
    Configuration,
    ConfigurationParameter,
    Confirm,
    FormatError,
    LostArbitration,
    LsBusError,
    NodeStatus,
    StatusReport,
    Wakeup,
)

BIT = 1_000_000
ONE = BusTiming(1e6)
FD = BusTiming(500e3, 2e6, fd=True)
NAMES = ("a", "b", "c")
MS = 10**9
DISCARD = Configuration(
    ConfigurationParameter.ARBITRATION_LOST_BEHAVIOR, LostArbitration.DISCARD_AND_NOTIFY
)


def direct(frames: dict[int, BusFrame], *disturbances: Disturbance, until: int = MS):
    """(time, node, kind) of SENT and RECEIVED, each frame requested at time 0."""
    bus = SimulatedBus(ONE, [BusNodeSettings(n) for n in NAMES], disturbances=disturbances)
    for node, frame in frames.items():
        bus.request(node, 0, frame)
    kinds = (BusEvent.SENT, BusEvent.RECEIVED)
    return [(int(e["time"]), int(e["node"])) for e in bus.advance(until) if e["kind"] in kinds]


def frames_of(deliveries: list[Delivery]):
    """The same of deliveries."""
    wanted = (Confirm, CanTransmit, CanFdTransmit)
    return [(d.time_ps, d.node) for d in deliveries if isinstance(d.operation, wanted)]


@pytest.mark.parametrize("cut", [MS, 7 * BIT + 1])
def test_two_nodes_at_once_are_sent_in_the_order_and_at_the_times_of_the_bus(cut: int) -> None:
    bus = OperationBus(ONE, NAMES)
    bus.send(0, encode([CanTransmit(0x300, data=b"low")]))
    bus.send(1, encode([CanTransmit(0x100, data=b"high")]))
    found = [d for t in range(cut, MS + cut, cut) for d in bus.advance(min(t, MS))]
    assert frames_of(found) == direct({0: BusFrame(0x300, b"low"), 1: BusFrame(0x100, b"high")})
    high, low = CanTransmit(0x100, data=b"high"), CanTransmit(0x300, data=b"low")
    by_node = [[d.operation for d in found if d.node == i] for i in range(3)]
    assert by_node == [[high, Confirm(0x300)], [Confirm(0x100), low], [high, low]]


@pytest.mark.parametrize("cut", [MS, 7 * BIT + 1])
def test_a_lost_arbitration_is_told_and_the_frame_discarded_if_asked_for(cut: int) -> None:
    bus = OperationBus(ONE, NAMES)
    bus.send(0, encode([DISCARD, CanTransmit(0x300)]))
    bus.send(1, encode([CanTransmit(0x100)]))
    found = [d for t in range(cut, MS + cut, cut) for d in bus.advance(min(t, MS))]
    assert frames_of(found) == direct({1: BusFrame(0x100)})
    # 0x100 and 0x300 differ in the second bit of the identifier, bit 2 of the frame.
    assert found[0] == Delivery(3 * BIT, 0, ArbitrationLost(0x300))
    assert not any(isinstance(d.operation, ArbitrationLost) for d in found[1:])


def test_a_bus_error_is_told_to_all_and_the_frame_sent_again() -> None:
    error = ScriptedError(0x123, bit=30)
    bus = OperationBus(ONE, NAMES, disturbances=[error])
    bus.send(0, encode([CanTransmit(0x123, data=b"\x55" * 8)]))
    found = bus.advance(MS)
    assert frames_of(found) == direct({0: BusFrame(0x123, b"\x55" * 8)}, error)
    faults = {d.node: d.operation for d in found if isinstance(d.operation, BusFault)}
    assert faults[0] == BusFault(0x123, BusErrorCode.BIT, BusErrorFlag.PRIMARY, True)
    assert faults.keys() == {0, 1, 2}
    assert not faults[1].is_sender and not faults[2].is_sender
    assert {faults[1].flag, faults[2].flag} == {BusErrorFlag.SECONDARY}


def test_a_node_goes_bus_off_after_32_errors_by_its_own_count_and_by_that_of_the_bus() -> None:
    bus = OperationBus(ONE, NAMES, disturbances=[ScriptedError(0x123, bit=30, attempt=0)])
    bus.send(0, encode([CanTransmit(0x123, data=b"\x55" * 8)]))
    tec, said = 0, []
    while tec < 256:
        for d in bus.advance(bus.next_time(100 * MS)):
            if d.node == 0:
                assert isinstance(d.operation, BusFault) and d.operation.is_sender
                tec += 8
                status = (NodeStatus.BUS_OFF if tec > 255 else NodeStatus.ERROR_PASSIVE
                          if tec > 127 else NodeStatus.ERROR_ACTIVE)  # fmt: skip
                said.append(status)
                bus.send(0, encode([StatusReport(status)]))
    assert said.count(NodeStatus.ERROR_ACTIVE) == 15 and len(said) == 32
    assert bus.remarks == []
    assert bus.bus.state(0).state is ControllerState.OFF
    with pytest.raises(LsBusError, match=r"node a, t = .* after the status BUS_OFF, expected none"):
        bus.send(0, encode([CanTransmit(1)]))


def test_a_status_that_the_bus_does_not_count_is_remarked() -> None:
    bus = OperationBus(ONE, NAMES)
    bus.send(1, encode([StatusReport(NodeStatus.ERROR_PASSIVE)]))
    assert bus.remarks[0].node == "b"
    assert "found status ERROR_PASSIVE, expected ERROR_ACTIVE: the bus counts TEC 0" in (
        bus.remarks[0].text
    )


def test_fd_and_remote_frames_arrive_as_they_were_sent() -> None:
    wide = CanFdTransmit(0x18DAF110, True, True, False, bytes(range(64)))
    remote = CanTransmit(0x7, remote=True, data=bytes(5))
    bus = OperationBus(FD, NAMES)
    rates = [Configuration(ConfigurationParameter.CAN_BAUDRATE, 500_000),
             Configuration(ConfigurationParameter.CAN_FD_BAUDRATE, 2_000_000)]  # fmt: skip
    bus.send(2, encode([*rates, wide, remote]))
    found = bus.advance(MS)
    assert [d.operation for d in found if d.node == 0] == [remote, wide]
    one = SimulatedBus(FD, [BusNodeSettings("a"), BusNodeSettings("b")])
    one.request(0, 0, BusFrame(7, b"", FrameFormat(remote=True), 5))
    kind = FrameFormat(extended=True, fd=True, brs=True)
    one.request(0, 0, BusFrame(0x18DAF110, bytes(range(64)), kind))
    times = [int(e["time"]) for e in one.advance(MS) if e["kind"] == BusEvent.SENT]
    assert [d.time_ps for d in found if d.node == 2] == times


def test_wakeup_goes_to_all_others_at_once_and_bytes_that_are_none_go_back() -> None:
    bus = OperationBus(ONE, NAMES)
    bad = b"\x77\0\0\0\x08\0\0\0"
    bus.send(1, bad + encode([Wakeup()]))
    assert bus.next_time(MS) == 0
    assert bus.advance(0) == [
        Delivery(0, 1, FormatError(bad)),
        Delivery(0, 0, Wakeup()),
        Delivery(0, 2, Wakeup()),
    ]
    assert bus.advance(MS) == []
    assert "found code 0x77, expected one of" in bus.remarks[-1].text


def test_a_node_without_notifications_gets_frames_only() -> None:
    bus = OperationBus(ONE, NAMES, notified=[False, True, False])
    bus.send(0, encode([CanTransmit(1)]))
    bus.send(1, encode([CanTransmit(2)]))
    found = bus.advance(MS)
    assert [d.operation for d in found if d.node == 0] == [CanTransmit(2)]
    assert [d.operation for d in found if d.node == 1] == [CanTransmit(1), Confirm(2)]


@pytest.mark.parametrize(
    ("operation", "message"),
    [
        (Configuration(ConfigurationParameter.CAN_BAUDRATE, 250_000),
         "found CAN_BAUDRATE 250000 bit/s, expected 1000000 bit/s, the bit rate of the bus"),
        (Configuration(ConfigurationParameter.CAN_FD_BAUDRATE, 2_000_000),
         "found CAN_FD_BAUDRATE 2000000, expected none: it is a classic CAN bus"),
        (Configuration(ConfigurationParameter.CAN_XL_BAUDRATE, 1), "found CAN_XL_BAUDRATE 1"),
        (CanFdTransmit(1), "found CAN FD Transmit, expected CAN Transmit"),
        (Confirm(1), r"found Confirm\(identifier=1\), expected what a node sends to a bus"),
    ],
)  # fmt: skip
def test_what_this_bus_cannot_do_is_refused(operation, message: str) -> None:
    with pytest.raises(LsBusError, match=f"node b, t = 0 s: {message}"):
        OperationBus(ONE, NAMES).send(1, encode([operation]))


def test_a_full_transmit_queue_is_refused() -> None:
    bus = OperationBus(ONE, NAMES, queue_length=2)
    with pytest.raises(LsBusError, match=r"node a, .* more than the 2 that its transmit queue"):
        bus.send(0, encode([CanTransmit(i) for i in range(5)]))
        bus.advance(MS)
