"""Simulated buses between processes: ``cosim`` at an address, socketcand, the command."""

from __future__ import annotations

import itertools
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import msgpack  # type: ignore[import-untyped]
import pytest

from bridge.bus_server.listener import ServerError, listen
from bridge.bus_server.record import BusRecord
from bridge.bus_server.server import BusServer
from bridge.bus_server.socketcand import SocketcandServer
from bridge.simulated_can.bus import CosimBus
from bridge.simulated_can.channel import Channel
from bridge.simulated_can.options import (
    ChannelOperationError,
    ChannelOptionError,
    PortOptions,
    channel_options,
)
from bridge.simulated_can.protocol import parse_address
from cosim.bus.frames import BusFrame
from cosim.bus.settings import ScriptedError
from cosim.bus.timing import BusTiming, frame_bits
from tests.bridge.simulated_can.benches import everything, message
from tests.cli.command import Command

ROOT = Path(__file__).parents[3]
COMMAND = (sys.executable, "-c", "from cosim.cli import main; main()", "bus")


class Served:
    """A channel that is served at a port of this machine."""

    def __init__(self, **options: object) -> None:
        given = {"bitrate": 1_000_000, "speed": "simulated", **options}
        self.channel = Channel("bench", channel_options("bench", **given))
        self.server = BusServer(self.channel, listen(parse_address("bench@127.0.0.1:0")))
        self.name = f"bench@127.0.0.1:{self.server.port}"
        self.buses: list[CosimBus] = []

    def bus(self, **options: object) -> CosimBus:
        self.buses.append(CosimBus(self.name, **options))
        return self.buses[-1]

    def close(self) -> None:
        for bus in self.buses:
            bus.shutdown()
        self.server.close()


@pytest.fixture
def served() -> Iterator[Served]:
    found = Served()
    yield found
    found.close()


def test_buses_of_other_connections_arbitrate_and_have_exact_times(served: Served) -> None:
    a, b, c = served.bus(), served.bus(), served.bus()
    a.send(message(0x300))
    b.send(message(0x100, b"\x55" * 8))
    first, second = everything(c)
    assert (first.arbitration_id, second.arbitration_id) == (0x100, 0x300)
    assert bytes(first.data) == b"\x55" * 8
    bits = frame_bits(0x300, b"").nominal
    assert second.timestamp - first.timestamp == pytest.approx(bits * 1e-6, abs=1e-12)
    assert first.channel == served.name
    assert first.is_rx


def test_everything_that_a_bus_has_here_it_has_there(served: Served) -> None:
    a = served.bus(receive_own_messages=True, bus_errors=True)
    b = served.bus(can_filters=[{"can_id": 0x120, "can_mask": 0x7F0, "extended": False}])
    a.disturb(ScriptedError(0x123, 30))
    a.send(message(0x123, b"\x55" * 8))
    a.send(message(0x200, b"\1"))
    got = everything(b)
    assert [m.arbitration_id for m in got if not m.is_error_frame] == [0x123]
    own = everything(a)
    assert any(m.is_error_frame for m in own)
    assert [m.is_rx for m in own if not m.is_error_frame] == [False, False]
    assert (a.state, a.error_counters.tec, b.lost) == (can.BusState.ACTIVE, 6, 0)
    before = a.time
    a.sleep(0.5)
    assert a.time - before == pytest.approx(0.5)
    assert 0 <= a.load(1.0) < 0.01
    a.flush_tx_buffer()
    a.reset()
    b.set_filters(None)
    a.sleep(0.1)
    a.send(message(0x200))
    assert b.recv(1).arbitration_id == 0x200


def test_periodic_messages_keep_the_time_of_the_bus(served: Served) -> None:
    a, b = served.bus(), served.bus()
    task = a.send_periodic(message(0x10, b"\1"), 0.01, 0.045)
    got = everything(b)
    assert len(got) == 5
    gaps = [y.timestamp - x.timestamp for x, y in itertools.pairwise(got)]
    assert gaps == pytest.approx([0.01] * 4, abs=1e-9)
    task.modify_data(message(0x10, b"\2"))
    task.start()
    assert {bytes(m.data) for m in everything(b)} == {b"\2"}
    task.stop()


def test_a_thread_sends_while_another_waits(served: Served) -> None:
    a, b = served.bus(), served.bus()
    heard: list[can.Message] = []
    notifier = can.Notifier(b, [heard.append], timeout=0.1)
    b.send(message(0x11))
    assert a.recv(5).arbitration_id == 0x11
    a.send(message(0x22))
    end = time.monotonic() + 10
    while not heard and time.monotonic() < end:
        time.sleep(0.01)
    notifier.stop()
    assert [m.arbitration_id for m in heard] == [0x22]


