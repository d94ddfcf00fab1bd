"""Comparison of faults of the network between hosts with the reports of receivers
(bridge.results.detection).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bridge.faults.script import FaultEvent
from bridge.native.message import COUNTERS
from bridge.records.node_lives import Life
from bridge.relay.router import UDP
from bridge.results.findings import Place, Signs
from bridge.results.symptoms import SIGNS, FinishedRun
from bridge.wiring.wiring import Rows

#: Packets of samples below which a fault had nothing to act on; some are of handshakes.
FEW = {"net-delay": 20, "net-rate": 20, "net-loss": 5, "net-down": 5}
#: s that count as held.
HELD = 0.02
#: Bytes of IPv4 and UDP, and of all that stands in a sample's payload besides its values.
_HEADERS = 28 + 24


class PacketRecord(Protocol):
    """The record of a network (:class:`bridge.relay.network.RelayNetwork`), and its hosts."""

    names: Sequence[str]

    def of(self, link: str) -> Rows:
        """Return the packets (n,) of a link."""
        ...


@dataclass(frozen=True, slots=True)
class RecordedNetwork:
    """A network, its hosts' nodes, and t = 0 on its clock."""

    packets: PacketRecord
    hosts: Mapping[str, Sequence[str]]
    start_ns: int


def link_evidence(
    first: FaultEvent, t1: float, shown: FinishedRun, network: RecordedNetwork
) -> Iterator[Place]:
    """One place for each life that receives something over a link on which the fault acted.

    `t1`: when the fault ended, s.
    """
    packets = network.packets
    for link in packets.names if first.target == "*" else (first.target,):
        rows = packets.of(link)
        t, left = ((rows[key] - network.start_ns) * 1e-9 for key in ("t_ns", "left_ns"))
        # What was on its way when the fault began still arrives.
        quiet = max(first.t, float(left[(t < first.t) & (left < t1)].max(initial=0.0)))
        there = (t >= first.t) & (t < t1)
        rows, t, left = rows[there], t[there], left[there]
        for life, message in _receivers(first.action, link, first.t, t1, shown, network):
            size = _HEADERS + 8 * shown.system.messages[message].outlet.width
            samples = (rows["length"] >= size) & shown.sends(message, t)
            samples &= left <= shown.last(life)  # what arrives later has no receiver any more
            acted, least = _affected_packets(first.action, rows[samples])
            done = acted if acted >= FEW[first.action] else 0
            signs = _link_signs(first, quiet, t1, shown, life, message, least) if done else ()
            yield Place(target=str(life), message=message, done=done, signs=signs)


def _receivers(
    action: str, link: str, t0: float, t1: float, shown: FinishedRun, network: RecordedNetwork
) -> Iterator[tuple[Life, str]]:
    source, _, target = link.partition(">")
    for node in network.hosts[target]:
        for message in shown.system.received_by(node):
            carried = shown.system.messages[message]
            zenoh = shown.system.deployment.buses[carried.bus].kind == "zenoh"
            if zenoh and carried.node in network.hosts[source]:
                lives = shown.alive(node, t0, t1)
                # Of one that did not live to tell there are its rows, but no counters.
                if set(SIGNS[action]) - set(COUNTERS):
                    lives += [x for x in shown.lives_throughout(node, t0, t1) if x not in lives]
                for life in lives:
                    # One that began again has to have found its peer before.
                    news = shown.new_sample_times(life, message) if life.boot > 1 else ()
                    if life.boot == 1 or any((at < t0).any() for at in news):
                        yield life, message


def _affected_packets(action: str, rows: Rows) -> tuple[int, float]:
    """(packets a link did something to, s that each of them was held at least)."""
    through = rows[rows["left_ns"] >= 0]
    held = (through["left_ns"] - through["t_ns"]) * 1e-9
    if action == "net-delay":
        drawn = through["delay_ns"][through["delay_ns"] > 0]
        return len(drawn), float(drawn.min(initial=10**18)) * 1e-9
    if action == "net-rate":
        long = held[held >= HELD]
        return len(long), float(np.median(long)) if len(long) else 0.0
    lost = rows[rows["delay_ns"] < 0]
    if action == "net-loss":  # what TCP carried it repeats
        lost = lost[lost["protocol"] == UDP]
    return len(lost), 0.0


def _link_signs(
    first: FaultEvent,
    quiet: float,
    t1: float,
    shown: FinishedRun,
    life: Life,
    message: str,
    least: float,
) -> Signs:
    """`quiet`: s, from when on nothing from before the fault arrives; `least`: s each was held."""
    found: Signs = ()
    for sign in SIGNS[first.action]:
        if sign == "age":
            found += shown.age(life, message, first.t, t1, least)
        elif sign == "silence":
            held = min(t1 - quiet, least) if least > 0 else t1 - quiet
            found += shown.silence(life, message, quiet, quiet + held)
        else:
            found += shown.counter_signs(life, message, [sign], 1)
    return found
