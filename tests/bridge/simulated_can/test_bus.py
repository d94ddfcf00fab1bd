"""The python-can interface ``cosim`` on the vectors of CAN, in simulated time."""

from __future__ import annotations

import can
import pytest

from bridge.simulated_can.bus import CosimBus
from cosim.bus.settings import Interruption, ScriptedError
from tests.bridge.simulated_can.benches import Bench, bench, everything, message

__all__ = ["bench"]

FIVES, ZEROS, ONES = b"\x55", b"\0", b"\xff"

#: Frames and their bit times (nominal, data) to the end of the intermission. Classic: measured on
#: a Verilog controller; FD: computed bit by bit.
LENGTHS = [
    (message(0x123, FIVES * 8), 112, 0),
    (message(0x000, ZEROS * 8), 127, 0),
    (message(0x0D0, bytes.fromhex("00FFF00F00230FFF")), 122, 0),
    (message(0x18DAF110, bytes.fromhex("0322F190AAAAAAAA"), is_extended_id=True), 134, 0),
    (message(0, ZEROS * 8, is_extended_id=True), 150, 0),
    (message(0x123, is_remote_frame=True, dlc=8), 48, 0),
    (message(0x100, is_remote_frame=True, dlc=1), 49, 0),
    (message(0x123), 48, 0),
    (message(0x7FF, FIVES * 8), 113, 0),
    (message(0x123, FIVES * 64, is_fd=True, bitrate_switch=True), 29, 550),
    (message(0x123, ZEROS * 64, is_fd=True, bitrate_switch=True), 29, 652),
    (message(0x123, ONES * 64, is_fd=True, bitrate_switch=True), 29, 653),
    (message(0x123, ZEROS * 16, is_fd=True, bitrate_switch=True), 29, 186),
    (message(0x123, ZEROS * 20, is_fd=True, bitrate_switch=True), 29, 229),
    (message(0, ZEROS * 64, is_fd=True, bitrate_switch=True, is_extended_id=True), 53, 652),
    (message(0x123, FIVES * 64, is_fd=True), 579, 0),
]


@pytest.mark.parametrize(("sent", "nominal", "data"), LENGTHS, ids=lambda x: str(x)[:40])
def test_a_frame_is_received_at_the_end_of_its_last_bit(
    bench: Bench, sent: can.Message, nominal: int, data: int
) -> None:
    options = {"bitrate": 500_000, "fd": True, "data_bitrate": 2_000_000}
    sender, receiver = bench.bus(**options), bench.bus(**options)
    sender.send(sent)
    sender.send(sent)
    first, second = everything(receiver)
    frame = nominal * 2e-6 + data * 0.5e-6
    assert first.timestamp == pytest.approx(frame - 6e-6, abs=1e-12)
    assert second.timestamp == pytest.approx(2 * frame - 6e-6, abs=1e-12)
    assert first.equals(sent, timestamp_delta=None, check_channel=False, check_direction=False)
    assert (first.channel, first.is_rx) == (bench.name, True)


def test_of_frames_sent_at_the_same_instant_the_lowest_identifier_wins_everywhere(
    bench: Bench,
) -> None:
    buses = [bench.bus() for _ in range(5)]
    first = message(0x100, is_extended_id=True).arbitration_id << 18
    waiting = [
        message(0x300),
        message(first, is_extended_id=True),
        message(0x100, is_remote_frame=True, dlc=0),
        message(0x100),
    ]
    for bus, frame in zip(buses, waiting, strict=False):
        bus.send(frame)
    order = [(m.arbitration_id, m.is_remote_frame) for m in everything(buses[4])]
    assert order == [(0x100, False), (0x100, True), (first, False), (0x300, False)]
    seen = [(m.arbitration_id, m.is_remote_frame) for m in everything(buses[0])]
    assert seen == order[:3]  # all but its own, in the same order


def test_a_fifo_sends_in_the_order_of_queueing_a_sorted_queue_by_identifier(bench: Bench) -> None:
    plain, listener = bench.bus(), bench.bus()
    for identifier in (0x300, 0x100, 0x200):
        plain.send(message(identifier))
    assert [m.arbitration_id for m in everything(listener)] == [0x300, 0x100, 0x200]
    urgent = bench.bus(queue="sorted")
    for identifier in (0x300, 0x100, 0x200):
        urgent.send(message(identifier))
    assert [m.arbitration_id for m in everything(listener)] == [0x100, 0x200, 0x300]


