"""Trials: candidates as their differences from the nominal one, and simpler or other ones.

:mod:`cosim.falsify.shrinking` decides which of them are run, and from which the next ones come.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from cosim.base.copies import replace
from cosim.base.random_numbers import generator
from cosim.falsify.evaluation import Problem
from cosim.falsify.paths import Candidate, DelayPath, Piece

#: The change of a delay that must not matter, s, and how long it stays.
JITTER, KEPT = 0.005, 0.03


@dataclass(frozen=True, slots=True)
class Trial:
    """A candidate as its differences from the nominal one: pieces by channel, and axes."""

    pieces: tuple[tuple[int, Piece], ...]
    axes: tuple[float | None, ...]
    ticks: int

    @property
    def channels(self) -> frozenset[int]:
        """The channels that differ."""
        return frozenset(channel for channel, _ in self.pieces)

    def without(self, gone: Iterable[int]) -> Trial:
        """The same without some pieces, by number."""
        left = set(gone)
        return self.having(p for i, p in enumerate(self.pieces) if i not in left)

    def having(self, pieces: Iterable[tuple[int, Piece]]) -> Trial:
        """The same with other pieces."""
        return replace(self, pieces=tuple(sorted(pieces, key=lambda p: (p[0], p[1].begin))))

    def changed(self, i: int, piece: Piece) -> Trial:
        """The same with another piece in the place of number `i`."""
        channel = self.pieces[i][0]
        return self.having([*self.pieces[:i], (channel, piece), *self.pieces[i + 1 :]])

    def cut(self, begin: int | None, end: int | None) -> Trial:
        """The parts of pieces from tick `begin` on, and before `end` or the end of the run."""
        a, b = begin or 0, self.ticks if end is None else end
        return self.having(
            (c, replace(p, begin=max(p.begin, a), end=min(p.end, b)))
            for c, p in self.pieces
            if p.end > a and p.begin < b
        )


@dataclass(frozen=True, slots=True)
class Trials:
    """The trials of a problem."""

    problem: Problem

    def of(self, candidate: Candidate) -> Trial:
        """The trial of a candidate."""
        pieces = [
            (i, piece)
            for i, (channel, path) in enumerate(
                zip(self.problem.channels, candidate.paths, strict=True)
            )
            for piece in path.pieces(channel.nominal, candidate.ticks)
        ]
        return Trial(tuple(pieces), candidate.axes, candidate.ticks)

    def candidate(self, trial: Trial) -> Candidate:
        """The candidate of a trial."""
        paths = []
        for i, channel in enumerate(self.problem.channels):
            mine = [p for c, p in trial.pieces if c == i and p.begin < trial.ticks]
            paths.append(DelayPath.changed(channel.nominal, mine))
        return Candidate(tuple(paths), trial.axes, trial.ticks)

    def within_bounds(self, trial: Trial) -> Trial:
        """The pieces as they are run: losses that are too long are cut."""
        candidate = self.candidate(trial)
        return self.of(replace(candidate, paths=self.problem.kept(candidate)))

    def jittered(self, trial: Trial, number: int) -> Candidate:
        """The candidate with other delays by up to :data:`JITTER`, one of many."""
        paths = []
        for channel, path in zip(self.problem.channels, self.candidate(trial).paths, strict=True):
            held = max(channel.step, round(KEPT / channel.h))
            ticks = np.arange(0, trial.ticks, channel.step)
            random = generator(number, f"falsify:jitter:{channel.name}")
            noise = random.uniform(-JITTER, JITTER, -(-trial.ticks // held) + 1)
            paths.append(DelayPath.of(ticks, path.at(ticks) + noise[ticks // held]))
        return Candidate(tuple(paths), trial.axes, trial.ticks)

    def with_jitter(self, trial: Trial, networks: int) -> list[Candidate]:
        """The candidate of a trial, and as many with jitter."""
        return [self.candidate(trial), *(self.jittered(trial, k) for k in range(networks))]

    def coarser(self, trial: Trial) -> list[Trial]:
        """The same on coarse grids of time: each cell has its extreme, its mean, or its first."""
        h = self.problem.h
        return [
            coarse
            for length in (2.0, 1.0, 0.5, 0.2, 0.1, 0.05)
            for how in ("far", "mean", "first")
            if (cell := round(length / h)) >= 1
            and len((coarse := self._on_grid(trial, cell, how)).pieces) < len(trial.pieces)
        ]

    def _on_grid(self, trial: Trial, cell: int, how: str) -> Trial:
        pieces = []
        candidate = self.candidate(trial)
        for i in sorted(trial.channels):
            channel, path = self.problem.channels[i], candidate.paths[i]
            ticks = np.arange(0, trial.ticks, channel.step)
            values, cells = path.at(ticks), ticks // cell
            starts = np.searchsorted(cells, np.arange(cells[-1] + 1))
            found = []
            for a, b in zip(starts, [*starts[1:], len(values)], strict=True):
                some = values[a:b]
                if how == "first" or np.isnan(some).any():
                    found.append(float(some[0]))
                elif how == "mean":
                    found.append(float(some.mean()))
                else:
                    found.append(float(some[np.argmax(np.abs(some - channel.nominal))]))
            grid = DelayPath.of(cell * np.arange(len(found)), found)
            pieces += [(i, p) for p in grid.pieces(channel.nominal, trial.ticks)]
        return trial.having(pieces)

    def joints(self, trial: Trial) -> list[Trial]:
        """All ways to make two neighbours one, the closest first."""
        found: list[tuple[int, int, Trial]] = []
        for i, ((c, a), (d, b)) in enumerate(zip(trial.pieces, trial.pieces[1:], strict=False)):
            if c != d:
                continue
            channel = self.problem.channels[c]
            values = dict.fromkeys(x for x in (a.value, b.value, channel.low, channel.high))
            for value in values:
                if value != channel.nominal:
                    rest = trial.without([i, i + 1]).pieces
                    one = trial.having([*rest, (c, Piece(a.begin, b.end, value))])
                    found.append((b.begin - a.end, i, one))
        return [one for _, _, one in sorted(found, key=lambda x: x[:2])]

    def mutant(self, trial: Trial, random: Generator) -> Trial:
        """The same with some edges at other times, some values at a bound, some on other links."""
        pieces: list[tuple[int, Piece]] = []
        sd = float(np.exp(random.uniform(np.log(0.02), np.log(1.0)))) / self.problem.h
        for channel, piece in trial.pieces:
            begin, end, value = piece.begin, piece.end, piece.value
            if random.random() < 0.7:
                shift = random.normal(0.0, sd, 2)
                begin, end = round(begin + shift[0]), round(end + shift[1])
            if random.random() < 0.1:
                channel = int(random.integers(len(self.problem.channels)))
            bounds = self.problem.channels[channel]
            if random.random() < 0.3 and value == value:
                value = float(random.choice((bounds.low, bounds.high)))
            begin, end = max(0, begin), min(trial.ticks, max(end, begin + bounds.step))
            pieces.append((channel, Piece(begin, end, value)))
        return _without_overlaps(trial.having(pieces))

    def later(self, trial: Trial, i: int) -> Iterable[Trial]:
        """The same with a piece that begins later."""
        channel, piece = trial.pieces[i]
        step, n = self.problem.channels[channel].step, piece.end - piece.begin
        for by in _shares(n, step):
            yield trial.changed(i, replace(piece, begin=piece.begin + by))

    def sooner(self, trial: Trial, i: int) -> Iterable[Trial]:
        """The same with a piece that ends sooner."""
        channel, piece = trial.pieces[i]
        step, n = self.problem.channels[channel].step, piece.end - piece.begin
        for by in _shares(n, step):
            yield trial.changed(i, replace(piece, end=piece.end - by))

    def milder(self, trial: Trial, i: int) -> Iterable[Trial]:
        """The same with a piece nearer to the nominal delay."""
        channel, piece = trial.pieces[i]
        nominal = self.problem.channels[channel].nominal
        if piece.value != piece.value:
            yield trial.changed(i, replace(piece, value=self.problem.channels[channel].high))
            return
        for share in (0.1, 0.25, 0.5, 0.75, 0.9, 0.97):
            value = round(nominal + share * (piece.value - nominal), 3)
            if value not in (nominal, piece.value):
                yield trial.changed(i, replace(piece, value=value))

    def rounded(self, trial: Trial, i: int) -> Iterable[Trial]:
        """The same with a piece at times of few digits."""
        channel, piece = trial.pieces[i]
        step, h = self.problem.channels[channel].step, self.problem.h
        for size in (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, step * h):
            n = max(1, round(size / h))
            a, b = round(piece.begin / n) * n, round(piece.end / n) * n
            if a < b and (size == step * h or b - a <= 1.5 * (piece.end - piece.begin) + step):
                one = trial.changed(i, replace(piece, begin=a, end=b))
                if _apart(one):
                    yield one

    def rounded_value(self, trial: Trial, i: int) -> Iterable[Trial]:
        """The same with a piece whose delay has few digits."""
        channel, piece = trial.pieces[i]
        bounds = self.problem.channels[channel]
        if piece.value == piece.value:
            for size in (0.5, 0.1, 0.05, 0.01, 0.005, 0.001):
                value = round(round(piece.value / size) * size, 6)
                if bounds.low <= value <= bounds.high and value != bounds.nominal:
                    yield trial.changed(i, replace(piece, value=value))


def _shares(n: int, step: int) -> list[int]:
    """Parts of a length of `n` ticks, the largest first, in steps."""
    found = dict.fromkeys(int(n * share) // step * step for share in (0.75, 0.5, 0.25, 0.1))
    return [x for x in (*found, step) if 0 < x < n]


def _without_overlaps(trial: Trial) -> Trial:
    """The same with pieces that end where the next one of their channel begins."""
    pieces = []
    for (c, a), (d, b) in zip(trial.pieces, [*trial.pieces[1:], (-1, None)], strict=True):
        end = min(a.end, b.begin) if b is not None and c == d else a.end
        if end > a.begin:
            pieces.append((c, replace(a, end=end)))
    return trial.having(pieces)


def _apart(trial: Trial) -> bool:
    """True if no two pieces of a channel overlap."""
    pairs = zip(trial.pieces, trial.pieces[1:], strict=False)
    return all(c != d or a.end <= b.begin for (c, a), (d, b) in pairs)