def test_a_client_that_dies_leaves_the_bus(served: Served) -> None:
    code = (
        "import can, os; "
        f"b = can.Bus(interface='cosim', channel='{served.name}'); "
        "b.send(can.Message(arbitration_id=5, is_extended_id=False)); os._exit(9)"
    )
    watcher = served.bus()
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False)
    assert watcher.recv(5).arbitration_id == 5
    end = time.monotonic() + 10
    while len(served.channel.ports) > 1 and time.monotonic() < end:
        time.sleep(0.01)
    assert len(served.channel.ports) == 1


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"bitrate": 250_000}, "found bitrate=250000 bit/s, expected 1000000 bit/s"),
        ({"speed": 2.0}, "found speed=2, expected simulated"),
        ({"tx_queue_size": 0}, "found tx_queue_size=0"),
    ],
)
def test_options_that_differ_are_refused(
    served: Served, options: dict[str, object], text: str
) -> None:
    with pytest.raises(ChannelOptionError, match=re.escape(text)):
        served.bus(**options)


def test_what_cannot_be_is_said(served: Served, tmp_path: Path) -> None:
    with pytest.raises(ChannelOptionError, match="expected NAME@HOST:PORT"):
        CosimBus("bench@nowhere")
    with pytest.raises(ChannelOptionError, match="a server of the channel 'bench' only"):
        CosimBus(served.name.replace("bench", "other"))
    with pytest.raises(ChannelOptionError, match="no server answers at"):
        CosimBus(f"bench@{tmp_path}/none")
    with pytest.raises(ServerError, match=r"Address already in use.*; expected an address"):
        listen(parse_address(served.name))
    bus = served.bus(tx_queue_size=1)
    bus.send(message(1))
    with pytest.raises(ChannelOperationError, match="found 1 frames in the transmit queue"):
        bus.send(message(1))
    served.server.close()
    with pytest.raises(ChannelOperationError, match=r"the connection to .* closed"):
        bus.recv(0)


def test_a_unix_socket_is_an_address_too(tmp_path: Path) -> None:
    path = f"{tmp_path}/bench.sock"
    for _ in range(2):  # what a server that was killed has left is no obstacle
        channel = Channel("bench", channel_options("bench", bitrate=1e6, speed="simulated"))
        server = BusServer(channel, listen(parse_address(f"bench@{path}")))
        with CosimBus(f"bench@{path}") as a, CosimBus(f"bench@{path}") as b:
            a.send(message(0x77))
            assert b.recv(1).arbitration_id == 0x77
        with pytest.raises(ServerError, match="expected an address that is free"):
            listen(parse_address(f"bench@{path}"))
        server.close()
        stale = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        stale.bind(path)
        stale.close()


@pytest.fixture
def candaemon() -> Iterator[tuple[Channel, int]]:
    channel = Channel("bench", channel_options("bench", bitrate=500e3))
    server = SocketcandServer(channel, listen(parse_address("bench@127.0.0.1:0")))
    yield channel, server.port
    server.close()


GARBAGE = [
    b"GET / HTTP/1.1\r\n\r\n", b"\xff\xff\xff\xff", b"\0\0\0\0",
    *(len(x).to_bytes(4, "big") + x for x in (
        b"\x91" * 5000, b"\xc1", b"\xa3\xff\xfe\x80", b"\x81\x01\x02", b"\x01\x02", b"\x93\x01",
        msgpack.packb(None), msgpack.packb([]), msgpack.packb(["join"]), msgpack.packb([1, 2, 3]),
        msgpack.packb(["join", [], "x"]), msgpack.packb(["open"]), msgpack.packb("open"),
        msgpack.packb(["open", "bench", {"bitrate": "x"}, {"queue": 9}]),
    )),
]  # fmt: skip


