"""The static check of buses: good sets pass with notes, each bad one with its sentence."""

from __future__ import annotations

from math import nan
from pathlib import Path

import pytest

from bridge.can.dbc import load
from bridge.can.layout import LayoutError, find
from bridge.can.messages import bus_responses, bus_share
from bridge.cli.twin import load_rows, message_rows
from bridge.preflight.bus_checks import (
    BusMessage,
    BusTiming,
    MessageTimeout,
    SignalRange,
    check_buses,
)
from cosim.base.copies import replace
from cosim.checks import Finding

CONFIGS = Path(__file__).parents[3] / "configs" / "can"
FAST = BusTiming(1e6, 5e6, fd=True)
CLASSIC = BusTiming(1e6)


def link(number: int, period: float | None = 1e-3, length: int = 64, **more: object) -> BusMessage:
    message = BusMessage(
        name=f"LINK_{number}",
        identifier=0x3A0 + number,
        length=length,
        period=period,
        node=f"n{number}",
        bus="can0",
        fd=length > 8,
        brs=length > 8,
    )
    return replace(message, **more)  # type: ignore[arg-type]


def beat(number: int) -> BusMessage:
    name = f"HEARTBEAT_{number}"
    return link(number, 0.05, 8, name=name, identifier=0x700 + number, role="heartbeat")


def nodes(count: int, **more: object) -> list[BusMessage]:
    return [m for n in range(1, count + 1) for m in (link(n, **more), beat(n))]  # type: ignore[arg-type]


def found(
    messages: list[BusMessage], timing: BusTiming = FAST, dogs: tuple[MessageTimeout, ...] = ()
) -> list[Finding]:
    return check_buses(messages, {"can0": timing}, dogs)


def only(findings: list[Finding], rule: str) -> Finding:
    (finding,) = [f for f in findings if f.rule == rule and f.severity != "note"]
    return finding


def test_a_good_set_has_two_notes() -> None:
    notes = found(nodes(2), dogs=(MessageTimeout("arm", "LINK_1", 5e-3),))
    assert [(f.severity, f.rule) for f in notes] == [
        ("note", "bus-load"),
        ("note", "response-time"),
    ]
    assert notes[0].reason == "is busy 34% in the worst case, 29% with random data"
    assert "LINK_2 (0x3a2) has least room: 0.473 ms, 47% of its deadline" in notes[1].reason
    assert found([]) == []


def test_the_files_that_come_with_it_pass() -> None:
    layouts = load(CONFIGS / "link_fd.dbc")
    messages = [
        BusMessage.of(find(layouts, f"{name}_{n}"), node=f"n{n}", bus="can0", role=role)
        for n in (1, 2)
        for name, role in (("LINK", "data"), ("HEARTBEAT", "heartbeat"))
    ]
    messages.append(BusMessage.of(find(layouts, "SYNC"), node="n1", bus="can0", role="sync"))
    assert {f.severity for f in found(messages)} == {"note"}
    assert messages[0].fd
    assert messages[0].brs
    assert messages[0].length == 64


def test_a_crowded_bus_is_warned_of() -> None:
    crowded = only(found(nodes(4, period=0.9e-3)), "bus-load")
    assert (crowded.severity, round(crowded.number, 2)) == ("warning", 0.76)
    assert "little room" in crowded.reason
    assert "70%" in crowded.advice


def test_more_than_a_bus_can_carry_is_refused() -> None:
    over = only(found(nodes(6)), "bus-load")
    assert over.severity == "error"
    assert over.reason == (
        "is asked for more than it has: 103% in the worst case, 87% with random data"
    )
    never = only(found(nodes(12)), "bus-load")
    assert "even without stuff bits: no bus can carry that" in never.reason


def test_nine_drives_with_replies_do_not_fit_a_classic_bus() -> None:
    """A published claim, 8 motors at 900 Hz on 1 Mbit/s, holds only if nobody counts replies."""
    pairs = [
        link(n, 1 / 900, 8, name=f"{what}_{n}", identifier=base + n)
        for n in range(8)
        for what, base in (("COMMAND", 0x200), ("REPLY", 0x300))
    ]
    assert "no bus can carry that" in only(found(pairs, CLASSIC), "bus-load").reason
    assert bus_share(pairs[::2], CLASSIC).best < 1


def test_a_message_that_is_longer_than_its_period() -> None:
    too_fast = only(found([link(1, 1e-4), beat(1)]), "rate")
    assert too_fast.reason == "is to be sent every 0.1 ms, and takes up to 0.169 ms"


def test_a_message_that_may_come_after_its_deadline() -> None:
    set_ = [*nodes(3), link(9, 0.4e-3, 8, name="FAST", identifier=0x4A9), beat(9)]
    late = only(found(set_), "response-time")
    assert (late.severity, late.where) == ("warning", "FAST (0x4a9)")
    assert late.reason == "may arrive 0.776 ms after it was queued, its period is 0.4 ms"
    easy = [replace(m, deadline=1e-3) if m.name == "FAST" else m for m in set_]
    assert [f.rule for f in found(easy) if f.severity == "warning"] == ["bus-load"]