def test_own_messages_are_received_at_the_time_of_their_transmission(bench: Bench) -> None:
    sender, other = bench.bus(receive_own_messages=True), bench.bus()
    sender.send(message(0x123, FIVES * 8))
    own, copy = sender.recv(1), other.recv(1)
    assert own is not None
    assert copy is not None
    assert (own.is_rx, copy.is_rx) == (False, True)
    assert own.timestamp == copy.timestamp == pytest.approx(109e-6)
    own.data[0] = 0
    assert copy.data[0] == 0x55
    other.send(message(0x124))
    assert everything(other) == []


def test_a_message_may_be_changed_after_it_was_sent(bench: Bench) -> None:
    sender, receiver = bench.bus(), bench.bus()
    sent = message(0x123, b"\1")
    sender.send(sent)
    sent.data[0] = 2
    assert [bytes(m.data) for m in everything(receiver)] == [b"\1"]


def test_fd_data_is_filled_with_zeros_to_a_length_there_is(bench: Bench) -> None:
    sender, receiver = bench.bus(fd=True), bench.bus()
    sender.send(message(0x123, b"\1" * 9, is_fd=True, check=False))
    (found,) = everything(receiver)
    assert (found.dlc, bytes(found.data)) == (12, b"\1" * 9 + b"\0\0\0")


def test_filters_are_those_of_python_can(bench: Bench) -> None:
    sender = bench.bus()
    receiver = bench.bus(can_filters=[{"can_id": 0x100, "can_mask": 0x700, "extended": False}])
    for identifier in (0x0FF, 0x17F, 0x200):
        sender.send(message(identifier))
    assert [m.arbitration_id for m in everything(receiver)] == [0x17F]
    receiver.set_filters(None)
    sender.send(message(0x200))
    assert [m.arbitration_id for m in everything(receiver)] == [0x200]


def test_a_receive_queue_that_is_full_loses_what_comes_next(bench: Bench) -> None:
    sender, receiver = bench.bus(), bench.bus(rx_queue_size=2)
    for identifier in (1, 2, 3):
        sender.send(message(identifier))
    sender.sleep(0.01)
    assert receiver.lost == 1
    assert [m.arbitration_id for m in everything(receiver)] == [1, 2]


def test_load_is_frame_time_over_time(bench: Bench) -> None:
    sender, _ = bench.bus(), bench.bus()
    assert sender.load(1e-3) == 0
    for _ in range(5):
        sender.send(message(0x123, FIVES * 8))  # 112 bits of 1 us each
    sender.sleep(1e-3)
    assert sender.load(1e-3) == pytest.approx(0.56)
    assert sender.load(0.5e-3) == pytest.approx(0.06 / 0.5)
    sender.sleep(1e-3)
    assert sender.load(1e-3) == 0
    with pytest.raises(can.CanInitializationError, match="found a window of 11 s"):
        sender.load(11)


def test_periodic_messages_keep_the_time_of_the_bus(bench: Bench) -> None:
    sender, receiver = bench.bus(), bench.bus()
    task = sender.send_periodic(message(0x123, FIVES * 8), 1e-3, duration=4.5e-3)
    found = everything(receiver)
    expected = [109e-6 + k * 1e-3 for k in range(5)]
    assert [m.timestamp for m in found] == pytest.approx(expected, abs=1e-12)
    start = sender.time
    task.start()  # type: ignore[attr-defined]
    receiver.recv(1)
    task.modify_data(message(0x123, ZEROS * 8))  # type: ignore[attr-defined]
    changed = receiver.recv(1)
    assert changed is not None
    assert changed.data == ZEROS * 8
    assert changed.timestamp > start + 1e-3
    task.stop()
    assert everything(receiver) == []


def test_a_callback_changes_periodic_messages(bench: Bench) -> None:
    sender, receiver = bench.bus(), bench.bus()

    def count(changed: can.Message) -> None:
        changed.data[0] += 1

    sender.send_periodic(message(0x123, b"\0"), 1e-3, 2.5e-3, modifier_callback=count)
    assert [m.data[0] for m in everything(receiver)] == [1, 2, 3]


def test_periodic_messages_end_with_their_bus(bench: Bench) -> None:
    sender, receiver = bench.bus(), bench.bus()
    sender.send_periodic(message(0x123), 1e-3)
    receiver.recv(1)
    sender.shutdown()
    assert len(everything(receiver)) <= 1


def test_a_full_transmit_queue_refuses_or_waits_for_room(bench: Bench) -> None:
    sender, receiver = bench.bus(tx_queue_size=2), bench.bus()
    sender.send(message(1))
    sender.send(message(2))
    with pytest.raises(can.CanOperationError, match="found 2 frames in the transmit queue"):
        sender.send(message(3))
    sender.send(message(3), timeout=1)
    assert sender.time == pytest.approx(44e-6, abs=10e-6)  # one frame without data
    assert [m.arbitration_id for m in everything(receiver)] == [1, 2, 3]


