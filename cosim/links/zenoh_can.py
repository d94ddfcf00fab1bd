"""The law "zenoh-can": a link whose samples are messages of Zenoh on a CAN FD bus.

::

    delay = { law = "zenoh-can", payload = 40, bitrate = 1e6, data_bitrate = 5e6 }
    delay = { law = "zenoh-can", payload = 89, bitrate = 1e6, data_bitrate = 5e6, link = "isotp",
              stmin = "5 ms", block = 4,
              traffic = [{ identifier = 0x100, bytes = 64, period = "1 ms" }] }

Each sample is simulated frame by frame on a bus of its own with the other traffic, whose phases are
drawn from the seed. `minimum` and `maximum` are bounds by analysis (:mod:`cosim.bus.transfers`).

Source: zenoh pull request 2757 (2026) for the two kinds of links; the bounds are our own
construction.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np

from cosim.base.errors import CosimError, ScenarioError
from cosim.bus.fragments import ZenohMessage, isotp_frames
from cosim.bus.timing import BusTiming
from cosim.bus.transfers import IsoTpSettings, OtherMessage, Transfer, TransferSimulation
from cosim.links.keys import Seconds, Table, si
from cosim.links.laws import Delays, FloatArray, Formula

if TYPE_CHECKING:
    from numpy.random import Generator

_PS = 1e12
#: Messages that are simulated for the mean.
_MEAN_OF = 200


class TrafficKeys(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A message of other nodes: identifier, bytes, period (s)."""

    identifier: int
    bytes: int
    period: float
    extended: bool = False


class ZenohCan(Formula, frozen=True, tag="zenoh-can", kw_only=True, dict=True):
    """T = the time from handing over a message to the arrival of its last frame.

    `payload`, `attachment`: bytes. `link`: "can", fragments of Zenoh in frames of one identifier;
    "isotp", with flow control. `data_bitrate`: None, frames without a faster phase. `identifier`,
    `answers`: of the frames, and of flow controls. `priority`: of Zenoh. `stmin`, `block`,
    `answer`: :class:`cosim.bus.transfers.IsoTpSettings`, s. `traffic`: of other nodes.
    """

    payload: int
    bitrate: float
    data_bitrate: float | None = None
    link: Literal["can", "isotp"] = "can"
    identifier: int = 0x400
    answers: int = 0x401
    extended: bool = False
    attachment: int = 0
    priority: Literal["data", "other"] = "other"
    stmin: Seconds = 0.0
    block: int = 0
    answer: Seconds = 50e-6
    traffic: tuple[TrafficKeys, ...] = ()

    @classmethod
    def completed(cls, table: Table) -> Table:
        """The table with periods of traffic in s. Raises ScenarioError."""
        given = table.get("traffic")
        if not isinstance(given, list | tuple) or not all(isinstance(x, dict) for x in given):
            return table
        rows = [
            x | {"period": si(x["period"], f"traffic[{i}].period")} if "period" in x else x
            for i, x in enumerate(given)
        ]
        return {**table, "traffic": rows}

    def __post_init__(self) -> None:
        """Check that the bus can carry it. Raises ScenarioError."""
        if not all(t.period > 0 for t in self.traffic):
            raise ScenarioError("zenoh-can: found a period of traffic that is not above 0 s")
        if min(self.stmin, self.block, self.answer) < 0:
            raise ScenarioError("zenoh-can: found a stmin, block or answer below 0")
        try:
            longest = self.transfer.longest_ps
        except CosimError as error:
            raise ScenarioError(f"zenoh-can: {error}") from None
        if longest is None:
            raise ScenarioError(
                "zenoh-can: found an overloaded bus, expected traffic of higher priority that "
                "leaves time for this message"
            )

    @cached_property
    def message(self) -> ZenohMessage:
        """The message, as Zenoh sends it."""
        return ZenohMessage(self.payload, self.attachment, self.priority == "data")

    @cached_property
    def transfer(self) -> Transfer:
        """The frames of a message, and the bus."""
        flow = None
        lengths = self.message.frames()
        if self.link == "isotp":
            whole = self.message.frames(1 << 28)[0]
            lengths = isotp_frames(whole, 64)
            times = round(self.stmin * _PS), self.block, round(self.answer * _PS)
            flow = IsoTpSettings(self.answers, *times)
        others = tuple(
            OtherMessage(t.identifier, t.bytes, round(t.period * _PS), t.extended)
            for t in self.traffic
        )
        timing = BusTiming(self.bitrate, self.data_bitrate, fd=True)
        return Transfer(timing, self.identifier, lengths, self.extended, others, flow)

    @property
    def minimum(self) -> float:
        """A bound by analysis, s."""
        return self.transfer.shortest_ps / _PS

    @property
    def maximum(self) -> float:
        """A bound by analysis, s."""
        return (self.transfer.longest_ps or 0) / _PS

    @cached_property
    def mean(self) -> float:
        """The mean of 200 simulated messages, s."""
        period = Fraction(max(self.maximum, 0.001)).limit_denominator(10**6)
        return float(self.stream(period, np.random.default_rng(0)).take(_MEAN_OF).mean())

    def stream(self, period: Fraction, rng: Generator) -> Delays:
        """The delays of messages at t = 0, period, ... (s).

        Raises ScenarioError for a period in which a message may not arrive, because the bound does
        not hold for messages that wait for each other.
        """
        if self.maximum > period:
            raise ScenarioError(
                f"zenoh-can: found a message every {float(period):g} s, which can take "
                f"{self.maximum:.4g} s, expected one at most as often as it takes"
            )
        phases = [int(rng.integers(0, o.period_ps)) for o in self.transfer.others]
        seed = int(rng.integers(0, 2**31))
        return _Simulated(TransferSimulation(self.transfer, phases, seed), period)

    def facts(self) -> dict[str, Any]:
        """The keys, with the frames of a message and the bounds."""
        frames = [int(n) for n in self.transfer.lengths]
        bounds = {"least": self.minimum, "greatest": self.maximum}
        return {**super().facts(), "frames": frames, **bounds}


class _Simulated:
    """The delays of one link."""

    def __init__(self, bus: TransferSimulation, period: Fraction) -> None:
        self._bus, self._period, self._k = bus, period, 0

    def take(self, n: int) -> FloatArray:
        """The next `n` delays, (n,), s."""
        found = np.empty(n)
        for i in range(n):
            at = round(self._k * self._period * 10**12)
            found[i] = (self._bus.deliver(at) - at) / _PS
            self._k += 1
        return found
