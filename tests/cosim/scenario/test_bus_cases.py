"""The page of four cases of a bus: its numbers, its pictures, and its statements."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest

from cosim.bus.accounting import accounts
from cosim.bus.frames import BusEvent, ControllerState
from cosim.reporting.bus_account import account_lines

ROOT = Path(__file__).resolve().parents[3]
_SPEC = importlib.util.spec_from_file_location(
    "bus_cases", ROOT / "docs" / "evidence" / "bus_cases.py"
)
assert _SPEC is not None and _SPEC.loader is not None
page = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(page)
MS = 10**9


def worst(history, identifier):
    found = {a.identifier: a for a in accounts(history.requests, history.events)}
    return found[identifier].worst


@pytest.mark.slow
def test_the_page_has_the_numbers_of_its_studies():
    assert page.PAGE.read_text(encoding="utf-8") == page.page(pictures=False), (
        "python docs/evidence/bus_cases.py writes it"
    )


def test_the_page_has_its_pictures():
    named = set(re.findall(r"\]\((\S+\.png)\)", page.PAGE.read_text(encoding="utf-8")))
    assert named == {*page.FRAMES, *page.ARMS, "bus-load-effect.png"}
    assert all((page.PAGE.parent / name).is_file() for name in named)


def test_a_fifo_queue_inverts_priorities():
    queues = page.cases("bus-priority")
    late = {name: worst(page.history(queues[name], 0.1), 0x101) for name in ("sorted", "fifo")}
    assert late["sorted"] < 1 * MS
    assert 3.5 * MS < late["fifo"] < 5 * MS


def test_nothing_is_sent_beside_a_node_that_babbles():
    h = page.history(page.cases("bus-babbling")["with"], 1.1)
    sent = h.events[h.events["kind"] == BusEvent.SENT]
    late = sent[sent["time"] > 1001 * MS]
    assert len(late) > 300
    assert {h.names[node] for node in late["node"]} == {"babbler"}


def test_a_node_that_reads_inverted_bits_goes_bus_off_and_comes_back_or_not():
    for case, back in (("recovers", True), ("stays off", False)):
        h = page.history(page.cases("bus-off")[case], 4.1)
        slave = h.names.index("slave_control")
        mine = h.events[h.events["node"] == slave]
        states = mine[mine["kind"] == BusEvent.STATE]
        off = states[states["code"] == ControllerState.OFF]
        assert len(off) == 1
        assert 2000 * MS < off["time"][0] < 2001 * MS
        sent = mine[(mine["kind"] == BusEvent.SENT) & (mine["time"] > 2001 * MS)]
        assert bool(len(sent)) is back
        assert not len(sent) or sent["time"][0] > 4000 * MS


def test_an_account_is_of_the_requests_in_its_time():
    h = page.history(page.cases("bus-priority")["sorted"], 0.1)
    whole = list(account_lines(h, 0, 100 * MS))
    part = list(account_lines(h, 50 * MS, 100 * MS))
    counts = [{line[:3]: int(line.split()[1]) for line in lines[2:]} for lines in (whole, part)]
    assert counts[0]["101"] == 20  # at 0, 5, ..., 95 ms
    assert counts[1]["101"] == 10
    assert part[0].startswith("0.050 s: load ")
    assert np.isclose(float(part[0].split()[3].rstrip("%,")), 65, atol=10)
