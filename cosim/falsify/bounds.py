"""Bounds of the network: what each channel of a scenario may do, and paths made to keep to that.

Links of one channel travel in the same packets and have one path. Links on a simulated bus and
links that replay a table stay as they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite
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

    `step`: ticks between two of its delays; `low`, `high`, `nominal` (s); `rate`: the fastest
    change of the delay, s/s; `lost`: packets that may be lost in a row, and `outage` (s): no
    longer than this; `share` of all packets that may be lost. `laws`: what draws delays for it:
    its own law, presets and recorded paths.
    """

    name: str
    links: tuple[int, ...]
    places: tuple[int, ...]
    step: int
    h: float
    low: float
    high: float
    nominal: float
    rate: float = inf
    reorder: bool = True
    lost: int = 0
    outage: float = inf
    share: float = 1.0
    laws: tuple[Law, ...] = ()

    @property
    def moves(self) -> bool:
        """True if there is more than one path."""
        return self.high > self.low or self.longest_loss > 0

    @property
    def longest_loss(self) -> int:
        """The longest loss, ticks."""
        if not self.share:
            return 0
        within = self.lost * self.step
        longest = int(self.outage / self.h + 1e-9) if isfinite(self.outage) else within
        return min(within, longest) if self.lost else longest

    @property
    def base(self) -> DelayPath:
        """The nominal delay throughout."""
        return DelayPath.constant(self.nominal)

    def law(self, path: DelayPath) -> PathLaw:
        """A path that :meth:`kept` has made, for a plan."""
        h = decimal_fraction(self.h)
        return PathLaw(path, h, self.low, self.high, self.longest_loss > 0)

    def kept(self, path: DelayPath, ticks: int) -> DelayPath:
        """The path within the bounds, of a run of `ticks` ticks: what is nearest, from its start.

        A loss becomes shorter; a delay that may not change at once, a ramp.
        """
        edges, values = _with_losses(self, path, ticks)
        values = np.clip(values, self.low, self.high)
        up, down = self.rate, self.rate if self.reorder else min(self.rate, 1.0)
        if not isfinite(min(up, down)):
            return DelayPath.of(edges, values)
        return _ramps(edges, values, (up, down), (self.step, self.h), ticks)


def _with_losses(channel: MovingChannel, path: DelayPath, ticks: int) -> tuple[Ints, FloatArray]:
    """Edges and values with losses no longer and no more than they may be."""
    if not np.isnan(path.values).any():
        return path.edges, path.values
    longest, left = channel.longest_loss, int(channel.share * ticks)
    edges, values, before = list[int](), list[float](), channel.nominal
    ends = [*path.edges[1:].tolist(), ticks]
    for begin, end, value in zip(path.edges.tolist(), ends, path.values.tolist(), strict=True):
        if value == value:
            edges, values, before = [*edges, begin], [*values, value], value
            continue
        lasts = max(0, min(end - begin, longest, left))
        left -= lasts
        edges, values = [*edges, begin, begin + lasts], [*values, value, before]
    last = np.append(np.diff(edges) > 0, True)
    return np.array(edges, np.int64)[last], np.array(values)[last]


