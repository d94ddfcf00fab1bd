"""Bounds of the network: what each channel of a scenario may do, and paths made to keep to that.

Links of one channel travel in the same packets and have one path. Links on a simulated bus and
links that replay a table stay as they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import gcd, inf, isfinite
from pathlib import Path

import numpy as np

from cosim.base.convert import number
from cosim.base.errors import ScenarioError
from cosim.base.names import unknown
from cosim.base.random_numbers import generator
from cosim.falsify.paths import DIGITS, DelayPath, Ints, PathLaw
from cosim.falsify.spec import LinkBoundsSpec, seconds
from cosim.links.laws import Constant, FloatArray, Law, decimal_fraction
from cosim.links.losses import Lossy
from cosim.links.presets import PRESETS
from cosim.links.semantics import SignalSemantics
from cosim.links.spec import delay_law
from cosim.links.table import DrawnTable
from cosim.links.traces import BusDelays
from cosim.scenario.spec import Scenario
from cosim.schedule.plan import Plan

#: Delays that are drawn to see what a law loses.
DRAWN = 100_000
#: The name of bounds for all links that have none of their own.
ALL = "*"


@dataclass(frozen=True, slots=True)
class MovingChannel:
    """A channel and its bounds. `links`: numbers of its links in the scenario, and in the plan.

    `step`: ticks between two of its delays; `low`, `high`, `nominal` (s); `speeds`: the fastest the
    delay rises and falls, s/s; `lost`: packets that may be lost in a row, and `outage` (s): no
    longer than this; `share` of all packets that may be lost. `laws`: what draws delays for it:
    its own law, presets and recorded paths. `signal`: a delay counts when it is read, else when a
    packet is sent.
    """

    name: str
    links: tuple[int, ...]
    places: tuple[int, ...]
    step: int
    h: float
    low: float
    high: float
    nominal: float
    speeds: tuple[float, float] = (inf, inf)
    lost: float = 0.0
    outage: float = inf
    share: float = 1.0
    laws: tuple[Law, ...] = ()
    signal: bool = False

    @property
    def moves(self) -> bool:
        """True if there is more than one path."""
        return self.high > self.low or self.longest_loss > 0

    @property
    def longest_loss(self) -> int:
        """The longest loss, ticks: whole packets."""
        within = min(self.lost, int(self.outage / (self.step * self.h) + 1e-9)
                     if isfinite(self.outage) else inf)  # fmt: skip
        return int(within) * self.step if self.share else 0

    @property
    def base(self) -> DelayPath:
        """The nominal delay throughout."""
        return DelayPath.constant(self.nominal)

    def law(self, path: DelayPath) -> PathLaw:
        """A path that :meth:`kept` has made, for a plan: with ramps instead of jumps."""
        h = decimal_fraction(self.h)
        return PathLaw(path, h, self.low, self.high, self.longest_loss > 0, self.speeds)

    def kept(self, path: DelayPath, ticks: int) -> DelayPath:
        """The path within the bounds, of a run of `ticks` ticks: losses become shorter and fewer.

        The law follows it no faster than it may.
        """
        edges, values = _with_losses(self, path, ticks)
        return DelayPath.of(edges, np.clip(values, self.low, self.high))


def _with_losses(channel: MovingChannel, path: DelayPath, ticks: int) -> tuple[Ints, FloatArray]:
    """Edges and values with losses no longer and no more than they may be."""
    if not np.isnan(path.values).any():
        return path.edges, path.values
    step, longest = channel.step, channel.longest_loss
    path = DelayPath.of(-(-path.edges // step) * step, path.values)  # as packets have it
    left = int(channel.share * -(-ticks // step) + 1e-9) * step
    edges, values, before = list[int](), list[float](), channel.nominal
    ends = [*path.edges[1:].tolist(), -(-ticks // step) * step]
    for begin, end, value in zip(path.edges.tolist(), ends, path.values.tolist(), strict=True):
        if value == value:
            edges, values, before = [*edges, begin], [*values, value], value
            continue
        lasts = max(0, min(end - begin, longest, left))
        left -= lasts
        edges, values = [*edges, begin, begin + lasts], [*values, value, before]
    last = np.append(np.diff(edges) > 0, True)
    return np.array(edges, np.int64)[last], np.array(values)[last]


# ---- from a scenario ----------------------------------------------------------------------------


def channels(
    scenario: Scenario, plan: Plan, given: Mapping[str, LinkBoundsSpec]
) -> tuple[MovingChannel, ...]:
    """The channels of a scenario, as far as they have a law, with their bounds.

    `plan`: of the scenario. `given`: bounds by link, channel or :data:`ALL`. Raises ScenarioError.
    """
    groups: dict[str, list[tuple[int, int, DrawnTable]]] = {}
    names: dict[str, str] = {}
    places = {link.name: i for i, link in enumerate(plan.links)}
    for i, (spec, name) in enumerate(zip(scenario.links, _names(scenario, plan), strict=True)):
        link = plan.links[places[name]]
        if scenario.components[link.source.component].compute:
            continue  # a law in a file has the time that the sender computes on top
        table = link.table
        if isinstance(table, DrawnTable) and not isinstance(table.law, BusDelays):
            names[name] = spec.channel or name
            groups.setdefault(spec.channel or name, []).append((i, places[name], table))
    for key in given:
        if key != ALL and key not in names and key not in groups:
            known = [ALL, *names, *(g for g in groups if g not in names)]
            raise ScenarioError(
                unknown(key, known, "link with a law"), scenario.place("falsify", "links")
            )
    found = []
    for channel, links in groups.items():
        own = [n for n, c in names.items() if c == channel and n in given]
        if len(own) > 1:
            raise ScenarioError(
                f"{own[0]} and {own[1]} are of the channel {channel}, whose packets have one "
                f"delay; expected bounds for one of them, or for {channel}",
                scenario.place("falsify", "links"),
            )
        key = channel if channel in given else own[0] if own else ALL
        place = scenario.place("falsify", "links", key)
        bounds = given.get(key, LinkBoundsSpec())
        found.append(_channel(channel, links, bounds, place, scenario.path.parent))
    return tuple(found)


def _names(scenario: Scenario, plan: Plan) -> Iterator[str]:
    """The name of each link of the scenario, in its order."""
    ends = {(x.source.name, x.target.name): x.name for x in plan.links}
    known = {link.name for link in plan.links}
    for spec in scenario.links:
        yield spec.name if spec.name in known else ends[spec.source, spec.target]


def _channel(
    name: str,
    links: Sequence[tuple[int, int, DrawnTable]],
    bounds: LinkBoundsSpec,
    place: str,
    folder: Path,
) -> MovingChannel:
    tables = [table for _, _, table in links]
    signal = any(isinstance(t.rule, SignalSemantics) for t in tables)
    step = gcd(*(t.grid.n_r if signal else t.grid.n_s for t in tables))
    law, h = tables[0].law, tables[0].grid.h
    like = tuple(_like(x, folder, place) for x in bounds.like)
    low, high = _delays(bounds, [law, *like], _least(tables), place)
    nominal = min(max(law.mean, low), high)
    if bounds.nominal is not None:
        nominal = seconds(bounds.nominal, f"{place}.nominal")
        if not low <= nominal <= high:
            raise ScenarioError(
                f"found {nominal:g} s; expected a delay from {low:g} s to {high:g} s",
                f"{place}.nominal",
            )
    lost, outage, share = _losses([law, *like], bounds, tables, place)
    own = () if isinstance(law, Constant) else (law,)
    return MovingChannel(
        name, tuple(i for i, _, _ in links), tuple(i for _, i, _ in links), step, h,
        low, high, round(nominal, DIGITS), _speeds(bounds, signal), lost, outage, share,
        (*own, *like), signal,
    )  # fmt: skip


def _delays(
    bounds: LinkBoundsSpec, laws: Sequence[Law], least: float, place: str
) -> tuple[float, float]:
    """The shortest, not below `least`, and the longest delay, s. Raises ScenarioError."""
    low, high = min(law.minimum for law in laws), max(law.maximum for law in laws)
    if bounds.delay is not None:
        low, high = (seconds(x, f"{place}.delay") for x in bounds.delay)
    if high < low:
        raise ScenarioError(
            f"found [{low:g} s, {high:g} s]; expected the least delay, and one that is no less",
            f"{place}.delay",
        )
    low, high = (round(max(x, least), DIGITS) for x in (low, high))
    return low, high


def _speeds(bounds: LinkBoundsSpec, signal: bool) -> tuple[float, float]:
    """The fastest the delay rises and falls, s/s.

    Packets keep their order if it falls by no more than a second in a second; what the receiver of
    a signal holds gets no older if it rises no faster.
    """
    fast = bounds.rate or inf
    ordered = fast if bounds.reorder else min(fast, 1.0)
    return (ordered, fast) if signal else (fast, ordered)


def _least(tables: Sequence[DrawnTable]) -> float:
    """The least delay (s) with which none of these links orders like a wire."""
    k = 1
    while any(t.rule.least(Constant(k * t.grid.h), t.grid) < 1 for t in tables):
        k += 1
    return k * tables[0].grid.h


def _losses(
    laws: Sequence[Law], bounds: LinkBoundsSpec, tables: Sequence[DrawnTable], place: str
) -> tuple[float, float, float]:
    """(packets in a row, longest time (s), share) that may be lost. Raises ScenarioError."""
    given = [x for x in (bounds.lost, bounds.outage, bounds.share) if x is not None]
    outage = inf if bounds.outage is None else seconds(bounds.outage, f"{place}.outage")
    share = 1.0 if bounds.share is None else number(bounds.share, "1", f"{place}.share")
    if not 0 <= share <= 1:
        raise ScenarioError(f"found {share:g}; expected from 0 to 1", f"{place}.share")
    unable = [t for t in tables if t.rule.facts()["semantics"] in ("signal", "fifo")]
    if given and all((bounds.lost != 0, outage, share)):
        if unable:
            raise ScenarioError(
                f"losses, but the link {unable[0].name} with semantics = "
                f'"{unable[0].rule.facts()["semantics"]}" loses nothing; expected "last-arrival", '
                '"newest-stamp" or "playout"',
                place,
            )
        return bounds.lost or (1.0 if bounds.outage is None else inf), outage, share
    if given or unable:
        return 0.0, inf, 0.0
    found = [_lost(law, tables[0]) for law in laws if law.loses_packets]
    if not found:
        return 0.0, inf, 0.0
    rows, times, shares = zip(*found, strict=True)
    return max(rows), max(times), max(shares)


def _lost(law: Law, table: DrawnTable) -> tuple[float, float, float]:
    """(packets in a row, longest time (s), share) that a law loses, as drawn."""
    period = table.grid.sending_period
    limit = law.limit(period)
    delays = law.stream(period, generator(0, table.name)).take(min(DRAWN, limit or DRAWN))
    lost = ~np.isfinite(delays)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], lost, [False]))))
    longest = float((edges[1::2] - edges[::2]).max(initial=0))
    if isinstance(law, Lossy):
        return longest, law.loss.longest, law.loss.share
    return longest, inf, float(lost.mean())


def _like(name: str, folder: Path, place: str) -> Law:
    """A preset by its name, or a recorded path. Raises ScenarioError."""
    if name in PRESETS:
        return delay_law({"law": "preset", "name": name}, folder)
    if not (folder / name).is_file():
        raise ScenarioError(
            f"{unknown(name, PRESETS, 'preset of a network')}, and no file", f"{place}.like"
        )
    return delay_law({"law": "trace", "file": name, "repeat": True}, folder)
