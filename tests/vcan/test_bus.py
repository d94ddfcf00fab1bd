"""Our buses on SocketCAN: the contract, and what only a kernel can do to them."""

from __future__ import annotations

import errno
from collections.abc import Iterator, Sequence
from pathlib import Path

import can
import pytest

from bridge.can.interface import CanBusSpec, SocketAttachment, attach
from bridge.can.log import FrameLog, read_log, rows_of, write_log
from bridge.can.socket import BusError, open_socket
from bridge.native import pace
from bridge.native.bus import Accept, Bus, BusState, last_second
from bridge.native.frame import Flags, Frame, frame_dtype
from bridge.native.journal import Journal
from tests.bridge.can.bus_contract import (
    BURST,
    BusContract,
    PythonCanPeer,
    collect,
    every_frame,
    keys,
    numbered,
    numbers,
)
from tests.vcan.peers import SO_RCVBUFFORCE, call, listening, queueing


@pytest.fixture
def ours(vcan: tuple[str, str]) -> Iterator[SocketAttachment]:
    attached = attach(CanBusSpec("a", "socketcan", vcan[0], fd=True))
    assert isinstance(attached, SocketAttachment)
    yield attached
    attached.close()


class TestSocketCan(BusContract):
    """Needs no fresh bus: nothing here takes it down."""

    @pytest.fixture
    def connect(self):
        def connect(log: Journal, accepts: Sequence[Accept] | None):
            device = can.Bus("vcan0", interface="socketcan", fd=True)
            device.socket.setsockopt(1, SO_RCVBUFFORCE, 16 << 20)
            spec = CanBusSpec("a", "socketcan", "vcan0", fd=True)
            return attach(spec, number=3, log=log, accepts=accepts), PythonCanPeer(device)

        return connect


def another(bus: str, fd: bool = True) -> PythonCanPeer:
    return PythonCanPeer(can.Bus(bus, interface="socketcan", fd=fd))


def test_an_interface_that_goes_down_is_state_and_comes_back(
    ours: SocketAttachment, vcan: tuple[str, str]
) -> None:
    call("ip", "link", "set", vcan[0], "down")
    assert ours.bus.drain() == [] and ours.bus.state == BusState.DOWN
    assert [ours.bus.send(Frame.of(1)) for _ in range(3)] == [errno.ENETDOWN] * 3
    health = ours.health(pace.now())
    assert (health.send_failed, health.last_error) == (3, "Network is down")
    assert health.sentence() == "a: down, 3 not sent, Network is down"
    call("ip", "link", "set", vcan[0], "up")
    assert ours.bus.send(Frame.of(1)) == 0
    assert (ours.bus.state, ours.bus.struct.restarts) == (BusState.ACTIVE, 1)


def test_who_only_receives_sees_that_the_interface_is_back(
    ours: SocketAttachment, vcan: tuple[str, str]
) -> None:
    call("ip", "link", "set", vcan[0], "down")
    assert ours.bus.drain() == [] and ours.bus.state == BusState.DOWN
    call("ip", "link", "set", vcan[0], "up")
    peer = another(vcan[0])
    peer.send([Frame.of(7)])
    assert keys(collect(ours.bus, 1)) == [(7, 0, b"")]
    assert ours.bus.state == BusState.ACTIVE
    peer.close()


def test_an_interface_that_is_taken_away_is_down(fresh_bus: str) -> None:
    ours = attach(CanBusSpec("a", "socketcan", fresh_bus))
    call("ip", "link", "del", "dev", fresh_bus)
    assert ours.bus.drain() == [] and ours.bus.state == BusState.DOWN
    assert ours.bus.send(Frame.of(1)) in (errno.ENODEV, errno.ENXIO)
    assert ours.health(pace.now()).interface is None
    ours.close()


def test_a_queue_that_is_full_on_the_way_in_is_counted(vcan: tuple[str, str]) -> None:
    """The count comes with the first frame that was queued after the loss."""
    with open_socket(vcan[0], receive_buffer=4096) as sock:
        bus, peer = Bus.from_socket(sock.fileno()), another(vcan[0])
        peer.send(numbered(200))
        found = numbers(bus.drain())
        peer.send(numbered(1, start=200))
        assert numbers(bus.drain()) == [200]
        assert found == list(range(len(found))) and len(found) < 200
        assert bus.struct.overruns == 200 - len(found)
        peer.close()


def test_a_queue_that_is_full_on_the_way_out_is_counted(
    ours: SocketAttachment, vcan: tuple[str, str]
) -> None:
    with queueing(vcan[0], "netem", "delay", "1s", "limit", "5"):
        results = [ours.bus.send(frame) for frame in numbered(50)]
    assert set(results) == {0, errno.ENOBUFS}
    health = ours.health(pace.now())
    assert health.send_failed == results.count(errno.ENOBUFS) == 50 - health.sent
    assert health.state == BusState.ACTIVE and not health.ok


@pytest.mark.parametrize(("length", "flags"), [(9, 0), (9, Flags.FD), (63, Flags.FD), (65, 1)])
def test_lengths_no_frame_has_are_refused(ours: SocketAttachment, length: int, flags: int) -> None:
    assert ours.bus.send(Frame.of(1, bytes(length), flags)) == errno.EINVAL
    assert ours.bus.struct.send_failed == 1


