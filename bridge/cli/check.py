"""Output of a check of buses: findings, loads and response times in aligned columns.

Rows go through ``cosim.cli.show.aligned``; a finding with its advice is a paragraph of
``cosim.cli.check``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import isfinite

from bridge.can.messages import BusMessage, bus_responses, bus_share
from cosim.bus.timing import BusTiming, worst
from cosim.checks.finding import Finding


def rows(findings: Iterable[Finding]) -> list[list[str]]:
    """A row a finding: severity, rule, place, reason."""
    return [[f.severity, f.rule, f.where, f.reason] for f in findings]


def load_rows(messages: Sequence[BusMessage], buses: Mapping[str, BusTiming]) -> list[list[str]]:
    """A row a bus, below a heading: bit rates, messages, load at best, on random data, at worst."""
    table = [["bus", "kbit/s", "messages", "best", "mean", "worst"]]
    for name, timing in buses.items():
        on_bus = [m for m in messages if m.bus == name]
        share = bus_share(on_bus, timing)
        rate = f"{timing.bitrate / 1e3:g}"
        if timing.fd:
            rate += f" / {(timing.data_bitrate or timing.bitrate) / 1e3:g}"
        table.append([name, rate, str(len(on_bus)), *(f"{part:.1%}" for part in share)])
    return table


def message_rows(messages: Sequence[BusMessage], timing: BusTiming) -> list[list[str]]:
    """A row a message of one bus, most urgent first, below a heading; times in ms.

    Raises TimingError where two messages have one identifier or one cannot be a frame.
    """
    table = [["identifier", "message", "node", "bytes", "period", "frame", "response", "in time"]]
    for m, response in bus_responses(messages, timing):
        period = f"{m.period * 1e3:g}" if m.period and isfinite(m.period) else "event"
        takes = "no bound" if response.worst is None else f"{response.worst / 1e6:.3f}"
        frame = f"{timing.time_ns(worst(m.length, m.kind)) / 1e6:.3f}"
        in_time = "yes" if response.meets_deadline else "no"
        identifier = f"{m.identifier:#010x}" if m.extended else f"{m.identifier:#05x}"
        table.append([identifier, m.name, m.node, str(m.length), period, frame, takes, in_time])
    return table
