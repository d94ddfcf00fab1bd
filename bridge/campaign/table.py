"""The table of a large campaign: faults by kind and channel, and results of the runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bridge.campaign.judgement import markdown as table
from bridge.campaign.soak_table import facts, failures, inconclusive
from bridge.results.symptoms import SIGNS
from cosim.study.table import column

Record = Mapping[str, Any]
WHATS = ("injected", "seen", "idle", "unseen")


def kinds(records: Sequence[Record]) -> list[list[str]]:
    """A row a kind: for each channel injected, seen, with nothing to act on, unseen; and in all."""
    channels = sorted({str(r["channel"]) for r in records if r.get("channel")})
    rows = [["fault", *channels, "all", "in processes"]]
    sums = np.zeros((len(channels) + 2, 4), np.int64)
    for kind in SIGNS:
        counts = [_counts(_of(records, "channel", c), kind) for c in channels]
        every = [*counts, _counts(records, kind), _counts(_of(records, "how", "rehearsed"), kind)]
        if every[-2][0]:
            rows.append([kind, *map(_cell, every)])
            sums += np.array(every)
    return [*rows, ["all", *map(_cell, sums.tolist())]]


def markdown(records: Sequence[Record], title: str) -> str:
    """All of it as a page."""
    parts = [
        f"# {title}\n",
        "Of each kind and channel: injected / seen / nothing to act on / unseen.\n",
        table(kinds(records)),
        table([["", ""], *facts(records)]),
    ]
    for name, lines in (("Failed", failures(records)), ("Inconclusive", inconclusive(records))):
        if lines:
            parts.append(f"{name}:\n\n" + "".join(f"* {line}\n" for line in lines))
    return "\n".join(parts)


def _of(records: Sequence[Record], key: str, value: str) -> list[Record]:
    return [r for r in records if r.get(key) == value]


def _counts(records: Sequence[Record], kind: str) -> list[int]:
    return [int(np.nansum(column(records, f"{kind}.{what}"))) if records else 0 for what in WHATS]


def _cell(counts: Sequence[int]) -> str:
    return " / ".join(map(str, counts)) if counts[0] else ""