def test_a_classic_socket_neither_gives_nor_takes_can_fd(vcan: tuple[str, str]) -> None:
    classic, peer = attach(CanBusSpec("a", "socketcan", vcan[0])), another(vcan[0])
    peer.send([Frame.of(1, bytes(8), Flags.FD), Frame.of(2)])
    assert keys(collect(classic.bus, 1)) == [(2, 0, b"")]
    assert classic.bus.send(Frame.of(1, bytes(8), Flags.FD)) != 0
    peer.close()
    classic.close()


def test_a_wall_clock_that_was_set_is_seen_and_times_stay_where_they_can_be(
    ours: SocketAttachment, vcan: tuple[str, str]
) -> None:
    """As if it had been set by an hour since the last frame: the clock itself is left alone."""
    peer = another(vcan[0])
    peer.send([Frame.of(1)])
    assert len(collect(ours.bus, 1)) == 1 and ours.bus.drain() == []
    ours.bus.struct.offset_ns += 3600 * 10**9
    ours.bus.struct.wall_ns -= 10**9  # compared once a second: that is over
    before = pace.now()
    peer.send([Frame.of(2)])
    (frame,) = collect(ours.bus, 1)
    assert before <= frame.t_ns <= pace.now()
    assert ours.health(pace.now()).clock_steps == 1
    peer.close()


def test_a_log_has_every_frame_of_two_buses_and_their_load(
    vcan: tuple[str, str], tmp_path: Path
) -> None:
    log = Journal.create(tmp_path / "frames", frame_dtype(), 3 * BURST)
    sockets = [open_socket(bus, fd=True) for bus in vcan]
    buses = [Bus.from_socket(sock.fileno(), i, log) for i, sock in enumerate(sockets)]
    peers = [another(bus) for bus in vcan]
    for k, frame in enumerate(numbered(BURST)):
        peers[k % 2].send([frame])
        collect(buses[k % 2], 1)
    rows = Journal.open(log.path)
    for i in range(2):
        mine = rows[rows["bus"] == i]
        assert [int.from_bytes(r["data"][:8].tobytes(), "little") for r in mine] == list(
            range(i, BURST, 2)
        )
        traffic = buses[i].traffic
        assert traffic.frames == BURST // 2
        end = int(mine["t_ns"][-1])
        rate = last_second(traffic, end + 100_000_000)
        assert 0 < rate.frames <= BURST // 2
        assert rate.bits == pytest.approx(rate.frames * (111 + 98 / 30))
        assert last_second(traffic, end + 3 * 10**9).frames == 0
    for thing in (*sockets, *peers):
        thing.close()


def test_candump_reads_what_we_send_and_we_read_what_it_writes(
    ours: SocketAttachment, vcan: tuple[str, str], tmp_path: Path
) -> None:
    frames = [frame for frame in every_frame() if not frame.flags & Flags.ESI]
    with listening(vcan[0], "candump", "-L", vcan[0]) as process:
        for frame in frames:
            assert ours.bus.send(frame) == 0
        assert process.stdout
        text = "".join(process.stdout.readline() for _ in frames)
    (tmp_path / "a.log").write_text(text)
    assert keys(list(read_log(tmp_path / "a.log").frames())) == keys(frames)


def test_canplayer_plays_what_we_write(
    ours: SocketAttachment, vcan: tuple[str, str], tmp_path: Path
) -> None:
    frames = every_frame()
    for k, frame in enumerate(frames):
        frame.t_ns = 10**9 + k * 1000
    write_log(FrameLog(rows_of(frames), ("left",)), tmp_path / "a.log")
    call("canplayer", "-t", "-I", str(tmp_path / "a.log"), f"{vcan[0]}=left")
    assert keys(collect(ours.bus, len(frames))) == keys(frames)


def test_what_is_wrong_with_an_interface_is_said(vcan: tuple[str, str]) -> None:
    with pytest.raises(BusError, match=r"vcan9: no such network interface; there are .*vcan0"):
        open_socket("vcan9")
    with pytest.raises(BusError, match=r"lo: not a CAN interface; there are .*vcan0"):
        open_socket("lo")
    with pytest.raises(BusError, match="513 filters; the kernel takes 512"):
        open_socket(vcan[0], accepts=[Accept(1, 1)] * 513)
    call("ip", "link", "set", vcan[0], "down")
    with pytest.raises(BusError, match=f"the interface is down: `ip link set {vcan[0]} up`"):
        open_socket(vcan[0])


def test_the_command_that_the_error_names_gives_can_fd(vcan: tuple[str, str]) -> None:
    call("ip", "link", "set", vcan[0], "down")
    call("ip", "link", "set", vcan[0], "mtu", "16", "up")
    with pytest.raises(BusError, match="its MTU is 16, CAN FD takes 72") as caught:
        open_socket(vcan[0], fd=True)
    for command in str(caught.value).split("`")[1].split("; "):
        call(*command.split())
    open_socket(vcan[0], fd=True).close()
