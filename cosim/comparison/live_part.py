"""The part of a comparison's page in which delays are moved and all controllers run again.

Every case of the first seed that a page can compute is in it as a bundle (:mod:`cosim.live`),
engine and models once. A value of a link law moves that of every link made from it. Its path is
that of ``--set links.LAW.PATH=VALUE``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

from cosim.base.errors import CosimError, ScenarioError
from cosim.base.units import printed_unit
from cosim.comparison.aligned import AlignedError
from cosim.comparison.comparison import Comparison, cases
from cosim.comparison.documents import Base, Case, Document, case_document
from cosim.comparison.measure import CaseOutcome
from cosim.comparison.requirement_margin import RequirementMargin
from cosim.comparison.rows import NOTHING, columns, format_number, header
from cosim.comparison.spec import PortMeasure
from cosim.comparison.variants import ComparisonSelection, LinkLaw, MetricColumn, Variants
from cosim.live.bundle import bundle_of, packed
from cosim.live.candidates import slider_step
from cosim.live.judged import metric_data, requirement_data
from cosim.live.page import asset, scripts
from cosim.measure.requirements import requirements
from cosim.reporting.html import command, folded, table
from cosim.scenario.spec import build

#: Entries of a bundle that are equal in all of them.
_SHARED = ("engine", "layouts", "log")


@dataclass
class LiveCases:
    """The bundles of cases, and the reason of each case that a page cannot compute.

    `sliders`: of each link law, by path; `moves`: the keys of a bundle that a path moves.
    """

    bundles: dict[Case, dict[str, Any]] = field(default_factory=dict)
    moves: dict[Case, dict[str, list[str]]] = field(default_factory=dict)
    reasons: dict[Case, str] = field(default_factory=dict)
    sliders: dict[str, dict[str, dict[str, Any]]] = field(default_factory=dict)


def live_cases(base: Base, variants: Variants, chosen: ComparisonSelection) -> LiveCases:
    """The bundles of all cases of the first seed.

    Raises ScenarioError if a page can compute none of them.
    """
    found = LiveCases()
    for case in cases(chosen, [base.seed]):
        document = case_document(base, variants, case)
        try:
            made = bundle_of(document, base.path, "links.")
        except CosimError as error:
            found.reasons[case] = str(error)
            continue
        moves = _moves(made, document, variants, variants.links[case.link])
        if moves:
            found.bundles[case], found.moves[case] = made, moves
        else:
            found.reasons[case] = _fixed(made)
    if not found.bundles:
        case, why = next(iter(found.reasons.items()))
        raise ScenarioError(f"no page can run {case.name}: {why}; leave out --live", "--live")
    for link in chosen.links:
        if sliders := _sliders(found, link):
            found.sliders[link] = sliders
    return found


def _moves(
    made: Mapping[str, Any], document: Document, variants: Variants, law: LinkLaw
) -> dict[str, list[str]]:
    """The keys of a bundle by the path of the law's value that each of them follows."""
    controllers = {role.controller for role in variants.roles.values()}
    moves: dict[str, list[str]] = {}
    for key in made["keys"]:
        _, number, rest = key["key"].split(".", 2)
        link = document["links"][int(number)]
        if link["to"].partition(".")[0] not in controllers:
            continue
        receiver = link["channel"].rpartition("->")[2]
        own = rest.partition(".")[0] in law.sides.get(receiver, {})
        moves.setdefault(f"{receiver}.{rest}" if own else rest, []).append(key["key"])
    return moves


def _fixed(made: Mapping[str, Any]) -> str:
    """The reason why no value of a bundle's links can be moved."""
    reasons = [entry["reason"] for entry in made["fixed"]]
    return f"its links cannot be moved: {reasons[0]}" if reasons else "it has no link to move"


def _sliders(found: LiveCases, link: str) -> dict[str, dict[str, Any]]:
    """The values of a law that all of its cases can move, within the ranges of all."""
    mine = [case for case in found.bundles if case.link == link]
    sliders = {}
    for path in found.moves[mine[0]] if mine else ():
        if not all(path in found.moves[case] for case in mine):
            continue
        keys = [
            key
            for case in mine
            for key in found.bundles[case]["keys"]
            if key["key"] in found.moves[case][path]
        ]
        low, high = max(k["low"] for k in keys), min(k["high"] for k in keys)
        choices = [x for x in keys[0]["choices"] if all(x in k["choices"] for k in keys)]
        first, role = keys[0], path.split(".")[0] if path.count(".") > 1 else ""
        sliders[path] = {
            "label": f"{first['label']}, to the {role}" if role else first["label"],
            "about": first["about"], "unit": printed_unit(first["unit"]), "value": first["value"],
            "low": low, "high": high, "choices": choices,
            "step": choices[0] if choices else slider_step(low, high),
        }  # fmt: skip
    return sliders


def _bundles(found: LiveCases) -> dict[str, Any]:
    """All bundles as data: what they share once, the rest as one compressed block."""
    first, modules, own = next(iter(found.bundles.values())), dict[str, str](), dict[str, Any]()
    for case, made in found.bundles.items():
        modules |= made["modules"]
        kept = {k: v for k, v in made.items() if k not in (*_SHARED, "modules", "fixed")}
        own[case.name] = {"bundle": kept, "moves": found.moves[case]}
    shared = {name: first[name] for name in _SHARED}
    return {"shared": shared, "modules": modules, "cases": packed(json.dumps(own).encode())}


# ---- what a page shows ---------------------------------------------------------------------------