def _ramps(
    edges: Ints,
    values: FloatArray,
    rates: tuple[float, float],
    steps: tuple[int, float],
    ticks: int,
) -> DelayPath:
    """The path with jumps as ramps of at most `rates` up and down, s/s.

    `steps`: ticks between two delays, and a tick, s.
    """
    step, h = steps
    edges = -(-edges // step) * step
    last = np.append(np.diff(edges) > 0, True)
    edges, values = edges[last], values[last]
    new_edges, new_values, now = [np.zeros(0, np.int64)], [np.zeros(0)], float("nan")
    ends = np.append(edges[1:], max(ticks, int(edges[-1]) + 1))
    for begin, end, value in zip(edges.tolist(), ends.tolist(), values.tolist(), strict=True):
        if value != value or now != now:
            new_edges.append(np.array([begin]))
            new_values.append(np.array([value]))
            now = now if value != value else value
            continue
        slope = (rates[0] if value > now else -rates[1]) * step * h
        n = -(-(end - begin) // step)
        need = max(1, min(n, int(np.ceil(abs((value - now) / slope)))))
        ramp = now + slope * np.arange(1, need + 1)
        ramp = np.minimum(ramp, value) if value > now else np.maximum(ramp, value)
        new_edges.append(begin + step * np.arange(len(ramp), dtype=np.int64))
        new_values.append(ramp)
        now = float(ramp[-1])
    return DelayPath.of(np.concatenate(new_edges), np.concatenate(new_values))


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
        table = plan.links[places[name]].table
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
    table = tables[0]
    signal = isinstance(table.rule, SignalSemantics)
    step = min(t.grid.n_r if signal else t.grid.n_s for t in tables)
    law = table.law
    low, high = law.minimum, law.maximum
    if bounds.delay is not None:
        low, high = (seconds(x, f"{place}.delay") for x in bounds.delay)
    if high < low:
        raise ScenarioError(
            f"found [{low:g} s, {high:g} s]; expected the least delay, and one that is no less",
            f"{place}.delay",
        )
    least = _least(tables)
    low, high = (round(max(x, least), DIGITS) for x in (low, high))
    nominal = min(max(law.mean, low), high)
    if bounds.nominal is not None:
        nominal = seconds(bounds.nominal, f"{place}.nominal")
        if not low <= nominal <= high:
            raise ScenarioError(
                f"found {nominal:g} s; expected a delay from {low:g} s to {high:g} s",
                f"{place}.nominal",
            )
    lost, outage, share = _losses(law, bounds, table, place)
    laws = tuple(_like(x, folder, place) for x in bounds.like)
    own = () if isinstance(law, Constant) else (law,)
    return MovingChannel(
        name, tuple(i for i, _, _ in links), tuple(i for _, i, _ in links), step, table.grid.h,
        low, high, round(nominal, DIGITS), bounds.rate or inf,
        bounds.reorder is not False or signal, lost, outage, share, (*own, *laws),
    )  # fmt: skip


def _least(tables: Sequence[DrawnTable]) -> float:
    """The least delay (s) with which none of these links orders like a wire."""
    k = 1
    while any(t.rule.least(Constant(k * t.grid.h), t.grid) < 1 for t in tables):
        k += 1
    return k * tables[0].grid.h


def _losses(
    law: Law, bounds: LinkBoundsSpec, table: DrawnTable, place: str
) -> tuple[int, float, float]:
    """(packets in a row, longest time (s), share) that may be lost. Raises ScenarioError."""
    given = (bounds.lost, bounds.outage, bounds.share)
    wanted = bool(bounds.lost or bounds.outage or bounds.share)
    if wanted and not _may_lose(table):
        raise ScenarioError(
            f"losses, but the link {table.name} with semantics = "
            f'"{table.rule.facts()["semantics"]}" loses nothing; expected "last-arrival", '
            '"newest-stamp" or "playout"',
            place,
        )
    if wanted or any(x is not None for x in given):
        outage = inf if bounds.outage is None else seconds(bounds.outage, f"{place}.outage")
        share = 1.0 if bounds.share is None else number(bounds.share, "1", f"{place}.share")
        if not 0 <= share <= 1:
            raise ScenarioError(f"found {share:g}; expected from 0 to 1", f"{place}.share")
        lost = bounds.lost or (1 if bounds.outage is None and share else 0)
        return lost, outage, share if wanted else 0.0
    if not isinstance(law, Lossy):
        return 0, inf, 0.0
    drawn = law.loss.stream(table.grid.sending_period, generator(0, table.name)).take(DRAWN)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], drawn, [False]))))
    longest = int((edges[1::2] - edges[::2]).max(initial=0))
    return longest, law.loss.longest if isfinite(law.loss.longest) else inf, law.loss.share


def _may_lose(table: DrawnTable) -> bool:
    return table.rule.facts()["semantics"] not in ("signal", "fifo")


def _like(name: str, folder: Path, place: str) -> Law:
    """A preset by its name, or a recorded path. Raises ScenarioError."""
    if name in PRESETS:
        return delay_law({"law": "preset", "name": name}, folder)
    if not (folder / name).is_file():
        raise ScenarioError(
            f"{unknown(name, PRESETS, 'preset of a network')}, and no file", f"{place}.like"
        )
    return delay_law({"law": "trace", "file": name, "repeat": True}, folder)