def test_jitter_and_events_count() -> None:
    quiet = bus_responses([link(1), beat(1)], FAST)
    noisy = bus_responses([link(1, jitter=1e-4), beat(1)], FAST)
    assert quiet[0][1].worst is not None
    assert noisy[0][1].worst == quiet[0][1].worst + 100_000
    stop = link(0, None, 5, name="ESTOP", identifier=1)
    later = bus_responses([stop, link(1), beat(1)], FAST)
    assert later[1][1].worst == quiet[0][1].worst + 105_000
    assert bus_share([stop], FAST) == (0, 0, 0)


def test_one_identifier_for_two() -> None:
    twice = only(found([*nodes(2), link(2, name="OTHER", node="n1")]), "identifier")
    assert twice.severity == "error"
    assert "identifier 0x3a2 is sent by n2, n1" in twice.reason
    same = only(found([*nodes(1), link(1, name="AGAIN")]), "identifier")
    assert "nobody can tell them apart" in same.reason
    assert not [f for f in found([*nodes(1), link(1, extended=True)]) if f.severity == "error"]


@pytest.mark.parametrize(
    ("identifier", "text"),
    [(0, "NMT"), (0x80, "SYNC"), (0x81, "EMCY"), (0x100, "TIME"), (0x601, "SDO"), (0x701, "heart")],
)
def test_identifiers_of_canopen(identifier: int, text: str) -> None:
    taken = only(found([link(1, identifier=identifier), beat(2), beat(1)][:2]), "canopen-range")
    assert taken.severity == "warning"
    assert text in taken.reason
    extended = found([link(1, identifier=identifier, extended=True), beat(1)])
    assert not [f for f in extended if f.rule == "canopen-range"]


def test_frames_there_cannot_be() -> None:
    assert only(found([link(1), beat(1)], CLASSIC), "fd-frame").severity == "error"
    nine = found([link(1, length=9, fd=False, brs=False), beat(1)])
    assert only(nine, "frame").reason == "has 9 bytes, a classic frame at most 8"
    assert "an FD frame at most 64" in only(found([link(1, length=65), beat(1)]), "frame").reason
    long = only(found([link(1, identifier=0x800), beat(1)]), "frame")
    assert "more than 11 bits" in long.reason
    assert only(found([link(1, length=8, brs=True), beat(1)]), "frame").severity == "error"
    for period in (0.0, -1.0, nan):
        assert only(found([link(1, period), beat(1)]), "period").severity == "error"


def test_signals_that_do_not_fit_their_field() -> None:
    layout = find(load(CONFIGS / "link2.dbc"), "TAU_1")
    name = layout.signals[0].name
    fits = BusMessage.of(layout, node="n1", bus="can0", limits={name: (-100, 100)})
    wide = BusMessage.of(layout, node="n1", bus="can0", limits={name: (-100, 1000)})
    assert not [f for f in found([fits, beat(1)]) if f.rule == "signal-range"]
    finding = only(found([wide, beat(1)]), "signal-range")
    assert (finding.where, finding.number) == (f"TAU_1.{name}", 1000)
    assert "may be -100 to 1000, its field holds -127.996 to 127.996" in finding.reason
    with pytest.raises(LayoutError):
        BusMessage.of(layout, node="n1", bus="can0", limits={"nothing": (0, 1)})
    low = link(1, signals=(SignalRange("a", -2, 1, -1, 1),))
    assert only(found([low, beat(1)]), "signal-range").number == -2


@pytest.mark.parametrize(
    ("timeout", "severity", "text"),
    [
        (0.0, "error", "has its watchdog off"),
        (nan, "error", "has its watchdog off"),
        (1.5e-3, "warning", "waits 1.5 periods of LINK_1: one lost frame trips it"),
        (120e-3, "warning", "waits 120 periods of LINK_1"),
    ],
)
def test_watchdogs(timeout: float, severity: str, text: str) -> None:
    finding = only(found(nodes(1), dogs=(MessageTimeout("arm", "LINK_1", timeout),)), "watchdog")
    assert (finding.severity, finding.where) == (severity, "arm")
    assert text in finding.reason
    assert finding.advice


def test_a_watchdog_of_nothing_and_one_of_events() -> None:
    nothing = only(found(nodes(1), dogs=(MessageTimeout("arm", "TAU", 1.0),)), "watchdog")
    assert nothing.reason == "watches TAU, which nobody sends"
    event = [link(1, None), beat(1)]
    assert not [
        f for f in found(event, dogs=(MessageTimeout("arm", "LINK_1", 1.0),)) if f.rule[0] == "w"
    ]


def test_a_node_without_heartbeat() -> None:
    silent = [f for f in found([link(1), link(2), beat(2)]) if f.rule == "heartbeat"]
    assert [(f.where, f.severity) for f in silent] == [("n1", "warning")]
    assert check_buses([link(1, bus="zenoh")], {"can0": FAST}) == []


def test_rows_line_up() -> None:
    messages = nodes(2)
    table = message_rows(messages, FAST)
    assert table[1] == ["0x3a1", "LINK_1", "n1", "64", "1", "0.169", "0.338", "0.145", "yes"]
    assert load_rows(messages, {"can0": FAST})[1][:3] == ["can0", "1000 / 5000", "4"]
    assert load_rows(messages, {"can0": FAST})[1][5] == "34.3%"
    first = found(nodes(6))[0]
    assert (first.severity, first.rule) == ("error", "bus-load")
    event = message_rows([link(1, None), link(2, extended=True)], FAST)
    assert "event" in event[1] or "event" in event[2]