def section(comparison: Comparison, live: LiveCases, again: str) -> str:
    """The part of the page; `again`: the command that repeats the comparison."""
    c = comparison
    shown = [(x, unit) for x, unit in columns(c) if _computed(x)]
    facts: dict[str, Any] = {
        "command": again,
        "laws": live.sliders,
        "operators": list(c.chosen.operators),
        "columns": [{"name": x.name, "part": x.part, "unit": unit, "margin": _is_margin(x)}
                    for x, unit in shown],
        "operator_columns": {
            name: [x.name for x, _ in shown if x.applies(c.variants.operators[name])]
            for name in c.chosen.operators
        },
        "recorded": [
            _recorded(o, shown) for o in c.outcomes if o.case in live.bundles
        ],
        "page": _judged(c, live, shown),
    }  # fmt: skip
    heads = "".join(f'<th class="number">{escape(header(x, unit))}</th>' for x, unit in shown)
    others = [x.label for x, _ in columns(c) if not _computed(x)]
    above = f" Only in the tables below: {', '.join(others)}." if others else ""
    seeds = f" All runs have the seed {c.base.seed}." if len(c.seeds) > 1 else ""
    return f"""<section id="live" aria-labelledby="live-title" hidden><style>{asset("live.css")}
</style><h2 id="live-title">Try other networks</h2>
<p>Move a value of the links: this page runs all chosen controllers again, with the bits of
<code>cosim compare</code>.{seeds}{escape(above)}</p>
<p class="choices" id="live-choices"></p><div id="live-values"></div>
<p class="choices" id="live-controllers"></p>
<p><button id="live-reset">Reset</button> <output id="live-said" role="status"></output></p>
<div class="scroll"><table id="live-table"><thead><tr><th class="name">controller</th>
<th>survives?</th><th>curves</th>{heads}</tr></thead><tbody></tbody></table></div>
<p>The same runs by the command line:</p>{command("live-command", again)}
{folded("SHA-256 of the signals of each run", '<dl id="live-digests"></dl>')}
{_missing(live)}</section>{scripts(facts, _bundles(live), "compare_worker", "compare")}"""


def _missing(live: LiveCases) -> str:
    """The cases that the page cannot compute, with the reason of each."""
    links: dict[tuple[str, str], dict[str, None]] = {}
    for case, why in live.reasons.items():
        links.setdefault((case.controller, why), {})[case.link] = None
    alike: dict[tuple[str, str], list[str]] = {}
    for (controller, why), found in links.items():
        alike.setdefault((", ".join(found), why), []).append(controller)
    lines = [(", ".join(names), found, why) for (found, why), names in alike.items()]
    shown = table(["controller", "link", "reason"], lines)
    return folded("What cannot be run here, and why", shown) if lines else ""


def _is_margin(column: MetricColumn) -> bool:
    return isinstance(column.metric, RequirementMargin)


def _computed(column: MetricColumn) -> bool:
    """True if a page computes the column."""
    return not isinstance(column.metric, AlignedError | PortMeasure)


def _recorded(o: CaseOutcome, shown: Sequence[tuple[MetricColumn, str]]) -> dict[str, Any]:
    """The row of a case as it was recorded."""
    cells = [
        format_number(*o.numbers[x.name]) if x.name in o.numbers and o.verdict.ended else NOTHING
        for x, _ in shown
    ]
    missed = [
        x.metric.name
        for x, _ in shown
        if isinstance(x.metric, RequirementMargin) and o.numbers.get(x.name, (0.0, ""))[0] < 0
    ]
    stable = o.verdict.stable and not missed
    text = f"no: {missed[0]} violated" if missed and o.verdict.stable else o.verdict.text
    return {
        "name": o.case.name, "link": o.case.link, "operator": o.case.operator,
        "controller": o.case.controller, "cells": cells, "survives": stable, "text": text,
        "digest": o.digest,
        "curves": [
            {"t": _short(curve.t), "y": _short(curve.y)} for curve in o.curves if len(curve.t)
        ],
    }  # fmt: skip


def _short(values: Any) -> list[float | None]:
    step = max(1, len(values) // 60)
    return [float(f"{x:.4g}") if abs(x) < 1e6 else None for x in values[::step].tolist()]


def _judged(
    c: Comparison, live: LiveCases, shown: Sequence[tuple[MetricColumn, str]]
) -> dict[str, Any]:
    """The rules by which a page judges a run: columns, requirements, criteria of rest."""
    made = next(iter(live.bundles.values()))
    s = c.variants.stability
    entries = {signal["name"]: signal["names"] for signal in made["signals"]}
    units = {name: signal["unit"] for signal in made["signals"] for name in signal["names"]}
    return {
        "judged": {
            "end": made["start"] + made["ticks"] * made["h"],
            "entries": entries,
            "metrics": list(_metrics(shown)),
            "require": [],
        },
        "required": [
            {"metrics": [metric_data(m, "1") for m in one.metrics],
             "require": [requirement_data(one)]}
            for x, _ in shown
            if isinstance(x.metric, RequirementMargin)
            for one in requirements(build(x.metric.document, x.metric.path), units)
        ],
        "stable": {
            "position": list(s.position), "velocity": list(s.velocity), "window": s.window,
            "position_limit": s.position_limit, "velocity_limit": s.velocity_limit,
            "rest": s.rest,
        },
        "curves": list(c.variants.picture.y),
        "reference": list(c.variants.picture.reference),
        "until": min(c.variants.picture.until, made["start"] + made["ticks"] * made["h"]),
    }  # fmt: skip


def _metrics(shown: Sequence[tuple[MetricColumn, str]]) -> Iterator[dict[str, Any]]:
    for x, unit in shown:
        if not isinstance(x.metric, AlignedError | PortMeasure | RequirementMargin):
            yield metric_data(x.metric, unit)
