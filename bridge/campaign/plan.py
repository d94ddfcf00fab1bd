"""A campaign of many faults: which faults each of its runs has, drawn from a seed.

::

    title = "..."
    scenario = "../teleoperation.toml"
    run = "8 s"                         # of one run
    torque_max = "120 N.m"              # in any node, at any time
    rehearsed = 0.5                     # part of the runs that are real processes
    [channels.can]
    deploy = "can"
    weight = 1                          # simulated runs of it in a turn through the channels
    rehearsals = 1                      # rehearsed ones
    settings = ["..."]                  # of every run
    rehearsal = ["..."]                 # of those that are real processes
    [kinds.drop]                        # as in a soak's file; pairs are drawn between the two
    for = ["0.2 s", "0.6 s"]

In a simulated run each stream of frames (a node and a message it hears) meets one fault in each of
some windows of time, or one hostile peer, and at its end one of its emulated drives has a fault. A
rehearsed run has faults of processes instead, and of the network where there is one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from bridge.campaign.drive_draw import draw_drive_fault, drives_of
from bridge.campaign.soak_spec import (
    DRIVE,
    FRAMES,
    LINKS,
    Soak,
    SoakSpec,
    Table,
    Value,
    kind_of,
    round_duration,
)
from bridge.deployment import spec as deploy
from bridge.deployment.system import System
from bridge.faults.script import HOSTILE
from cosim.base import toml
from cosim.base.convert import Quantity, convert, in_units
from cosim.base.errors import ScenarioError

#: s at the start and at the end of a run without faults, so that what they do still shows.
FIRST, LAST = 0.8, 1.0
#: Windows of time in a run, and the part of the streams that meet a hostile peer.
WINDOWS, WINDOWS_REHEARSED, HOSTILE_PART = 10, 2, 0.5
#: s within a run: when a node is frozen, has its clock set, is killed and started again. Ages say
#: how long the network takes only while clocks stay as they are, and peers that stop because a node
#: is away meet no later fault: so faults of the network come between the last two.
FREEZE, JUMP, NETWORK, RESTART = (0.8, 1.0), (1.2, 1.4), (1.7, 4.7), (4.7, 5.0)
#: s before the end of a run: when another node is killed.
KILL = 1.2


class ChannelSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A deployment that carries the frames, changed for this campaign."""

    deploy: str
    weight: int = 1
    rehearsals: int = 1
    settings: tuple[str, ...] = ()
    rehearsal: tuple[str, ...] = ()


class ManySpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A campaign of many faults as read; see the module. `run`: s, `torque_max`: N.m."""

    title: str = ""
    scenario: str
    run: Quantity
    torque_max: Quantity
    rehearsed: float = 0.2
    zenoh: str | tuple[str, ...] = ()
    channels: dict[str, ChannelSpec]
    kinds: dict[str, dict[str, Any]]

    def __post_init__(self) -> None:
        """Convert what has a unit. Raises ScenarioError."""
        in_units(self, run="s", torque_max="N.m")


class Many(msgspec.Struct, frozen=True):
    """A campaign and its file; `kinds`: what is drawn for each, by key."""

    path: Path
    spec: ManySpec
    kinds: dict[str, dict[str, Value]]

    @property
    def scenario(self) -> Path:
        """The scenario of all runs."""
        return (self.path.parent / self.spec.scenario).resolve()

    def deployment(self, channel: str) -> Path:
        """The deployment of a channel. Raises ScenarioError."""
        return deploy.find(self.scenario, self.spec.channels[channel].deploy).resolve()

    def changes(self, channel: str, rehearsed: bool) -> tuple[str, ...]:
        """Changes of scenario and deployment."""
        spec = self.spec.channels[channel]
        return (*spec.settings, *(spec.rehearsal if rehearsed else ()), f"run.stop={self.spec.run}")

    def soak(self) -> Soak:
        """The criteria by which the runs of a soak test and of a campaign are evaluated."""
        spec = SoakSpec(
            title=self.spec.title, zenoh=self.spec.zenoh, first=FIRST, last=self.spec.run - LAST,
            torque_max=self.spec.torque_max, kinds={},
        )  # fmt: skip
        return Soak(self.path, spec, self.kinds)

    def kind_of_run(self, k: int) -> tuple[str, bool]:
        """(channel, rehearsed) of run `k`: turns through the channels, some of them rehearsed."""
        turn = [name for name, spec in self.spec.channels.items() for _ in range(spec.weight)]
        every = [name for name, spec in self.spec.channels.items() for _ in range(spec.rehearsals)]
        part = self.spec.rehearsed
        before, now = (int((k + i) * part) for i in (0, 1))
        if now > before:
            return every[before % len(every)], True
        return turn[(k - before) % len(turn)], False


def load_many(path: Path) -> Many:
    """Read a campaign of many faults. Raises ScenarioError that names the file and the place."""
    spec = convert(toml.read(Path(path)), ManySpec, path, "")
    kinds = {kind: kind_of(kind, table, path) for kind, table in spec.kinds.items()}
    if not kinds or not spec.channels:
        raise ScenarioError("expected one [kinds.NAME] and one [channels.NAME] at least", str(path))
    if spec.run < RESTART[1] + 2.0:
        raise ScenarioError(
            f"is {spec.run:g} s; expected {RESTART[1] + 2.0:g} s or more", str(path)
        )
    return Many(path, spec, kinds)


# ---- one run --------------------------------------------------------------------------------


def document(
    many: Many, system: System, links: Sequence[str], rehearsed: bool, seed: int, k: int
) -> Table:
    """The fault script of run `k`; `links`: of the network between hosts."""
    random = np.random.default_rng((seed, k))
    tables: list[Table] = []
    away: set[str] = set()
    if rehearsed:
        tables += _of_processes(many, system, random)
        away = {t["node"] for t in tables if t["kind"] in ("restart", "kill")}
        tables += _of_links(many, links, random)
    tables += _of_frames(many, system, random, away, WINDOWS_REHEARSED if rehearsed else WINDOWS)
    drives = drives_of(system) if DRIVE in many.kinds and not rehearsed else []
    if drives:  # behind all others: it may stop nodes
        end = many.spec.run - LAST
        tables.append(draw_drive_fault(drives, random, end, end + LAST / 2))
    return {"title": f"run {k} of seed {seed}", "seed": seed * 100_003 + k, "fault": tables}


def _of_frames(
    many: Many, system: System, random: np.random.Generator, away: set[str], windows: int
) -> Iterator[Table]:
    hostile = [kind for kind in HOSTILE if kind in many.kinds]
    plain = [kind for kind in FRAMES if kind in many.kinds]
    length = (many.spec.run - FIRST - LAST) / windows
    own = {name for name, spec in system.deployment.messages.items() if not spec.profile}
    heard = [(n, m) for n in system.nodes if n not in away for m in system.received_by(n)]
    # frames of vendors have neither counter nor CRC: nothing would show what was done to them
    streams = [(n, m) for n, m in heard if m in own or m not in system.deployment.messages]
    for node, message in streams:
        at = range(windows)
        if hostile and random.random() < HOSTILE_PART:
            at, kinds = range(int(random.integers(windows)), windows)[:1], hostile
        else:
            kinds = plain
        for window in at:
            kind = str(random.choice(kinds))
            t0 = FIRST + window * length
            yield _framed(many, kind, t0, t0 + length, random, node=node, message=message)
    if "sync-loss" in many.kinds:
        for node in [n for n in _hearing_sync(system) if n not in away][:1]:
            yield _framed(many, "sync-loss", FIRST, many.spec.run - LAST, random, node=node)


def _hearing_sync(system: System) -> list[str]:
    """Nodes on a bus on which SYNC is sent: gateways do not forward it."""
    sender = system.deployment.sync
    buses = system.buses_of(sender) if sender else ()
    return [
        node
        for node in system.nodes
        if node != sender
        and system.received_by(node)
        and any(one.name == "SYNC" and one.bus in buses for one in system.subscriptions(node))
    ]


def _framed(
    many: Many, kind: str, low: float, high: float, random: np.random.Generator, **whom: str
) -> Table:
    """A fault that begins and ends between these times."""
    said = _drawn(many.kinds[kind], random)
    lasts = min(float(said.pop("for", high - low)), high - low)
    t = float(random.uniform(low, high - lasts))
    return {
        "kind": kind,
        **whom,
        "from": round_duration(t),
        "to": round_duration(t + lasts),
        **said,
    }


def _of_processes(many: Many, system: System, random: np.random.Generator) -> Iterator[Table]:
    """Faults of processes: a node is frozen and killed at the end, one has a wrong clock, one
    restarts.

    The killed node is not on a network that the restarted node needs to find the run. If every node
    is on that network, only one of the two faults is used.
    """
    there = [str(n) for n in random.permutation([n for n in system.nodes if system.received_by(n)])]
    near = [n for n in there if not _on_network(system, n)]
    killed = near[0] if near else there[0]
    again, *others = [n for n in there if n != killed]
    without = "" if near else str(random.choice(["kill", "restart"]))
    for kind, node, when in (
        ("restart", again, RESTART),
        ("freeze", killed, FREEZE),
        ("clock-jump", (others or [killed])[0], JUMP),
        ("kill", killed, (many.spec.run - KILL, many.spec.run - KILL)),
    ):
        if kind in many.kinds and kind != without:
            said = _drawn(many.kinds[kind], random)
            yield {
                "kind": kind,
                "node": node,
                "at": round_duration(float(random.uniform(*when))),
                **said,
            }


def _on_network(system: System, node: str) -> bool:
    buses = system.deployment.buses
    return any(buses[bus].kind == "zenoh" for bus in system.buses_of(node))


def _of_links(many: Many, links: Sequence[str], random: np.random.Generator) -> Iterator[Table]:
    """Each kind of a network's faults once, one after the other, while all nodes are there."""
    kinds = [str(k) for k in random.permutation([k for k in LINKS if k in many.kinds])]
    low, high = NETWORK
    length = (high - low) / max(1, len(kinds))
    for i, kind in enumerate(kinds if links else []):
        said = _drawn(many.kinds[kind], random)
        lasts = min(float(said.pop("for")), length)
        t = round_duration(low + i * length + float(random.uniform(0.0, length - lasts)))
        link = str(random.choice(["*", *links]))
        yield {"kind": kind, "link": link, "at": t, "for": round_duration(lasts), **said}


def _drawn(keys: Mapping[str, Value], random: np.random.Generator) -> dict[str, Any]:
    """A value for each key; `count` is an integer, `by` of what is late stays a pair."""
    found: dict[str, Any] = {}
    for key, value in keys.items():
        if key == "weight":
            continue
        found[key] = (
            round_duration(float(random.uniform(*value))) if isinstance(value, tuple) else value
        )
    if "count" in found:
        found["count"] = round(found["count"])
    return found
