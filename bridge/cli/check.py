"""Output of a check of buses: findings, loads and response times in aligned columns.

Rows go through ``cosim.cli.show.aligned``; a finding with its advice is a paragraph of
``cosim.cli.check``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import isfinite

from bridge.can.messages import BusMessage, bus_responses, bus_share
from bridge.can.rates import control_rate, simulated_worst
from cosim.bus.timing import BusTiming, worst
from cosim.checks.finding import Finding


def rows(findings: Iterable[Finding]) -> list[list[str]]:
    """A row a finding: severity, rule, place, reason."""
    return [[f.severity, f.rule, f.where, f.reason] for f in findings]


def load_rows(messages: Sequence[BusMessage], buses: Mapping[str, BusTiming]) -> list[list[str]]:
    """A row for each bus, below a heading: bit rates, messages, load, and the control rate.

    The load is that at best, on random data and at worst; the rate, Hz, on random data and at worst
    (:func:`bridge.can.rates.control_rate`).
    """
    table = [["bus", "kbit/s", "messages", "best", "mean", "worst", "control rate", "at worst"]]
    for name, timing in buses.items():
        on_bus = [m for m in messages if m.bus == name]
        share = bus_share(on_bus, timing)
        rate = f"{timing.bitrate / 1e3:g}"
        if timing.fd:
            rate += f" / {(timing.data_bitrate or timing.bitrate) / 1e3:g}"
        reached = control_rate(on_bus, timing)
        rates = [f"{reached.mean:.0f} Hz", f"{reached.worst:.0f} Hz"] if reached else ["", ""]
        table.append([name, rate, str(len(on_bus)), *(f"{part:.1%}" for part in share), *rates])
    return table


def message_rows(messages: Sequence[BusMessage], timing: BusTiming) -> list[list[str]]:
    """A row for each message of one bus, most urgent first, below a heading; times in ms.

    `response` is the worst case by analysis, `simulated` that of the simulated bus if
    all are requested at once, and then with their periods, with random data.

    Raises TimingError where two messages have one identifier or one cannot be a frame.
    """
    table = [["identifier", "message", "node", "bytes", "period", "frame", "response"]]
    table[0] += ["simulated", "in time"]
    simulated = simulated_worst(messages, timing)
    for m, response in bus_responses(messages, timing):
        period = f"{m.period * 1e3:g}" if m.period and isfinite(m.period) else "event"
        takes = "no bound" if response.worst is None else f"{response.worst / 1e6:.3f}"
        frame = f"{timing.time_ns(worst(m.length, m.kind)) / 1e6:.3f}"
        in_time = "yes" if response.meets_deadline else "no"
        identifier = f"{m.identifier:#010x}" if m.extended else f"{m.identifier:#05x}"
        table.append([identifier, m.name, m.node, str(m.length), period, frame, takes])
        seen = simulated.get((m.extended, m.identifier))
        table[-1] += ["never sent" if seen is None else f"{1e3 * seen:.3f}", in_time]
    return table
