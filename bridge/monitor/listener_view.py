"""The data of a listener as tables of text."""

from __future__ import annotations

from math import isnan

import numpy as np

from bridge.monitor import window
from bridge.monitor.listener import Listener
from bridge.monitor.messages import SPAN_NS, Beat, ReceivedMessage
from bridge.monitor.view import TextTable, View, result, values
from bridge.native.bus import last_second
from cosim.measure.metrics import MetricResult


def view(listener: Listener, now_ns: int) -> View:
    """All that is known at `now_ns` (monotonic), to be shown."""
    beats = listener.beats.items()
    there = [f"{n} {how}" for n, b in beats if (how := _node_status(listener, n, b, now_ns))]
    heard = listener.heard.values()
    rates = [f"{h.carried.name} {len(h.recent)}/s" + _without(h) for h in heard]
    known = window.metrics(listener.system, heard, now_ns)
    numbers = [f"{r.label} {result(r)}" for r in known[0] if not isnan(r.value)]
    line = "; ".join((", ".join(there) or "nobody there", ", ".join(rates), *numbers))
    head = f"{listener.system.scenario.name}: listening on {', '.join(listener.ears)}"
    return View(head, line, _tables(listener, now_ns, known))


def _tables(
    listener: Listener, now_ns: int, metrics: tuple[list[MetricResult], tuple[str, ...]]
) -> list[TextTable]:
    found = [
        _nodes(listener, now_ns),
        _stops(listener),
        _messages(listener, now_ns),
        TextTable("buses", ("bus", "frames/s", "load", ""),
              [_bus_row(listener, n, now_ns) for n in listener.ears]),
        _metrics(*metrics),
        _signals([*listener.heard.values()]),
    ]  # fmt: skip
    return [table for table in found if table.rows]


def _node_status(listener: Listener, name: str, b: Beat, now_ns: int) -> str:
    """A node in a word; nothing of one that was never there."""
    there = listener.there(name)
    if b.t_ns < 0:
        return "there" if there else ""
    if now_ns - b.t_ns <= SPAN_NS:
        return b.state
    return "gone" if there is False else "silent"


def _nodes(listener: Listener, now_ns: int) -> TextTable:
    bad = frozenset(
        i
        for i, (name, b) in enumerate(listener.beats.items())
        if now_ns - b.t_ns > SPAN_NS or b.state != "active" or listener.there(name) is False
    )
    rows = [_beat_row(listener, name, b, now_ns) for name, b in listener.beats.items()]
    head: tuple[str, ...] = ("node", "state", "ms ago", "boots", "armed")
    head += ("token",) if listener.nets else ()
    return TextTable("nodes, by their heartbeats", head, rows, bad)


def _beat_row(listener: Listener, name: str, b: Beat, now_ns: int) -> tuple[str, ...]:
    token = {True: "there", False: "gone" if b.t_ns >= 0 else "none", None: ""}
    boots, armed = (str(b.boots), "yes" if b.armed else "no") if b.t_ns >= 0 else ("", "")
    row = (name, b.state or "?", _time_since(b.t_ns, now_ns), boots, armed)
    return (*row, token[listener.there(name)]) if listener.nets else row


def _stops(listener: Listener) -> TextTable:
    rows = [(name, why) for name, b in listener.beats.items() for why in b.reasons]
    return TextTable("why", ("node", "has stopped"), rows, frozenset(range(len(rows))))


def _messages(listener: Listener, now_ns: int) -> TextTable:
    heard = [*listener.heard.values()]
    bad = frozenset(i for i, h in enumerate(heard) if not h.recent or h.lost or h.refused)
    head = ("message", "from", "1/s", "ago", "jitter", "max", "lost", "sender")
    return TextTable("messages; times in ms", head, [_heard_row(h, now_ns) for h in heard], bad)


def _heard_row(h: ReceivedMessage, now_ns: int) -> tuple[str, ...]:
    late, lost = h.late * 1e3, str(h.lost) if h.message.e2e else ""
    jitter = (f"{np.median(late):.2f}", f"{late.max():.2f}") if len(late) else ("", "")
    refused = [f"{n} refused: {why}" for why, n in h.refused.items()]
    sender = "; ".join(filter(None, (*refused, h.sender().removeprefix("active "))))  # as should be
    rate, ago = str(len(h.recent)), _time_since(h.t_ns, now_ns)
    return (h.carried.name, h.carried.node, rate, ago, *jitter, lost, sender)


def _metrics(found: list[MetricResult], missing: tuple[str, ...]) -> TextTable:
    rows = [(r.label, result(r)) for r in found]
    rows += [("others", f"need what is on no bus: {', '.join(missing)}")] if missing else []
    return TextTable("metrics", ("metric", "of the last second"), rows)


def _without(h: ReceivedMessage) -> str:
    bad = [
        f"{n} {what}" for what, n in (("lost", h.lost), ("refused", sum(h.refused.values()))) if n
    ]
    return f" ({', '.join(bad)})" if bad else ""


def _signals(heard: list[ReceivedMessage]) -> TextTable:
    """Newest values; of a signal that several messages carry, those of the last one."""
    rows: dict[str, tuple[str, ...]] = {}
    for h in (*heard, *sorted(heard, key=lambda h: h.t_ns)):  # the first time for their order
        first = 0
        for part in h.carried.outlet.parts:
            found = h.values[first : first + part.size].tolist()
            unit = ", ".join(dict.fromkeys(part.units or (part.unit,)))
            rows[part.name] = (part.name, unit, values(found))
            first += part.size
    return TextTable("signals", ("signal", "unit", "values"), [*rows.values()])


def _time_since(t_ns: int, now_ns: int) -> str:
    return "never" if t_ns < 0 else f"{max(0, now_ns - t_ns) * 1e-6:.0f}"


def _bus_row(listener: Listener, name: str, now_ns: int) -> tuple[str, ...]:
    spec = listener.system.deployment.buses[name]
    rate = last_second(listener.ears[name].traffic, now_ns)
    if name in listener.nets:
        return (name, str(rate.frames), "", listener.nets[name].note)
    load = rate.load(spec.bitrate, spec.data_bitrate if spec.fd else None)
    return (name, str(rate.frames), f"{load:.1%}", "")
