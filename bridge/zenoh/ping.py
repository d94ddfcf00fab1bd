"""Round trips over a Zenoh bus between two nodes, and estimates of the one-way delays.

The pinging node publishes ``PREFIX/NODE/ping``; the other node answers on ``PREFIX/OTHER/pong``
with the time of reception. The clocks may differ: their difference is estimated from the fastest
round trip, whose two directions are assumed to take equally long. The size of a ping is that of a
message with four values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
import zenoh
from numpy.typing import NDArray

from bridge.deployment.zenoh_keys import Names, codec
from bridge.native import pace
from bridge.native.message import Decoded
from bridge.zenoh.channel import control_publisher
from cosim.base.clock import sleep, stopwatch
from cosim.base.errors import RunError

SIGNALS = ("number", "sent", "heard", "reserved")
Floats = NDArray[np.float64]
_LINGER = 3.0


@dataclass(frozen=True, slots=True)
class PingResult:
    """`sent` (n,), s from the first; `rtt`, `there`, `back` (n,), s, NaN where nothing came back.

    `offset`: the other's clock less ours, s, as the fastest round trip has it.
    """

    sent: Floats
    rtt: Floats
    there: Floats
    back: Floats
    offset: float

    @property
    def loss(self) -> float:
        """Part of the pings that did not come back."""
        return float(np.isnan(self.rtt).mean())

    @property
    def jitter(self) -> float:
        """Standard deviation of the round trips, s."""
        return float(np.nanstd(self.rtt))


@final
class Echo:
    """Answers the pings of `other` at `node` until it is closed; on Zenoh's threads."""

    def __init__(
        self, session: zenoh.Session, names: Names, node: str, other: str, reliability: str
    ) -> None:
        self._pong = codec(names.of(node, "pong"), 0, SIGNALS)
        self._ping = codec(names.of(other, "ping"), 0, SIGNALS)
        self._publisher = control_publisher(session, names.of(node, "pong"), reliability)
        self._subscriber = session.declare_subscriber(
            names.of(other, "ping"),
            zenoh.handlers.Callback(self._answer, indirect=False),
            allowed_origin=zenoh.Locality.REMOTE,
        )
        self.answered = 0

    def _answer(self, sample: zenoh.Sample) -> None:
        t_ns = pace.now()
        result, values, header = self._ping.decode(sample.payload.to_bytes())
        if result is Decoded.OK:
            self.answered += 1
            values[2] = t_ns
            self._publisher.put(self._pong.encode(values, counter=header.counter))

    def close(self) -> None:
        """Answer no more."""
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]


def ping(
    session: zenoh.Session,
    names: Names,
    node: str,
    other: str,
    *,
    n: int = 1000,
    period: float = 0.005,
    reliability: str = "best-effort",
    patience: float = 10.0,
) -> PingResult:
    """Send `n` pings, one every `period` (s). Raises RunError without an answer."""
    question = codec(names.of(node, "ping"), 0, SIGNALS)
    answer = codec(names.of(other, "pong"), 0, SIGNALS)
    stamps = np.full((n, 3), np.nan)  # sent, heard by the other, back; ns

    def came(sample: zenoh.Sample) -> None:
        t_ns = pace.now()
        result, values, _ = answer.decode(sample.payload.to_bytes())
        if result is Decoded.OK and 0 <= values[0] < n:
            stamps[int(values[0])] = values[1], values[2], t_ns

    subscriber = session.declare_subscriber(
        names.of(other, "pong"), zenoh.handlers.Callback(came, indirect=False),
        allowed_origin=zenoh.Locality.REMOTE,
    )  # fmt: skip
    publisher = control_publisher(session, names.of(node, "ping"), reliability)
    _wait_for_echo(publisher, names.of(node, "ping"), other, patience)
    start, step = pace.now() + 1_000_000, round(period * 1e9)
    sent = np.zeros(n)
    for k in range(n):
        pace.wait(start + k * step)
        sent[k] = t_ns = pace.now()
        publisher.put(question.encode([k, t_ns, 0, 0], counter=k))
    _linger(stamps)
    subscriber.undeclare()  # type: ignore[no-untyped-call]
    return evaluate_stamps(sent, stamps)


def _wait_for_echo(publisher: zenoh.Publisher, key: str, other: str, patience: float) -> None:
    elapsed = stopwatch()
    while not getattr(publisher.matching_status, "matching", False):
        if elapsed() > patience:
            raise RunError(
                f"no node listens to {key} after {patience:g} s; start `cosim ping --echo` as "
                f"{other}"
            )
        sleep(0.01)


def _linger(stamps: Floats) -> None:
    """Until everything is back, or nothing more has come for a while."""
    elapsed, before = stopwatch(), -1
    while elapsed() < _LINGER and np.isnan(stamps[:, 2]).any():
        there = int((~np.isnan(stamps[:, 2])).sum())
        if there != before:
            elapsed, before = stopwatch(), there
        sleep(0.02)


def evaluate_stamps(sent: Sequence[float] | Floats, stamps: Floats) -> PingResult:
    """Evaluate stamps (n, 3), ns: sent, received by the other's clock, back. Raises RunError."""
    sent_ns = np.asarray(sent, dtype=np.float64)
    rtt = stamps[:, 2] - stamps[:, 0]
    if np.isnan(rtt).all():
        raise RunError(f"none of {len(rtt)} pings came back")
    fastest = int(np.nanargmin(rtt))
    offset = stamps[fastest, 1] - stamps[fastest, 0] - rtt[fastest] / 2
    there = stamps[:, 1] - stamps[:, 0] - offset
    return PingResult(
        (sent_ns - sent_ns[0]) * 1e-9,
        rtt * 1e-9,
        there * 1e-9,
        (rtt - there) * 1e-9,
        float(offset) * 1e-9,
    )
