"""The table of a soak: faults by kind, and what of them the reports have shown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bridge.results.symptoms import SIGNS
from bridge.results.verdict import Word
from cosim.study.table import column

Record = Mapping[str, Any]


def kinds(records: Sequence[Record]) -> list[list[str]]:
    """Rows of text, the heading first: how often a kind was injected, seen, idle, unseen."""
    rows = [["fault", "injected", "seen", "nothing to act on", "unseen", "seen by"]]
    total = np.zeros(4, dtype=np.int64)
    for kind, signs in SIGNS.items():
        whats = ("injected", "seen", "idle", "unseen")
        numbers = np.array([_sum(records, f"{kind}.{what}") for what in whats], dtype=np.int64)
        if numbers[0]:
            rows.append([kind, *map(str, numbers), ", ".join(signs)])
            total += numbers
    return [*rows, ["all", *map(str, total), ""]]


def facts(records: Sequence[Record]) -> list[list[str]]:
    """(what, how much) of all runs."""
    hours = _sum(records, "s") / 3600.0
    slots = _sum(records, "slots")
    words = [str(r["verdict"]) for r in records]
    stopped = int((column(records, "stopped") > 0).sum())
    apart = np.nan_to_num(column(records, "together"))
    at_rest = apart[~(column(records, "stopped") > 0)]
    return [
        ["runs", f"{len(records)}, {hours:.2f} h"],
        *[[word, str(words.count(word))] for word in Word],
        ["crashes", f"{_sum(records, 'crashes'):.0f}"],
        ["lives of nodes", f"{_sum(records, 'lives'):.0f}"],
        ["runs with a node that stopped", str(stopped)],
        ["frames corrupted", f"{_sum(records, 'corrupted'):.0f}"],
        ["of these accepted", f"{_sum(records, 'accepted'):.0f}"],
        ["greatest torque", f"{_max(records, 'torque'):.1f} N.m"],
        ["furthest apart at the end", f"{at_rest.max(initial=0.0):.2g}"],
        ["slots", f"{slots:.0f}"],
        ["missed by a period or more", f"{_sum(records, 'missed') / max(slots, 1):.2%}"],
    ]


def failures(records: Sequence[Record]) -> list[str]:
    """A line a run that has failed, or came to nothing."""
    return [
        f"{r['run']} ({r['faults']}): {r['verdict']}: {r['reason']}"
        for r in records
        if r["verdict"] not in (Word.PASSED, Word.INCONCLUSIVE)
    ]


def inconclusive(records: Sequence[Record]) -> list[str]:
    """One line for each run that could not be evaluated because this machine was too slow."""
    return [
        f"{r['run']} ({r['faults']}): {r['reason']}"
        for r in records
        if r["verdict"] == Word.INCONCLUSIVE
    ]


def markdown(records: Sequence[Record], title: str) -> str:
    """All of it as a page."""
    from bridge.campaign.judgement import markdown as table

    parts = [f"# {title}\n", table([["", ""], *facts(records)]), table(kinds(records))]
    wrong = failures(records)
    parts += (
        ["Not as they had to be:\n\n" + "".join(f"* {line}\n" for line in wrong)] if wrong else []
    )
    return "\n".join(parts)


def _sum(records: Sequence[Record], name: str) -> float:
    return float(np.nansum(column(records, name)))


def _max(records: Sequence[Record], name: str) -> float:
    values = column(records, name)
    return float(np.nanmax(values)) if np.isfinite(values).any() else 0.0
