"""The result of a falsification in words and as data."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from typing import Any

import numpy as np

from cosim.falsify.bounds import MovingChannel
from cosim.falsify.execute import Falsification
from cosim.falsify.judge import CandidateOutcome, Margin
from cosim.falsify.paths import Piece
from cosim.falsify.shrinking import MANY
from cosim.falsify.trials import JITTER, Trial
from cosim.links.laws import decimal_fraction
from cosim.measure.robustness import plain
from cosim.study.axes import Drawn


def lines(state: Falsification) -> Iterator[tuple[str, str]]:
    """(what it is, in words): of a failure, or that there was none and how far away it was."""
    account = state.account
    searched = ", ".join(f"{name} {n}" for name, n in account.runs.items() if name != "nominal")
    if state.found is None:
        yield "no failure", f"found in {account.total} runs: {searched or 'the nominal one only'}"
        for family, why in account.notes.items():
            yield "left out", f"{family}: {why}"
        for name, (margin, family, candidate) in account.least.items():
            yield "least margin", f"{name}: {_margin(margin)}, {family}: {candidate.says}"
        return
    found = state.found
    if found.family == "nominal":
        yield "found", "already with the nominal delays: the network need not move"
    else:
        yield "found", f"by {found.family}, after {account.total} runs ({found.candidate.says})"
    shrinking = state.shrinking
    assert shrinking is not None
    if shrinking.outcome is not None:
        yield "shrunk", f"in {shrinking.runs} runs to {size(state)}"
    yield "breaks", sentence(state)
    if shrinking.failing >= 0:
        share = f"{shrinking.failing} of {MANY} networks that differ by up to {1e3 * JITTER:g} ms"
        fragile = shrinking.failing < MANY
        yield "fragile" if fragile else "robust", f"{share} fail, too"


def size(state: Falsification) -> str:
    """``1 segment on 1 link, a run of 2 s``."""
    assert state.shrinking is not None
    trial = state.shrinking.now
    changed = sum(u is not None for u in trial.axes)
    values = f", {_count(changed, 'other value')}" if changed else ""
    return (
        f"{_count(len(trial.pieces), 'segment')} on {_count(len(trial.channels), 'link')}{values}, "
        f"a run of {trial.ticks * state.problem.h:.6g} s"
    )


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def sentence(state: Falsification) -> str:
    """One sentence that tells what breaks, and by which network."""
    assert state.found is not None and state.shrinking is not None
    name, outcome = state.found.requirement, state.shrinking.outcome or state.found.outcome
    what = f"{name} is violated: {_why(outcome, name)}"
    network = list(_network(state, state.shrinking.now))
    if not network:
        return what
    nominal = state.nominal and state.nominal.margins.get(name)
    holds = f", although it holds at the nominal delays ({_margin(nominal)})" if nominal else ""
    return f"{what}, with {'; '.join(network)}{holds}"


def _why(outcome: CandidateOutcome, name: str) -> str:
    if outcome.reason:
        at = f" at {outcome.stopped_at:.4g} s" if outcome.stopped_at == outcome.stopped_at else ""
        return f"the run stops{at} ({outcome.reason.partition(' (')[0]})"
    return _margin(outcome.margins[name])


def _margin(margin: Margin) -> str:
    at = f" at {margin.time:.4g} s" if margin.time == margin.time else ""
    return f"margin {margin.value:.4g} {margin.unit}{at}"


def _network(state: Falsification, trial: Trial) -> Iterator[str]:
    h = decimal_fraction(state.problem.h)
    for i, piece in trial.pieces[:4]:
        channel = state.problem.channels[i]
        value = "everything lost" if piece.value != piece.value else delay_of(state, i, piece)
        begin, end = float(piece.begin * h), float(piece.end * h)
        yield (
            f"{value} instead of {1e3 * channel.nominal:.6g} ms "
            f"{'' if channel.signal else 'for what is sent '}from {begin:g} s to {end:g} s on "
            f"{channel.name}{_speeds(channel)}"
        )
    if len(trial.pieces) > 4:
        yield f"and {len(trial.pieces) - 4} more segments"
    for axis, u in zip(state.problem.axes, trial.axes, strict=True):
        if u is not None:
            cell = axis.choice(u).cell if isinstance(axis, Drawn) else _listed(axis, u)
            yield (
                f"{axis.name} = {cell:.6g}" if isinstance(cell, float) else f"{axis.name} = {cell}"
            )


def _speeds(channel: MovingChannel) -> str:
    """The speed with which the delay may change, where it is limited."""
    (rise, fall), verbs = channel.speeds, ("rises", "falls")
    if rise == fall:
        return "" if rise == inf else f" (it changes by at most {rise:g} s/s)"
    found = [f"{verb} by at most {x:g} s/s" for verb, x in zip(verbs, (rise, fall), strict=True)
             if x < inf]  # fmt: skip
    return f" (it {' and '.join(found)})"


def delay_of(state: Falsification, i: int, piece: Piece) -> str:
    """The delay in a piece of channel `i`, or how far it gets on its way there."""
    if piece.value != piece.value:
        return "lost"
    channel, target = state.problem.channels[i], f"{1e3 * piece.value:.6g} ms"
    if min(channel.speeds) == inf or state.small is None:
        return target
    law = channel.law(state.problem.kept(state.small)[i])
    h = decimal_fraction(channel.h)
    delays = law.stream(h, None).take(piece.end)[piece.begin :]
    up = piece.value > channel.nominal
    reached = float(np.nanmax(delays) if up else np.nanmin(delays))
    if abs(reached - piece.value) < channel.h:
        return target
    return f"{1e3 * reached:.4g} ms on the way to {target}"


def _listed(axis: Any, u: float) -> Any:
    return axis.choices[min(len(axis.choices) - 1, int(u * len(axis.choices)))].cell


def as_data(state: Falsification) -> dict[str, Any]:
    """The result as plain data for JSON."""
    account = state.account
    data: dict[str, Any] = {
        "scenario": str(state.problem.path),
        "requirements": list(state.problem.wanted),
        "found": state.found is not None,
        "runs": account.total,
        "families": dict(account.runs),
        "left_out": dict(account.notes),
        "nominal": _outcome(account.nominal),
        "least": {
            name: {**_as_margin(margin), "family": family, "candidate": candidate.says}
            for name, (margin, family, candidate) in account.least.items()
        },
    }
    if state.found is None or state.shrinking is None:
        return data
    trial, small = state.shrinking.now, state.small
    assert small is not None
    return data | {
        "family": state.found.family,
        "candidate": state.found.candidate.says,
        "requirement": state.found.requirement,
        "sentence": sentence(state),
        "shrinking_runs": state.shrinking.runs,
        "segments": [_segment(state, i, p.begin, p.end, p.value) for i, p in trial.pieces],
        "links": sorted(state.problem.channels[i].name for i in trial.channels),
        "stop": trial.ticks * state.problem.h,
        "settings": list(state.problem.settings(small)),
        "outcome": _outcome(state.shrinking.outcome or state.found.outcome),
        "jitter": {"networks": MANY, "failing": state.shrinking.failing, "up_to_s": JITTER},
        "robust": state.shrinking.failing == MANY,
    }


def _segment(state: Falsification, i: int, begin: int, end: int, value: float) -> dict[str, Any]:
    h = decimal_fraction(state.problem.h)
    times = {"from": float(begin * h), "to": float(end * h)}
    given = {"lost": True} if value != value else {"delay": value}
    return {"link": state.problem.channels[i].name, **times, **given}


def _outcome(outcome: CandidateOutcome | None) -> dict[str, Any] | None:
    if outcome is None:
        return None
    margins = {name: _as_margin(m) for name, m in outcome.margins.items()}
    stopped_at = outcome.stopped_at if outcome.reason else None
    return {"margins": margins, "reason": outcome.reason, "stopped_at": stopped_at}


def _as_margin(margin: Margin) -> dict[str, Any]:
    return {"value": plain(margin.value), "unit": margin.unit, "time": plain(margin.time)}
