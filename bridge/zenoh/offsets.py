"""Offsets between the clocks of two hosts, measured over Zenoh, and the tolerated offset.

``PREFIX/NODE/clock`` answers with the date of its host. The fastest of some questions gives the
offset of its date from ours, known to within half of its round trip.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import zenoh

from bridge.deployment.spec import Deployment
from bridge.deployment.system import System
from bridge.deployment.zenoh_keys import Names, names_of
from bridge.native.epoch import new_run, values
from bridge.native.message import EARLY_NS
from bridge.realtime.host_clock import HostClock, host_clock
from bridge.zenoh.presence import present_nodes
from bridge.zenoh.remote_control import ask, send_service
from cosim.base.clock import realtime_ns, realtime_offset_ns
from cosim.base.errors import RunError

#: Questions to each node.
TIMES = 5


@dataclass(frozen=True, slots=True)
class Offset:
    """A node's date minus ours: `seconds`, to within +- `bound` s.

    `shared`: the same host, or a time server keeps the date of both; only then the date is used.
    `answer`: its answer. `running`: it is in a run.
    """

    node: str
    seconds: float
    bound: float
    same: bool
    shared: bool
    answer: dict[str, Any]

    @property
    def running(self) -> bool:
        """True if it is in a run."""
        return bool(self.answer["running"])

    def describe(self) -> str:
        """For people."""
        return f"{self.seconds * 1e3:.3g} ms ± {self.bound * 1e3:.3g} ms"


def measure(session: zenoh.Session, names: Names, node: str, ours: HostClock) -> Offset:
    """Query a node's clock, and keep the fastest answer. Raises RunError without an answer."""
    found: list[tuple[int, int, dict[str, Any]]] = []
    for _ in range(TIMES):
        before = realtime_ns()
        said = ask(session, names, node, "clock")
        after = realtime_ns()
        found.append((after - before, int(said["date_ns"]) - (before + after) // 2, said))
    took, offset, said = min(found, key=lambda one: one[0])
    same = said["host"] == ours.host
    return Offset(
        node=node,
        seconds=offset * 1e-9,
        bound=took * 0.5e-9,
        same=same,
        shared=same or bool(said["kept"] and ours.kept),
        answer=said,
    )


def greatest_offset(system: System) -> float:
    """By how much two clocks may be apart before samples are refused, s.

    Ahead of its time a sample may be by a period (2 ms, if that is more); behind by `max_age`.
    """
    d = system.deployment
    over = [m for m in system.messages.values() if d.buses[m.bus].kind == "zenoh"]
    ahead = [max(EARLY_NS, m.period_ns) * 1e-9 for m in over]
    behind = [m.max_age_ns * 1e-9 for m in over if m.max_age_ns > 0]
    return min([*ahead, *behind], default=EARLY_NS * 1e-9)


def judge(d: Deployment, offsets: Iterable[Offset], most: float) -> list[str]:
    """Warnings of clocks that are not known well enough. `most`: of :func:`greatest_offset`, s.

    Raises RunError for a clock that is certainly too far off, though both are kept.
    """
    warnings = []
    for o in offsets:
        if o.same:
            continue
        where = f"node {o.node}, on another host"
        if not o.shared:
            warnings.append(
                f"{where}: no time server keeps the date of both hosts (found {o.describe()}); its "
                "t = 0 is 100 ms after it hears of the start"
            )
        elif abs(o.seconds) - o.bound > most:
            raise RunError(
                f"{where}: its clock is off by {o.describe()}; expected at most "
                f"{most * 1e3:.3g} ms, the limit of the periods and max_age of {d.path}"
            )
        elif abs(o.seconds) + o.bound > most:
            warnings.append(
                f"{where}: its clock is off by {o.describe()}, which is not known to be within the "
                f"{most * 1e3:.3g} ms that the periods and max_age of {d.path.name} bear"
            )
    return warnings


def start_lead_time(offsets: Sequence[Offset]) -> float:
    """The time from EPOCH to t = 0, s: half a second, and time to reach the slowest node."""
    return 0.5 + 4.0 * max((o.bound for o in offsets), default=0.0)


def announce_epoch(session: zenoh.Session, system: System, bus: str) -> list[str]:
    """Before START: measure the clocks of all present nodes, and send them a common t = 0.

    Nothing is sent if some nodes are already running: the others then join them. Returns warnings.
    Raises RunError as :func:`judge` does.
    """
    names, ours, epoch = names_of(system.deployment, bus), host_clock(), system.services[bus].epoch
    assert epoch is not None  # a Zenoh bus has one
    there = sorted(present_nodes(session, names) & set(system.nodes))
    found = [measure(session, names, node, ours) for node in there]
    warnings = judge(system.deployment, found, greatest_offset(system))
    if not any(one.running for one in found):
        origin = realtime_ns() + round(start_lead_time(found) * 1e9)
        said = values(new_run(origin), ours.number, ours.kept, origin, ours.identity)
        send_service(session, names.shared("epoch"), epoch, said)
    return warnings


def measured_origin(session: zenoh.Session, names: Names, system: System) -> tuple[int, int] | None:
    """The active run, by measured clocks: its number, and t = 0 on CLOCK_MONOTONIC, ns.

    For a host without a common date. None: no node is running, or no offset is known accurately
    enough.
    """
    ours, found = host_clock(), []
    for node in sorted(present_nodes(session, names) & set(system.nodes)):
        with suppress(RunError):  # one that has gone answers no more
            found.append(measure(session, names, node, ours))
    running = [o for o in found if o.running]
    best = min(running, key=lambda o: o.bound, default=None)
    if best is None or best.bound > greatest_offset(system):
        return None
    date = int(best.answer["origin_ns"]) - round(best.seconds * 1e9)
    return int(best.answer["run"]), date - realtime_offset_ns()
