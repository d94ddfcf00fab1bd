"""The cut loop of a scenario, and the bounds of the ages of its links."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, isinf

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.certify.exact import Exact
from cosim.certify.model import CutLoop, LinkBounds
from cosim.linear.component import Matrix
from cosim.linear.loop import CutLink
from cosim.linear.opened import OpenLoop
from cosim.linear.scenario import opened
from cosim.links.losses import Lossy
from cosim.links.semantics import PacketSemantics, PlayoutSemantics, QueueSemantics
from cosim.links.table import DrawnTable, TableSpec
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario
from cosim.schedule.parts import Link
from cosim.schedule.plan import Plan

#: Curvature of a step, relative, above which a component has no linear model.
_ROUGH = 0.1
#: Norm of a row of A - 1 below which it is a rounding error, and the relative singular value below
#: which a direction is neutral.
_ROUNDING, _NEUTRAL = 1e-6, 1e-6


def cut_loop(
    scenario: Scenario, delays: tuple[float, float] | None = None
) -> tuple[CutLoop, OpenLoop]:
    """The loop of `scenario` at the end of its run, cut at its links, and what it comes from.

    `delays`: ages of all links from the first to the second (s), varying in any way, instead of
    those that their laws allow. Raises ScenarioError for what has no certificate.
    """
    plan = assemble(scenario)
    if not plan.links:
        raise ScenarioError("found no links; expected a scenario with links to certify")
    if plan.players:
        raise ScenarioError(
            "found weights that switch during the run; expected constant ones: a certificate is "
            "for one graph"
        )
    found = opened(scenario)
    for part in found.components:
        if part.error > _ROUGH:
            raise ScenarioError(
                f"{part.name} has no linear model at t = {found.time:g} s: its derivatives change "
                f"by {part.error:.1g} with the size of the differences; set run.stop to a time "
                "at which it is smooth"
            )
    links, held, sent = [], list[int](), list[int]()
    for link, cut in zip(plan.links, found.links, strict=True):
        if len(cut.held) != 1:
            raise ScenarioError(
                f"links.{link.name} is read every {cut.look * found.h:g} s in a loop of "
                f"{found.period:g} s; expected receivers that read once a period"
            )
        held += cut.held[0].tolist()
        sent += cut.sent.ravel().tolist()
        links.append(_bounds(plan, link, cut, delays))
    return _loop(found, links, held, sent), found


def _loop(
    found: OpenLoop, links: Sequence[LinkBounds], held: Sequence[int], sent: Sequence[int]
) -> CutLoop:
    A, B, C, D = (
        Exact.of(x.tolist(), x.shape[1])
        for x in (found.A, found.B[:, held], found.C[sent], found.D[np.ix_(sent, held)])
    )
    looks = [i for cut in found.links for i in cut.sent[0].tolist()]
    X = _neutral(found.A + found.B[:, held] @ _closed(found, held, looks))
    neutral = Exact.of(X.tolist(), X.shape[1])
    names = tuple(name for name, _ in found.states)
    return CutLoop(A, B, C, D, neutral, tuple(links), found.period, names)


def _closed(found: OpenLoop, held: Sequence[int], sent: Sequence[int]) -> Matrix:
    """The factors of the states in what receivers hold at rest: u = C x + D u."""
    D = found.D[np.ix_(sent, held)]
    return np.asarray(np.linalg.solve(np.eye(len(D)) - D, found.C[sent]))


def _neutral(A: Matrix) -> Matrix:
    """Directions X (n, k) with A X = X, to rounding."""
    M = A - np.eye(len(A))
    scale = np.maximum(np.linalg.norm(M, axis=1), _ROUNDING)
    _, values, rows = np.linalg.svd(M / scale[:, None])
    return np.asarray(rows[values <= _NEUTRAL].T)


def _bounds(plan: Plan, link: Link, cut: CutLink, delays: tuple[float, float] | None) -> LinkBounds:
    size, sends = len(cut.held[0]), len(cut.sent)
    if link.age is not None:
        raise ScenarioError(
            f"links.{link.name}: the receiver reads the age of what it holds, which changes the "
            "loop; expected `age` unconnected"
        )
    grid = link.table.grid
    if delays is not None:
        first, last = (ceil(round(d / (grid.n_s * grid.h), 9)) for d in delays)
        return LinkBounds(link.name, size, first, last, sends=sends)
    return LinkBounds(link.name, size, *age_limits(link.table, plan.ticks), sends)


def age_limits(table: TableSpec, ticks: int) -> tuple[int, int | None, bool]:
    """The least and the greatest age of what a link holds, samples, and if its order is kept.

    Of a receiver whose period is that of the sender or a multiple of it. Of a stored table these
    are the extremes of its rows in the first `ticks` ticks. None: there is no greatest age.
    """
    grid = table.grid
    if not isinstance(table, DrawnTable):
        rows = table.stream().rows(ticks // grid.n_r)
        held = rows[rows >= 0].astype(np.int64)
        ages = np.flatnonzero(rows >= 0) * grid.n_r // grid.n_s - held
        return int(ages.min(initial=0)), int(ages.max(initial=0)), bool((np.diff(held) >= 0).all())
    law, rule, longest = table.law, table.rule, 0.0
    if law.loses_packets:
        longest = law.loss.longest if isinstance(law, Lossy) else float("inf")
        law = law.delay if isinstance(law, Lossy) else law
    late = isinstance(rule, PlayoutSemantics) and law.maximum > rule.buffer
    last = isinstance(rule, PacketSemantics) and rule.order == "last-arrival"
    ordered = isinstance(rule, PacketSemantics | PlayoutSemantics) and not last
    if isinstance(rule, QueueSemantics):  # in the order of arrival; what is held may get older
        ordered = grid.ticks(law.maximum) - grid.ticks(law.minimum) <= grid.n_s
        last = law.maximum > law.minimum
    least = rule.least(law, grid) // grid.n_s
    if isinf(longest) or late or isinf(law.maximum):
        return least, None, ordered
    oldest = rule.greatest(law, grid)
    if longest:
        oldest += grid.ticks(longest) + grid.n_r
    if last:  # an old sample that arrives last is held until the next one arrives
        oldest += grid.ticks(law.maximum) - grid.ticks(law.minimum)
        oldest += grid.n_s if isinstance(rule, QueueSemantics) else 0
    return least, oldest // grid.n_s, ordered
