"""The ways on which questions were lost, from the counts of the other end; runs and outages.

Every answer has the number of different questions that the other end has heard so far, and which
count this is: another one begins where the other end is started again, or has forgotten us. Between
two answers of one count it tells how many of the questions in between arrived. Before the first
answer of the first count all is known, too, since it begins with the first question heard. After
the last answer, and between two counts, nothing is: such questions count as lost on the way there,
and their share is stated.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bridge.ping.exchanges import NONE, Exchanges, Integers

Floats = NDArray[np.float64]
Marks = NDArray[np.bool_]

#: Shortest time without an answer that counts as an outage, s (or five periods, if longer).
OUTAGE = 0.1


@dataclass(frozen=True, slots=True)
class LossFigures:
    """`share` of the questions without an answer; `bursts`: mean and longest number in a row.

    `there`: share of the questions lost on their way; `back`: of the answers lost on theirs; NaN
    where the other end does not count. `undecided`: share of the questions that are in `there`
    though it is not known which way they were lost. `outages`: number and longest, s, of the times
    without an answer.
    """

    share: float
    burst: float
    longest: int
    there: float
    back: float
    undecided: float
    outages: int
    longest_outage: float


@dataclass(frozen=True, slots=True)
class LostWays:
    """Questions (n,) that were lost `there` or `back`; `undecided`: of those `there`, where it is
    not known. Within a gap the first ones are taken to be those lost on the way there.
    """

    there: Marks
    back: Marks
    undecided: Marks


def loss_figures(record: Exchanges, t1: Floats, t4: Floats) -> LossFigures:
    """All figures of losses. `t1`, `t4` (n,): sent and answered, s; t4 is NaN where it was not."""
    lost = np.isnan(t4)
    burst, longest = runs(lost)
    silent = np.ptp(outages(t1, ~lost, record.period_ns), axis=1)
    ways = lost_ways(record)
    there = back = np.nan
    undecided = 0.0
    if ways is not None:
        there, undecided = float(ways.there.mean()), float(ways.undecided.mean())
        back = float(ways.back[~ways.there].mean())
    return LossFigures(
        float(lost.mean()), burst, longest, there, back, undecided,
        silent.size, float(silent.max()) if silent.size else 0.0,
    )  # fmt: skip


def runs(lost: Marks) -> tuple[float, int]:
    """Mean and longest number of True in a row in `lost` (n,), dimensionless; 0 without any."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], lost, [False]]).astype(np.int8)))
    found = edges[1::2] - edges[::2]
    return (float(found.mean()), int(found.max())) if found.size else (0.0, 0)


def outages(sent: Floats, answered: Marks, period_ns: int) -> Floats:
    """Start and end of each time without an answer, (m, 2), s, also at both ends of the
    measurement. `sent` (n,): times of all questions, s; `answered` (n,): which of them were.
    """
    period = period_ns * 1e-9
    at = np.concatenate([[sent[0] - period], sent[answered], [sent[-1] + period]])
    rows = np.flatnonzero(np.diff(at) > max(OUTAGE, 5 * period))
    return np.stack([at[rows], at[rows + 1]], axis=1)


def lost_ways(record: Exchanges) -> LostWays | None:
    """The way each question was lost; None if the other end does not count, or where several
    other ends answer at once.
    """
    heard, count = record.stamp("heard"), record.stamp("count")
    answered = np.flatnonzero(heard != NONE)
    if not answered.size:
        return None
    lives = _lives(answered, count[answered])
    if lives is None:
        return None
    unanswered = np.ones(heard.size, dtype=bool)
    unanswered[answered] = False
    back, undecided = np.zeros_like(unanswered), np.zeros_like(unanswered)
    end = 0  # of what the lives so far tell
    for i, life in enumerate(lives):
        if i or record.whole:
            _before(life, heard[life], (end, i == 0), back, undecided)
        else:
            undecided[: life[0]] = True
        _between(life, heard[life], back)
        end = int(life[-1]) + 1
    undecided[end:] = True
    there = unanswered & ~back
    return LostWays(there, back, undecided & there)


def _lives(answered: Integers, count: Integers) -> list[Integers] | None:
    """The answered questions of each count, in order; None if two counts overlap."""
    found = [answered[count == which] for which in np.unique(count)]
    found.sort(key=lambda life: int(life[0]))
    if any(a[-1] > b[0] for a, b in pairwise(found)):
        return None
    return found


def _before(
    life: Integers, heard: Integers, start: tuple[int, bool], back: Marks, undecided: Marks
) -> None:
    """Mark the unanswered questions before the first of `life` (m,), with a new count `heard` (m,).

    `start`: the first question after the count before, and whether the others were surely heard by
    nobody.
    """
    begin, known = start
    first = int(life[0])
    arrived = min(max(int(heard.min()) - 1, 0), first - begin)
    back[first - arrived : first] = True
    if not known:
        undecided[begin : first - arrived] = True


def _between(life: Integers, heard: Integers, back: Marks) -> None:
    """Mark those of the unanswered questions between `life` (m,) that were heard and counted.

    Questions overtake each other: the counts are put in order, and what was counted where there is
    no gap belongs to the next one, or at the end to the last ones.
    """
    gaps, counted = np.diff(life) - 1, np.diff(np.sort(heard)) - 1
    rows = np.flatnonzero((gaps > 0) | (counted > 0))
    arrived = np.zeros_like(gaps)
    for order in (rows, rows[::-1]):
        open_ = 0
        for i in order.tolist():
            open_ += int(counted[i])
            taken = min(open_, int(gaps[i] - arrived[i]))
            arrived[i] += taken
            open_ -= taken
        counted = np.zeros_like(counted)
        if rows.size:
            counted[rows[-1]] = open_
    for i in np.flatnonzero(arrived):
        end = int(life[i + 1])
        back[end - int(arrived[i]) : end] = True