def test_waiting_for_room_ends_with_a_timeout(bench: Bench) -> None:
    alone = bench.bus(tx_queue_size=1)
    alone.send(message(1))
    with pytest.raises(can.CanTimeoutError, match="transmit queue"):
        alone.send(message(2), timeout=1e-3)
    assert alone.time == pytest.approx(1e-3)
    alone.flush_tx_buffer()
    alone.sleep(1e-3)
    alone.send(message(2))


def test_a_lone_node_becomes_passive_and_is_heard_by_who_joins(bench: Bench) -> None:
    alone = bench.bus()
    assert alone.state == can.BusState.ACTIVE
    alone.send(message(0x123, FIVES * 8))
    alone.sleep(2e-3)
    assert alone.state == can.BusState.PASSIVE
    assert alone.error_counters == (128, 0)
    reports = everything(alone, 0)
    assert all(m.is_error_frame for m in reports)
    assert [(m.arbitration_id, m.data[1], m.data[6]) for m in reports] == [
        (0x204, 0x08, 96),
        (0x204, 0x20, 128),
    ]
    joined = bench.bus()
    (heard,) = everything(joined, 1e-3)
    assert heard.arbitration_id == 0x123
    assert alone.error_counters == (127, 0)
    assert alone.state == can.BusState.ACTIVE


def test_a_disturbed_frame_is_repeated_and_counted(bench: Bench) -> None:
    """A bit inverted at bit 30 of 112: the next attempt starts 52 bits after the first."""
    sender, receiver = bench.bus(bus_errors=True), bench.bus()
    third = bench.bus()
    sender.disturb(ScriptedError(0x123, 30))
    sender.send(message(0x123, FIVES * 8))
    (found,) = everything(receiver)
    assert found.timestamp == pytest.approx(52e-6 + 109e-6, abs=1e-12)
    assert sender.error_counters == (7, 0)
    assert receiver.error_counters == third.error_counters == (0, 0)
    (report,) = everything(sender)
    assert report.is_error_frame
    assert report.arbitration_id == 0x200 | 0x80 | 0x8
    assert report.data[2] & 0x80
    assert (report.data[6], report.data[7]) == (8, 0)


def test_a_node_that_is_always_disturbed_goes_bus_off_and_comes_back(bench: Bench) -> None:
    sender, receiver = bench.bus(), bench.bus()
    for attempt in range(1, 33):
        sender.disturb(ScriptedError(0x123, 30, attempt))
    sender.send(message(0x123, FIVES * 8))
    sender.sleep(1.9e-3)
    assert sender.state == can.BusState.ERROR
    with pytest.raises(can.CanOperationError, match="bus-off"):
        sender.send(message(0x124))
    sender.sleep(3e-3)
    assert sender.state == can.BusState.ACTIVE
    assert sender.error_counters == (0, 0)
    assert [m.arbitration_id & 0x1FF for m in everything(sender)] == [0x4, 0x4, 0x40, 0x100]
    sender.send(message(0x124))
    assert [m.arbitration_id for m in everything(receiver)] == [0x123, 0x124]


def test_random_errors_are_the_same_for_a_seed(bench: Bench) -> None:
    def stamps(name: str, seed: int) -> list[float]:
        bench.name = name
        sender, receiver = bench.bus(error_rate=2e-3, seed=seed), bench.bus()
        for identifier in range(50):
            sender.send(message(identifier, FIVES * 8))
        found = [m.timestamp for m in everything(receiver) if not m.is_error_frame]
        assert len(found) >= 50
        return found

    first, again, other = stamps("a", 1), stamps("b", 1), stamps("c", 2)
    assert first == again != other


def test_what_a_bus_queued_is_sent_after_it_was_shut_down(bench: Bench) -> None:
    sender, receiver, _third = bench.bus(), bench.bus(), bench.bus()
    sender.send(message(1))
    sender.send(message(2))
    sender.shutdown()
    assert [m.arbitration_id for m in everything(receiver)] == [1, 2]


def test_a_bus_joins_at_the_end_of_the_frame_under_way(bench: Bench) -> None:
    sender, receiver = bench.bus(), bench.bus()
    for identifier in (1, 2):
        sender.send(message(identifier, FIVES * 8))
    sender.sleep(50e-6)
    late = bench.bus()
    assert [m.arbitration_id for m in everything(receiver)] == [1, 2]
    assert [m.arbitration_id for m in everything(late)] == [2]


def test_a_bus_that_is_shut_down_does_nothing_more(bench: Bench) -> None:
    bus = bench.bus()
    bus.shutdown()
    bus.shutdown()
    for use in (
        lambda: bus.send(message(1)),
        lambda: bus.recv(0),
        lambda: bus.state,
        lambda: bus.load(),
        lambda: bus.flush_tx_buffer(),
        lambda: bus.send_periodic(message(1), 1),
    ):
        with pytest.raises(can.CanOperationError, match="shut down"):
            use()


