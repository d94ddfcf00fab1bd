"""``cosim ping`` beside can-utils on the same bus, and through delays and losses of netem."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager

import numpy as np
import pytest

from bridge.can.interface import CanBusSpec
from bridge.ping.can import ASK, CanCodec, CanPath, CanQuestion
from bridge.ping.exchanges import NONE, Exchanges
from bridge.ping.figures import evaluate
from bridge.ping.measure import PacketCodec, PingPlan, measure
from bridge.ping.udp import UdpPath
from tests.vcan.peers import PATIENCE, call, listening, queueing

COSIM = (sys.executable, "-m", "cosim")
STAMP = re.compile(r"\((\d+)\.(\d{6})\) \w+ ([0-9A-F]+)#([0-9A-F]*)")
Logged = list[tuple[int, int, bytes]]


def logged(text: str) -> Logged:
    """Lines of ``candump -L``: time in us, identifier, data."""
    return [
        (int(s) * 1_000_000 + int(us), int(i, 16), bytes.fromhex(data))
        for s, us, i, data in STAMP.findall(text)
    ]


@contextmanager
def dumping(bus: str, found: Logged) -> Iterator[None]:
    """What candump sees meanwhile."""
    with listening(bus, "candump", "-L", bus) as dump:
        yield
        dump.send_signal(signal.SIGINT)
        found += logged(dump.communicate(timeout=PATIENCE)[0])


@contextmanager
def answering(*where: str) -> Iterator[subprocess.Popen[str]]:
    """``cosim pong`` as a process of its own."""
    process = subprocess.Popen([*COSIM, "pong", *where], stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None and "answers" in process.stderr.readline()
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE)


def test_frames_reach_both_ends_when_candump_sees_them(vcan: tuple[str, str]) -> None:
    """netem delays each frame by 3 ms on its way to all receivers."""
    bus, record, seen = vcan[0], Exchanges("can", 200, 8, 20_000_000), Logged()
    question = CanQuestion(ASK, b"", ASK + 1)
    spec = CanBusSpec(bus, interface="socketcan", channel=bus)
    with (
        queueing(bus, "netem", "delay", "3ms"),
        answering("can", bus),
        closing(CanPath(spec, question, ASK + 1)) as near,
        dumping(bus, seen),
    ):
        measure(near, CanCodec(), PingPlan(20_000_000, 200), record)
    assert record.sent == record.received == 200
    asked = np.array([t for t, i, _ in seen if i == ASK])
    answered = np.array([t for t, i, _ in seen if i == ASK + 1])
    t1, t2, t3, t4 = (record.stamp(name) * 1e-3 for name in ("t1", "t2", "t3", "t4"))
    # both read the kernel's stamps of the same frames; ours have the date's slew and its rounding
    np.testing.assert_allclose(t4 - t2, answered - asked, rtol=0, atol=50)
    assert np.min(t2 - t1) >= 2990 and np.min(t4 - t3) >= 2990  # us


def test_a_listener_finds_the_periods_and_losses_of_cangen(vcan: tuple[str, str]) -> None:
    bus, seen = vcan[0], Logged()
    words = [*COSIM, "ping", "listen", "can", bus, "--id", "123", "--duration", "0", "--json", "-"]
    with (
        queueing(bus, "netem", "loss", "5%"),
        dumping(bus, seen),
        listening(bus, *words) as ours,
    ):
        call("cangen", bus, "-g", "10", "-I", "123", "-L", "8", "-D", "i", "-n", "500")
        ours.send_signal(signal.SIGINT)
        found = json.loads(ours.communicate(timeout=PATIENCE)[0])["streams"]["123"]
    times = np.array([t for t, i, _ in seen if i == 0x123])  # us
    numbers = np.array([int.from_bytes(data, "little") for _, i, data in seen if i == 0x123])
    assert found["n"] == times.size
    # both have the kernel's stamps of the same frames
    assert found["period"]["p50"] * 1e6 == pytest.approx(np.median(np.diff(times)), abs=20)
    missing = int(np.sum(np.diff(numbers) - 1))
    assert missing > 5 and abs(found["lost"] - missing) <= 0.1 * missing


def test_delays_and_losses_of_netem_are_found_each_way() -> None:
    """On the loopback device every packet passes netem once: on its way there, and back."""
    n, period = 1000, 5_000_000
    record = Exchanges("udp", n, 128, period)
    with (
        queueing("lo", "netem", "delay", "30ms", "10ms", "loss", "4%", "limit", "10000"),
        answering("udp", "127.0.0.1:29555"),
        closing(UdpPath(("127.0.0.1", 29555))) as near,
    ):
        measure(near, PacketCodec(128), PingPlan(period, n), record)
    result = evaluate(record)
    assert result.same_host and result.there is not None and result.back is not None
    assert (record.stamp("t4") != NONE).sum() == record.received
    for delay in (result.there, result.back):
        found = np.nanquantile(delay, (0.0, 0.1, 0.5, 0.9)) * 1e3
        assert found[0] >= 20.0
        # uniform from 20 to 40 ms, and then this machine's lateness
        np.testing.assert_allclose(found[1:], (22, 30, 38), rtol=0.2)
    # 40 of 1000 in the mean, +- 5 standard deviations
    assert 10 <= n * result.loss.there <= 70 and 10 <= n * result.loss.back <= 70
