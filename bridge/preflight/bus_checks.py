"""Checks of messages on buses: load, response times, identifiers, ranges, watchdogs.

``check_buses`` returns findings, worst first, without a run and without a bus. Its input is plain
data, so a deployment, a DBC file and a table of numbers are checked alike. Zenoh is not a bus here:
messages outside `buses` are not checked.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

from bridge.can.messages import BusMessage, Role, SignalRange, bus_responses, bus_share
from cosim.base.copies import replace
from cosim.bus.timing import BusTiming, worst
from cosim.checks import Finding, merge_findings

__all__ = ["BusMessage", "BusTiming", "MessageTimeout", "SignalRange", "check_buses"]

#: Load from which a warning is given: above, retransmissions and bursts find little room.
CROWDED = 0.7
#: A watchdog's time-out in periods of what it watches: least and most that make sense.
PATIENCE = (2.0, 50.0)
#: s; a watchdog this short is never too long: what motor controllers come with.
ALWAYS = 0.1
#: Where CANopen (CiA 301) has its own messages, 11-bit identifiers.
RESERVED: tuple[tuple[int, int, Role, str], ...] = (
    (0x000, 0x000, "nmt", "NMT"),
    (0x080, 0x080, "sync", "SYNC"),
    (0x081, 0x0FF, "emergency", "EMCY"),
    (0x100, 0x100, "time", "TIME"),
    (0x580, 0x67F, "sdo", "SDO"),
    (0x700, 0x77F, "heartbeat", "heartbeat"),
)


@dataclass(frozen=True, slots=True)
class MessageTimeout:
    """A node that stops after `timeout` s without `message`; 0: disabled."""

    name: str
    message: str
    timeout: float


def check_buses(
    messages: Sequence[BusMessage],
    buses: Mapping[str, BusTiming],
    watchdogs: Sequence[MessageTimeout] = (),
) -> list[Finding]:
    """Findings, worst first, with a note on load and response times of each bus.

    Messages on other buses than `buses` are checked for watchdogs only.
    """
    found: list[Finding] = []
    for name, timing in buses.items():
        on_bus = [m for m in messages if m.bus == name]
        wrong = list(_frames(on_bus, timing))
        twice = list(_collisions(on_bus))
        found += [*wrong, *twice, *_reserved(on_bus), *_ranges(on_bus)]
        if not wrong and on_bus:
            found += _load(name, on_bus, timing)
            found += [*_impossible(on_bus, timing), *_slow(on_bus, timing)]
        if not wrong and not twice:
            found += _late_messages(name, on_bus, timing)
    return list(
        merge_findings([*found, *_watchdogs(messages, watchdogs), *_silent_nodes(messages, buses)])
    )


def _frames(messages: Iterable[BusMessage], timing: BusTiming) -> Iterator[Finding]:
    """Frames that this bus, or CAN, does not support."""
    for m in messages:
        most, width = (64 if m.fd else 8), (29 if m.extended else 11)
        if m.fd and not timing.fd:
            advice = "set fd = true for the bus, or use a layout of 8 bytes"
            text = "is a CAN FD frame, the bus is classic"
            yield _error("fd-frame", m.place, m.length, "B", text, advice)
        if m.brs and not m.fd:
            yield _error(
                "frame", m.place, m.length, "B", "switches the bit rate in a classic frame"
            )
        if not 0 <= m.length <= most:
            text = f"has {m.length} bytes, a{'n FD' if m.fd else ' classic'} frame at most {most}"
            yield _error("frame", m.place, m.length, "B", text)
        if not 0 <= m.identifier < 1 << width:
            text = f"has an identifier of more than {width} bits"
            yield _error("frame", m.place, m.identifier, "", text)
        if m.period is not None and not 0 < m.period < 3600:
            text = f"has a period of {m.period:g} s, expected more than 0 and less than an hour"
            yield _error("period", m.place, m.period, "s", text)


def _collisions(messages: Iterable[BusMessage]) -> Iterator[Finding]:
    """One identifier for two messages."""

    def identity(m: BusMessage) -> tuple[bool, int]:
        return m.extended, m.identifier

    for (_, number), same in groupby(sorted(messages, key=identity), identity):
        group = list(same)
        nodes = list(dict.fromkeys(m.node for m in group))
        names = " and ".join(m.name for m in group)
        if len(nodes) > 1:
            text = (
                f"identifier {number:#05x} is sent by {', '.join(nodes)}: when two of them send at"
                " once, both see bit errors until one is off the bus"
            )
            yield _error("identifier", names, number, "", text, "give each node its own")
        elif len(group) > 1:
            text = f"{nodes[0]} sends them with one identifier, {number:#05x}: nobody can tell them"
            yield _error("identifier", names, number, "", f"{text} apart")


def _reserved(messages: Iterable[BusMessage]) -> Iterator[Finding]:
    """Identifiers that CANopen devices take for something else; drives have those they have."""
    for m in (m for m in messages if m.role != "drive"):
        for low, high, role, text in RESERVED:
            if not m.extended and low <= m.identifier <= high and m.role != role:
                span = f"{low:#05x}" if low == high else f"{low:#05x} to {high:#05x}"
                yield Finding(
                    rule="canopen-range",
                    severity="warning",
                    where=m.place,
                    number=m.identifier,
                    unit="",
                    reason=f"lies in CANopen's range of {text}, {span}: CANopen devices on the bus"
                    " will take it for that",
                    advice="0x1a0 to 0x57f has room between the ranges of PDOs",
                )


def _ranges(messages: Iterable[BusMessage]) -> Iterator[Finding]:
    """Signals that may be larger than their field."""
    for m in messages:
        for s in m.signals:
            if s.low < s.least or s.high > s.most:
                yield Finding(
                    rule="signal-range",
                    severity="warning",
                    where=f"{m.name}.{s.name}",
                    number=s.high if s.high > s.most else s.low,
                    unit="",
                    reason=f"may be {s.low:g} to {s.high:g}, its field holds {s.least:g} to"
                    f" {s.most:g}: beyond, it saturates",
                    advice="a larger scale in the DBC file, or a tighter limit",
                )


def _load(name: str, messages: Sequence[BusMessage], timing: BusTiming) -> Iterator[Finding]:
    share = bus_share(messages, timing)
    numbers = f"{share.worst:.0%} in the worst case, {share.mean:.0%} with random data"
    advice = "longer periods, fewer or shorter messages, a higher bit rate, or a second bus"
    if share.best > 1:
        text = f"is asked for {share.best:.0%} even without stuff bits: no bus can carry that"
        yield _error("bus-load", name, share.best, "", text, advice)
    elif share.worst > 1:
        text = f"is asked for more than it has: {numbers}"
        yield _error("bus-load", name, share.worst, "", text, advice)
    else:
        crowded = share.worst > CROWDED
        yield Finding(
            rule="bus-load",
            severity="warning" if crowded else "note",
            where=name,
            number=share.worst,
            unit="",
            reason=f"is busy {numbers}" + (": little room to send again" if crowded else ""),
            advice=f"stay below {CROWDED:.0%}: {advice}" if crowded else "",
        )


def _impossible(messages: Iterable[BusMessage], timing: BusTiming) -> Iterator[Finding]:
    """Messages whose period is shorter than their frame time."""
    for m in messages:
        takes = timing.time_ns(worst(m.length, m.kind)) / 1e9
        if m.period is not None and m.period < takes:
            text = (
                f"is to be sent every {m.period * 1e3:g} ms, and takes up to {takes * 1e3:.3g} ms"
            )
            yield _error("rate", m.place, m.period, "s", text)


def _slow(messages: Sequence[BusMessage], timing: BusTiming) -> Iterator[Finding]:
    """FD messages that keep the nominal bit rate on a bus where others change to that of data."""
    if not timing.data_bitrate or not any(m.brs for m in messages):
        return
    for m in (m for m in messages if m.fd and not m.brs):
        fast = replace(m, brs=True)
        own, other = (timing.time_ns(worst(x.length, x.kind)) / 1e9 for x in (m, fast))
        yield Finding(
            rule="rate-switch",
            severity="warning",
            where=m.place,
            number=own,
            unit="s",
            reason=f"is sent at {timing.bitrate:g} bit/s to its end, unlike other messages of the "
            f"bus: up to {own * 1e6:.3g} us rather than {other * 1e6:.3g} us; some receivers do "
            "not hear such frames",
            advice='let it change the bit rate (CANFD_BRS "1" in the DBC file)',
        )


def _late_messages(
    name: str, messages: Sequence[BusMessage], timing: BusTiming
) -> Iterator[Finding]:
    """Messages that may come after their deadline; the tightest one where none does."""
    tightest: tuple[float, BusMessage, float] | None = None
    for m, response in bus_responses(messages, timing):
        if m.period is None or response.worst is None:
            continue
        limit, takes = response.deadline / 1e9, response.worst / 1e9
        if not response.meets_deadline:
            what = "its period" if m.deadline is None else "its deadline"
            yield Finding(
                rule="response-time",
                severity="warning",
                where=m.place,
                number=takes,
                unit="s",
                reason=f"may arrive {takes * 1e3:.3g} ms after it was queued, {what} is"
                f" {limit * 1e3:.3g} ms",
                advice="a lower identifier, shorter messages above it, or a longer period",
            )
        elif tightest is None or takes / limit > tightest[0]:
            tightest = (takes / limit, m, takes)
    if tightest is not None:
        share, m, takes = tightest
        reason = f"{m.place} has least room: {takes * 1e3:.3g} ms, {share:.0%} of its deadline"
        yield Finding(
            rule="response-time", severity="note", where=name, number=takes, unit="s", reason=reason
        )


def _watchdogs(
    messages: Sequence[BusMessage], watchdogs: Iterable[MessageTimeout]
) -> Iterator[Finding]:
    periods = {m.name: m.period for m in messages}
    for w in watchdogs:
        number, period = w.timeout, periods.get(w.message)
        if w.message not in periods:
            yield _error(
                "watchdog", w.name, number, "s", f"watches {w.message}, which nobody sends"
            )
        elif not number > 0:
            text = "has its watchdog off: it goes on with the last command when the sender dies"
            yield _error("watchdog", w.name, number, "s", text, "a time-out of 3 to 10 periods")
        elif period and not PATIENCE[0] * period <= number <= max(PATIENCE[1] * period, ALWAYS):
            early = number / period < PATIENCE[0]
            why = (
                "one lost frame trips it" if early else "that long the last command stays in force"
            )
            yield Finding(
                rule="watchdog",
                severity="warning",
                where=w.name,
                number=number,
                unit="s",
                reason=f"waits {number / period:.3g} periods of {w.message}: {why}",
                advice=f"a time-out of {3 * period:.3g} to {10 * period:.3g} s",
            )


def _silent_nodes(
    messages: Iterable[BusMessage], buses: Mapping[str, BusTiming]
) -> Iterator[Finding]:
    """Nodes that send messages but no heartbeats."""
    roles: dict[str, set[Role]] = {}
    for m in messages:
        if m.bus in buses:
            roles.setdefault(m.node, set()).add(m.role)
    for node, its in roles.items():
        if "heartbeat" not in its and "data" in its:
            yield Finding(rule="heartbeat", severity="warning", where=node, number=0.0, unit="",
                          reason="sends no heartbeat: others cannot tell it from one that hangs",
                          advice="a heartbeat of 10 to 50 Hz, 0x700 + node number")  # fmt: skip


def _error(
    rule: str, where: str, number: float, unit: str, reason: str, advice: str = ""
) -> Finding:
    return Finding(
        rule=rule,
        severity="error",
        where=where,
        number=number,
        unit=unit,
        reason=reason,
        advice=advice,
    )
