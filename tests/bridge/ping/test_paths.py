"""Real sockets and sessions: both ends, and a relay of known delays between processes."""

import heapq
import json
import select
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from bridge.cli.ping_path import ping_path
from bridge.ping.can import CanResponder
from bridge.ping.exchanges import Exchanges
from bridge.ping.figures import evaluate
from bridge.ping.measure import PacketCodec, PingPlan, PingResponder, measure
from bridge.ping.udp import UdpPath, parse_address
from bridge.ping.zenoh import zenoh_path, zenoh_responder
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
            "udp", [f"127.0.0.1:{end.port}"], rate=1000, size=100, duration=0.1, json_=True,
            out=tmp_path,
        )  # fmt: skip
    end.close()
    found = json.loads(capsys.readouterr().out)
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
        ("udp", [], "expected udp HOST"),
        ("tcp", ["x"], "found 'tcp x'; expected udp HOST"),
        ("udp", ["127.0.0.1:x"], "port 'x'; expected HOST or HOST:PORT"),
        ("udp", ["127.0.0.1:99999"], "port '99999'"),
    ],
)
def test_what_is_no_path_is_refused(
    kind: str, target: list[str], said: str, tmp_path: Path
) -> None:
    with pytest.raises(CosimError, match=said):
        ping_path(
            kind, target, rate=1, size=100, duration=1, json_=False,
            out=tmp_path,
        )  # fmt: skip


def test_addresses() -> None:
    assert parse_address("h:12") == ("h", 12)
    assert parse_address("h", 5) == ("h", 5)
    assert parse_address("[::1]:7") == ("::1", 7)
    assert parse_address("::1", 5) == ("::1", 5)
    with pytest.raises(RunError, match="expected HOST"):
        parse_address("h:")


SKEWED = """
import sys
from bridge.ping import measure, udp
from cosim.base import clock
ahead, drift = float(sys.argv[1]), float(sys.argv[2])
true = clock.monotonic_ns
start = true()
def skewed():
    now = true()
    return now + round(ahead * 1e9 + drift * (now - start))
measure.monotonic_ns = udp.monotonic_ns = skewed
measure.clock_number = lambda clock: 1
end = udp.UdpPath(("127.0.0.1", 0), listen=True)
print(end.port, start, flush=True)
measure.PingResponder(end).serve(1 << 62)
"""


@dataclass
class UdpRelay:
    """Forwards between a client and `to`, each packet later by a drawn delay; some it loses.

    `added`: (direction, arrival ns, departure ns, lost) of each packet, in order of arrival.
    """

    to: tuple[str, int]
    rng: np.random.Generator
    least: tuple[float, float]
    loss: float
    added: list[tuple[int, int, int, bool]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.front.bind(("127.0.0.1", 0))
        self.back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.back.connect(self.to)
        self.stop = threading.Event()
        self._client: object = None
        self._waiting: list[tuple[int, int, int, bytes]] = []

    def run(self) -> None:
        while not self.stop.is_set():
            left = self._waiting[0][0] - monotonic_ns() if self._waiting else 50_000_000
            ready, _, _ = select.select([self.front, self.back], [], [], max(0, left) * 1e-9)
            for direction, end in enumerate((self.front, self.back)):
                if end in ready:
                    self._take(direction, end)
            while self._waiting and self._waiting[0][0] <= monotonic_ns():
                _, number, direction, data = heapq.heappop(self._waiting)
                with suppress(OSError):
                    self.back.send(data) if not direction else self.front.sendto(data, self._client)
                way, came, _, lost = self.added[number]
                self.added[number] = way, came, monotonic_ns(), lost

    def _take(self, direction: int, end: socket.socket) -> None:
        data, sender = end.recvfrom(4096)
        now = monotonic_ns()
        if not direction:
            self._client = sender
        wait = self.least[direction] + self.rng.exponential(2e-3)
        lost = bool(self.rng.random() < self.loss)
        self.added.append((direction, now, 0, lost))
        if not lost:
            number = len(self.added) - 1
            heapq.heappush(self._waiting, (now + round(wait * 1e9), number, direction, data))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_each_way_through_a_relay_is_within_the_stated_uncertainty(seed: int) -> None:
    """Another process with another clock answers; a relay delays each direction differently."""
    rng = np.random.default_rng(seed)
    drift = rng.uniform(-100e-6, 100e-6)
    far = subprocess.Popen(
        [sys.executable, "-c", SKEWED, str(rng.uniform(-1e4, 1e4)), str(drift)],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert far.stdout is not None
    port = int(far.stdout.readline().split()[0])
    least = tuple(rng.uniform(0.001, 0.05, 2))
    relay = UdpRelay(("127.0.0.1", port), rng, least, loss=0.02)
    thread = threading.Thread(target=relay.run)
    thread.start()
    near = UdpPath(relay.front.getsockname())
    record = Exchanges("relay", 400, 128, 5_000_000)
    try:
        measure(near, PacketCodec(128), PingPlan(5_000_000, 400), record)
    finally:
        relay.stop.set()
        thread.join()
        far.kill()
        far.wait()
        near.close()
    found = evaluate(record)
    assert found.there is not None and found.below is not None and found.above is not None
    assert not found.same_host
    asked = [row for row in relay.added if row[0] == 0]
    assert len(asked) == 400
    waited = np.array([(left - came) * 1e-9 for _, came, left, _ in asked])
    known = ~np.isnan(found.there)
    # The relay adds its own way and wake-up on both sides, less than the whole round trip has left.
    assert np.all(waited[known] <= (found.there + found.above)[known])
    own = found.rtt[known] - waited[known] - least[1]
    assert np.all((found.there - found.below)[known] <= waited[known] + own)
    assert found.loss.there == pytest.approx(np.mean([r[3] for r in asked]), abs=0.006)
    assert found.clock is not None
    slowest, _, fastest = found.clock.drift
    assert slowest - 1e-6 <= drift <= fastest + 1e-6
    assert found.uncertainty < sum(least) / 2 * 1.3 + 0.005