@pytest.mark.parametrize("data", GARBAGE)
def test_garbage_of_a_client_ends_its_connection_and_nothing_else(
    served: Served, data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    failed: list[object] = []
    monkeypatch.setattr(threading, "excepthook", failed.append)
    with socket.create_connection(("127.0.0.1", served.server.port)) as stranger:
        stranger.sendall(data)
        stranger.shutdown(socket.SHUT_WR)
        stranger.settimeout(20)
        while stranger.recv(4096):
            pass
    a, b = served.bus(), served.bus()
    a.send(message(1))
    assert (b.recv(1.0) or message(0)).arbitration_id == 1
    assert failed == []


@pytest.mark.parametrize(
    "call",
    [
        ("filter", [["x", 1, None]]),
        ("filter", [7]),
        ("send", ["x", 0, 0, b"", 0.0], None),
        ("periodic", [["x", 0, 0, b"", 0.0]], 0.1, None),
        ("periodic", [[1, 0, 0, b"", 0.0]], float("nan"), None),
        ("sleep", float("inf")),
        ("load", None),
        ("start", 99),
        ("__class__",),
        ("disturb", "ErrorRate", {"rate": []}),
    ],
)  # fmt: skip
def test_a_call_that_makes_no_sense_is_refused_and_disturbs_nobody(
    served: Served, call: tuple[Any, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    failed: list[object] = []
    monkeypatch.setattr(threading, "excepthook", failed.append)
    a, b = served.bus(), served.bus()
    with pytest.raises(ChannelOperationError):
        a._place.call(*call)
    a.send(message(1))
    assert (b.recv(1.0) or message(0)).arbitration_id == 1
    assert failed == []


def test_bytes_that_are_no_ascii_are_answered(candaemon: tuple[Channel, int]) -> None:
    with socket.create_connection(("127.0.0.1", candaemon[1])) as client:
        client.settimeout(20)
        client.sendall(b"<\xff\xfe> < open bench >")
        said = b""
        while b"< ok >" not in said:
            said += client.recv(4096)
    assert b"expected open" in said


def test_python_cans_socketcand_is_an_independent_client(candaemon: tuple[Channel, int]) -> None:
    _, port = candaemon
    options = {"interface": "socketcand", "host": "127.0.0.1", "port": port}
    with can.Bus(channel="bench", **options) as a, can.Bus(channel="bench", **options) as b:
        sent = [
            message(0x123, b"\x01\xf1"),
            message(0x18DAF110, bytes(range(8)), is_extended_id=True),
            message(0x7FF),
        ]
        for each in sent:
            a.send(each)
        for each in sent:
            got = b.recv(10)
            assert got is not None
            assert got.equals(each, timestamp_delta=None, check_channel=False)
        b.send(message(0x001, b"\xff"))
        assert a.recv(10).arbitration_id == 1


def test_socketcand_says_what_it_does_not_understand(candaemon: tuple[Channel, int]) -> None:
    _, port = candaemon
    with socket.create_connection(("127.0.0.1", port), timeout=10) as client:
        stream = client.makefile("rb")

        def said() -> str:
            text = b""
            while not text.endswith(b">"):
                text += stream.read(1)
            return text.decode()

        def ask(text: str) -> str:
            client.sendall(text.encode())
            return said()

        assert said() == "< hi >"
        assert ask("< rawmode >") == "< error found 'rawmode', expected open >"
        assert ask("< open other >") == "< error could not open bus other >"
        assert ask("< open bench >") == "< ok >"
        assert ask("< echo >") == "< echo >"
        assert ask("< rawmode >") == "< ok >"
        assert "1 bytes for a length of 2" in ask("< send 123 2 1 >")
        assert "error found 'subscribe 0 0 12'" in ask("< subscribe 0 0 12 >")


def test_the_command_serves_says_where_and_ends_with_an_account(tmp_path: Path) -> None:
    picture = tmp_path / "bus.png"
    process = subprocess.Popen(
        [
            *COMMAND, "--bitrate", "500000", "--load", "30%",
            "--listen", "127.0.0.1:0", "--picture", str(picture),
        ],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
    )  # fmt: skip
    assert process.stdout and process.stderr
    said = process.stdout.readline()
    found = re.search(r'channel="(bench@127\.0\.0\.1:\d+)"', said)
    assert found, process.stderr.read()
    with CosimBus(found[1]) as bus:
        got = [bus.recv(10) for _ in range(20)]
        bus.send(message(0x001))
        assert all(m is not None for m in got)
    process.send_signal(2)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert re.search(r"s: load \d+\.\d%", out)
    assert "identifier" in out
    assert picture.stat().st_size > 5000
    assert not err


@pytest.fixture
def cosim(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """The command in this process, in the folder of the checkout."""
    monkeypatch.chdir(ROOT)
    return Command(monkeypatch, capsys)


def test_the_logger_of_python_can_prints_what_a_served_bus_carries() -> None:
    """The program that comes with python-can, unchanged, in a process of its own."""
    if "cosim" not in can.VALID_INTERFACES:
        pytest.skip("installed before the entry point was there: pip install -e . again")
    served = Served(speed=1.0)
    logger = [sys.executable, "-u", "-m", "can.logger", "-i", "cosim", "-c", served.name]
    process = subprocess.Popen(logger, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert any("Logger" in line for line in process.stdout)
        sender = served.bus()
        for i in range(5):
            sender.send(message(0x100 + i, bytes([i])))
        lines = list(itertools.islice((x for x in process.stdout if "ID:" in x), 5))
    finally:
        process.kill()
        process.communicate()
        served.close()
    found = [re.findall(r"ID:\s+(\w+).*DL:\s+1\s+(\w+)", line)[0] for line in lines]
    assert found == [(f"10{i}", f"0{i}") for i in range(5)]


def test_the_command_runs_a_dbc_file_in_simulated_time(cosim: Command) -> None:
    done = cosim(
        "bus", "--listen", "127.0.0.1:0", "--load", "configs/can/link_fd2.dbc", "--fd", "--speed",
        "simulated", "--for", "0.2", "--bitrate", "1000000", "--data-bitrate", "5000000",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert done.out.count("\n3A") >= 2
    assert "0.200 s: load" in done.out


def test_a_record_knows_the_nodes_that_were_there_before(served: Served) -> None:
    """A client may join between the address of a bus and its record."""
    a, b = served.bus(), served.bus()
    record = BusRecord()
    served.channel.record(record)
    a.send(message(0x123))
    assert b.recv(1).arbitration_id == 0x123
    a.sleep(0.01)
    assert len(record.names) == 2
    assert any(line.startswith("123") for line in record.lines(served.channel.timing))


def test_what_happens_after_the_end_is_not_in_the_account(
    cosim: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Clients leave, and may still send, while the account is made."""
    opened: list[Channel] = []
    record, account = Channel.record, BusRecord.lines

    def watched(channel: Channel, recorder: BusRecord | None) -> None:
        opened.append(channel)
        record(channel, recorder)

    def disturbed(found: BusRecord, timing: BusTiming) -> Iterator[str]:
        before = list(account(found, timing))
        late = opened[0].open(PortOptions())
        opened[0].send(late, message(0x7), None)
        opened[0].sleep(0.01)
        assert list(account(found, timing)) == before
        return iter(before)

    monkeypatch.setattr(Channel, "record", watched)
    monkeypatch.setattr(BusRecord, "lines", disturbed)
    done = cosim("bus", "--listen", "127.0.0.1:0", "--for", "0.02", "--load", "30%")
    assert done.code == 0, done.err
    assert ": load " in done.out


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--load", "nothing.dbc"], "nothing.dbc: "),
        (["--load", "abc%"], "--load abc%: expected a number"),
        (["--load", "none.log"], "found no such file"),
        (["--listen", "here"], "expected NAME@HOST:PORT"),
        (["--mirror", "nocan7"], "nocan7: "),
        (["--bitrate", "-5"], "found a bit rate of -5"),
        (["--load", "configs/can/link_fd2.dbc"], "CAN FD frames on a classic bus"),
    ],
)
def test_bad_arguments_get_one_sentence(cosim: Command, arguments: list[str], text: str) -> None:
    done = cosim("bus", "--listen", "127.0.0.1:0", "--for", "0.01", *arguments)
    assert done.code != 0
    assert text in " ".join(done.err.split())
    assert "Traceback" not in done.err


def test_a_port_in_use_is_said(cosim: Command) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        done = cosim("bus", "--listen", f"127.0.0.1:{port}", "--for", "0.01")
    assert done.code != 0
    assert f"127.0.0.1:{port}: Address already in use" in " ".join(done.err.split())


def test_frames_of_a_load_are_nodes_that_only_send() -> None:
    channel = Channel("bench", channel_options("bench", bitrate=1e6, speed="simulated"))
    node = channel.add_node("talker")
    from bridge.simulated_can.options import PortOptions

    ears = [channel.open(PortOptions()) for _ in range(2)]
    channel.offer([(10**9, node, BusFrame(0x42))])
    got = channel.receive(ears[0], lambda m: True, 1.0)
    assert got is not None
    assert got.arbitration_id == 0x42
    assert got.timestamp == pytest.approx(0.001 + (frame_bits(0x42, b"").nominal - 3) * 1e-6)
