"""The table of a soak test or of a large campaign: faults by kind, and results of the runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bridge.campaign.judgement import markdown as table
from bridge.results.symptoms import SIGNS
from bridge.results.verdict import Word
from cosim.study.table import column

Record = Mapping[str, Any]
#: Counts of the faults of a kind, with the words of the heading.
COUNTS = {"injected": "injected", "seen": "seen", "idle": "nothing to act on", "unseen": "unseen"}


def kinds(records: Sequence[Record]) -> list[list[str]]:
    """Rows of text, the heading first: the counts of each kind that was injected.

    Runs of several channels have a column for each, with all counts in a cell.
    """
    channels = sorted({str(r["channel"]) for r in records if r.get("channel")})
    groups = [[r for r in records if r.get("channel") == c] for c in channels]
    groups += [list(records), [r for r in records if r.get("how") == "rehearsed"]]
    counts = {kind: np.array([_counts(group, kind) for group in groups]) for kind in SIGNS}
    counts = {kind: found for kind, found in counts.items() if found[-2, 0]}
    counts["all"] = sum(counts.values(), np.zeros((len(groups), len(COUNTS)), np.int64))
    if channels:
        head = ["fault", *channels, "all", "in processes"]
        return [head, *([kind, *map(_cell, found)] for kind, found in counts.items())]
    head = ["fault", *COUNTS.values(), "seen by"]
    return [head, *([k, *map(str, n[-2]), ", ".join(SIGNS.get(k, ()))] for k, n in counts.items())]


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
    parts = [
        f"# {title}\n",
        f"Faults of each kind: {' / '.join(COUNTS.values())}.\n",
        table(kinds(records)),
        table([["", ""], *facts(records)]),
    ]
    for name, lines in (("Failed", failures(records)), ("Inconclusive", inconclusive(records))):
        if lines:
            parts.append(f"{name}:\n\n" + "".join(f"* {line}\n" for line in lines))
    return "\n".join(parts)


def _counts(records: Sequence[Record], kind: str) -> list[int]:
    return [int(_sum(records, f"{kind}.{count}")) if records else 0 for count in COUNTS]


def _cell(counts: Sequence[int]) -> str:
    return " / ".join(map(str, counts)) if counts[0] else ""


def _sum(records: Sequence[Record], name: str) -> float:
    return float(np.nansum(column(records, name)))


def _max(records: Sequence[Record], name: str) -> float:
    values = column(records, name)
    return float(np.nanmax(values)) if np.isfinite(values).any() else 0.0