def test_channels_that_are_open_are_detected(bench: Bench) -> None:
    bench.bus()
    (found,) = [c for c in CosimBus._detect_available_configs() if c["channel"] == bench.name]
    assert found["interface"] == "cosim"
    joined = CosimBus(found["channel"])
    assert "1e+06 bit/s" in str(joined)
    joined.shutdown()


def test_the_protocol_is_that_of_the_channel(bench: Bench) -> None:
    assert bench.bus().protocol == can.CanProtocol.CAN_20
    bench.name = "fd"
    assert bench.bus(fd=True).protocol == can.CanProtocol.CAN_FD
    assert bench.bus().protocol == can.CanProtocol.CAN_FD


def test_a_scripted_error_happens_once_also_when_a_bus_joins(bench: Bench) -> None:
    sender, receiver = bench.bus(), bench.bus()
    sender.send(message(0x123, FIVES * 8))
    assert len(everything(receiver)) == 1
    sender.disturb(ScriptedError(0x123, 30, attempt=2))
    stamps = []
    for _ in range(4):
        start = sender.time
        sender.send(message(0x123, FIVES * 8))
        bench.bus(receive_own_messages=True)
        (found,) = everything(receiver, 1e-3)
        stamps.append(round((found.timestamp - start) * 1e6))
    assert stamps == [109, 161, 109, 109]


def test_an_interruption_is_over_when_it_says(bench: Bench) -> None:
    sender, receiver = bench.bus(), bench.bus()
    sender.sleep(1e-3)
    sender.disturb(Interruption(10**9, 13 * 10**8))  # 1 ms to 1.3 ms from now
    for _ in range(3):
        sender.sleep(0.3e-3)
        bench.bus()
    sender.sleep(0.2e-3)
    sender.send(message(0x123))
    (found,) = [m for m in everything(receiver) if not m.is_error_frame]
    assert 2.3e-3 < found.timestamp < 2.4e-3


def test_one_shot_does_not_repeat_a_lost_arbitration(bench: Bench) -> None:
    once, often, listener = bench.bus(one_shot=True, bus_errors=True), bench.bus(), bench.bus()
    listener.sleep(0.01)
    once.send(message(0x200))
    often.send(message(0x100))
    assert [m.arbitration_id for m in everything(listener)] == [0x100]
    once.send(message(0x200))
    assert [m.arbitration_id for m in everything(listener)] == [0x200]
    assert any(m.is_error_frame and m.arbitration_id & 2 for m in everything(once))


def test_a_mailbox_keeps_the_newest_message_of_an_identifier(bench: Bench) -> None:
    boxes, other = bench.bus(queue="mailboxes"), bench.bus()
    other.sleep(0.01)
    other.send(message(0x001, b"\0" * 8))
    other.sleep(20e-6)  # it is on the wire
    for number in range(3):
        boxes.send(message(0x300, bytes([number])))
    boxes.send(message(0x200))
    got = [(m.arbitration_id, bytes(m.data)) for m in everything(other)]
    assert got == [(0x200, b""), (0x300, b"\2")]


def test_a_reset_drops_what_waits_and_the_counters(bench: Bench) -> None:
    lone = bench.bus()
    for _ in range(3):
        lone.send(message(0x123))
    lone.sleep(0.05)
    assert lone.error_counters.tec == 128  # nobody acknowledges
    lone.reset()
    lone.sleep(0.01)
    assert lone.error_counters == (0, 0)
    other = bench.bus()
    other.sleep(0.01)
    lone.send(message(0x321))
    assert [m.arbitration_id for m in everything(other)] == [0x321]


def test_error_frames_are_part_of_the_load(bench: Bench) -> None:
    sender, receiver = bench.bus(), bench.bus()
    sender.sleep(0.001)
    sender.disturb(ScriptedError(0x123, 30))
    sender.sleep(0.001)
    start = sender.time
    sender.send(message(0x123, b"\x55" * 8))
    assert receiver.recv(1) is not None
    sender.sleep(0.01 - (sender.time - start))
    # 52 bits of the attempt that failed, with its error frame, and 112 of the frame
    assert sender.load(0.01) == pytest.approx(164e-6 / 0.01, rel=1e-6)


def test_a_lone_node_loads_the_bus_but_for_its_suspension(bench: Bench) -> None:
    lone = bench.bus()
    lone.send(message(0x123, b"\x55" * 8))
    lone.sleep(0.1)
    assert lone.load(0.05) == pytest.approx(118 / 126, rel=0.01)
