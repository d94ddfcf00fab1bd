"""Real sockets and sessions: both ends, and a relay of known delays between processes."""

import contextlib
import json
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from bridge.cli.paths.path import PathRequest, ping_path, requests
from bridge.cli.paths.several import ping_several
from bridge.ping.can import CanResponder
from bridge.ping.exchanges import Arrival, Exchanges
from bridge.ping.figures import evaluate
from bridge.ping.measure import PacketCodec, PingPlan, PingResponder, measure
from bridge.ping.packet import PingPacket, decode
from bridge.ping.udp import UdpPath, parse_address
from bridge.ping.zenoh import zenoh_path, zenoh_responder
from cosim.base import clock
from cosim.base.clock import monotonic_ns
from cosim.base.errors import CosimError, RunError
from tests.bridge.zenoh.ends import endpoint


@contextmanager
def answering(responder: PingResponder | CanResponder) -> Iterator[None]:
    going = threading.Event()

    def serve() -> None:
        while not going.is_set():
            responder.serve(monotonic_ns() + 20_000_000)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield
    finally:
        going.set()
        thread.join()


def test_udp_between_two_sockets(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    end = UdpPath(("127.0.0.1", 0), listen=True)
    responder = PingResponder(end)
    with answering(responder):
        ping_path(
            PathRequest("udp", f"127.0.0.1:{end.port}", 1000, 100, 0.1, tmp_path),
            tmp_path / "said.json",
        )
    end.close()
    found = json.loads((tmp_path / "said.json").read_text("utf-8"))
    assert found["answered"] == found["sent"] == responder.answered == 100
    assert found["same_clock"] and found["uncertainty"] == 0
    delays = found["delays"]
    assert 0 < delays["there"]["min"] < delays["round trip"]["max"] < 1
    assert found["parts"]["network, both ways"] > 0 and found["parts"]["turn-round"] > 0
    assert (tmp_path / "there.csv").is_file() and "back" in found["links"]


def test_an_answer_is_as_long_as_its_question_and_other_packets_get_none() -> None:
    end = UdpPath(("127.0.0.1", 0), listen=True)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking, answering(PingResponder(end)):
        asking.settimeout(5)
        asking.connect(("127.0.0.1", end.port))
        asking.send(b"something else" * 20)
        asking.send(PacketCodec(333).question(0, 1))
        assert len(asking.recv(4000)) == 333
    end.close()


def test_zenoh_between_two_sessions(tmp_path: Path) -> None:
    at = endpoint(tmp_path)
    record = Exchanges("zenoh", 50, 128, 2_000_000)
    with (
        zenoh_responder(at) as far,
        zenoh_path(at) as near,
        answering(PingResponder(far)),
    ):
        measure(near, PacketCodec(128), PingPlan(2_000_000, 50), record)
    found = evaluate(record)
    assert record.received == 50 and found.same_host and found.there is not None
    assert 0 < found.there.min() < 1


@pytest.mark.parametrize(
    ("kind", "target", "said"),
    [
        ("udp", [], "found 'udp'; expected udp HOST"),
        ("udp", ["a", "can"], "found 'udp a can'; expected udp HOST"),
        ("udp", ["a", "b", "a"], "found 'udp a b a'; expected .* several of them, each once"),
        ("tcp", ["x"], "found 'tcp x'; expected udp HOST"),
        ("udp", ["127.0.0.1:x"], "port 'x'; expected HOST or HOST:PORT"),
        ("udp", ["127.0.0.1:99999"], "port '99999'"),
    ],
)
def test_what_is_no_path_is_refused(
    kind: str, target: list[str], said: str, tmp_path: Path
) -> None:
    with pytest.raises(CosimError, match=said):
        [request] = requests(kind, target, PathRequest(kind, "", 1, 100, 1, tmp_path))
        ping_path(request, None)


def test_several_paths_have_folders_of_their_own(tmp_path: Path) -> None:
    common = PathRequest("", "", 1, 100, 1, tmp_path)
    found = requests("udp", ["a:1", "b", "zenoh", "can", "can0"], common)
    assert [r.name for r in found] == ["udp a:1", "udp b", "zenoh", "can can0"]
    assert [r.out.name for r in found] == ["udp-a-1", "udp-b", "zenoh", "can-can0"]
    [one] = requests("udp", ["a"], common)
    assert one.out == tmp_path


def test_several_paths_are_measured_at_once_and_one_that_fails_does_not_end_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ends = [UdpPath(("127.0.0.1", 0), listen=True) for _ in range(2)]
    with answering(PingResponder(ends[0])), answering(PingResponder(ends[1])):
        common = PathRequest("", "", 200, 100, 0.2, tmp_path)
        where = [f"127.0.0.1:{end.port}" for end in ends]
        ping_several(requests("udp", where, common), None)
        printed = capsys.readouterr().out.splitlines()
        with pytest.raises(RunError, match=r"^udp nowhere\.invalid:29531: "):
            ping_several(
                requests("udp", [*where[:1], "nowhere.invalid"], common), tmp_path / "said.json"
            )
        [left] = json.loads((tmp_path / "said.json").read_text("utf-8"))["paths"].items()
    for end in ends:
        end.close()
    assert left[0] == f"udp {where[0]}" and left[1]["answered"] == 40
    assert [line.split()[:2] for line in printed[1:3]] == [["udp", w] for w in where]
    assert all(line.endswith("40") for line in printed[1:3])
    folders = [tmp_path / f"udp-{w.replace(':', '-')}" for w in where]
    assert printed[-1] == f"report: {folders[1] / 'report.html'}"
    assert (folders[0] / "there.csv").is_file() and (folders[0] / "report.html").is_file()


def test_addresses() -> None:
    assert parse_address("h:12") == ("h", 12)
    assert parse_address("h", 5) == ("h", 5)
    assert parse_address("[::1]:7") == ("::1", 7)
    assert parse_address("::1", 5) == ("::1", 5)
    with pytest.raises(RunError, match="expected HOST"):
        parse_address("h:")


class CannedPath:
    """A path whose arrivals are given; answers are kept."""

    def __init__(self, *questions: PingPacket) -> None:
        self._arriving = [Arrival(q.encode(128), monotonic_ns(), 0, "x") for q in questions]
        self.answers: list[PingPacket] = []

    def send(self, data: bytes, to: object = None) -> None:
        found = decode(data)
        assert to == "x" and found is not None
        self.answers.append(found)

    def receive(self, until_ns: int) -> list[Arrival]:
        found, self._arriving = self._arriving, []
        return found

    def close(self) -> None:
        """Nothing to close."""


def test_an_overtaken_first_question_does_not_begin_a_new_measurement() -> None:
    asked = [(1, 2_000), (0, 1_000), (2, 3_000), (0, 9_000), (1, 10_000)]  # the second 0 does
    path = CannedPath(*(PingPacket(False, 7, k, t1) for k, t1 in asked))
    PingResponder(path).serve(0)
    assert [answer.heard for answer in path.answers] == [1, 2, 3, 1, 2]


def test_an_interruption_between_two_clocks_does_not_make_a_packet_older(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [0]

    def later(by: int) -> int:
        now[0] += by
        return now[0]

    pauses = iter([0, 5_000_000, 0, 0, 1_500, 0])  # before each reading of a clock
    monkeypatch.setattr(clock, "monotonic_ns", lambda: later(next(pauses)))
    monkeypatch.setattr(clock, "realtime_ns", lambda: 10**18 + later(next(pauses)))
    found, date = clock.now_and_date()
    assert abs(date - 10**18 - found) <= clock.CLOSE_NS


def test_pong_answers_on_all_addresses_of_both_families() -> None:
    with contextlib.closing(UdpPath(("", 0), listen=True)) as end, answering(PingResponder(end)):
        for host in ("127.0.0.1", "::1"):
            record = Exchanges(host, 20, 128, 2_000_000)
            with contextlib.closing(UdpPath((host, end.port))) as near:
                measure(near, PacketCodec(128), PingPlan(2_000_000, 20), record)
            assert record.received > 0, host


def test_ctrl_c_waits_for_the_last_answers() -> None:
    """Else those on their way would be an outage at the end."""
    codec = PacketCodec(128)
    waiting: list[bytes] = []
    interrupted: list[bool] = []

    class Slow(CannedPath):
        """Everything comes after the interruption."""

        def send(self, data: bytes, to: object = None) -> None:
            waiting.append(data)

        def receive(self, until_ns: int) -> list[Arrival]:
            if not interrupted:
                return []
            asked = [decode(data) for data in waiting]
            waiting.clear()
            now = monotonic_ns()
            return [Arrival(q.answered(t2=1, t3=1).encode(), now) for q in asked if q]

    def show(_: Exchanges) -> None:
        interrupted.append(True)
        raise KeyboardInterrupt

    record = Exchanges("slow", 100, 128, 200_000_000)
    measure(Slow(), codec, PingPlan(200_000_000, None), record, show)
    assert record.received == record.sent > 0
