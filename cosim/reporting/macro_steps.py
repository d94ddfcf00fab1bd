"""The work of groups with macro steps (``algorithm = "adaptive"``), as lines and as a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from cosim.base.units import time_text
from cosim.reporting.html import table

#: Components of a group that are named.
NAMED = 4


def macro_lines(groups: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """(what, text) of each group; `groups`: ``macro_steps`` of ``run.json``."""
    found = []
    for group in groups:
        sizes = [row["size"] for row in group["sizes"] if row["accepted"]]
        if not sizes:
            continue
        span = (
            time_text(sizes[0], 3)
            if len(sizes) == 1
            else f"{time_text(min(sizes), 3)} to {time_text(max(sizes), 3)}"
        )
        found.append(
            (
                "macro steps",
                f"{group['accepted']} of {span}, {group['rejected']} repeated  {_names(group)}",
            )
        )
        if group["forced"]:
            found.append(("", _forced(group)))
        found += [
            (
                "coupling energy",
                f"{bond['total']:.3g} J made in all, at most {bond['largest']:.3g} J in a period"
                f"  {bond['name']}",
            )
            for bond in group["bonds"]
        ]
        found += [
            (
                "algebraic loop",
                f"{loop['passes'] / loop['solved']:.3g} passes each time  {_names(loop)}",
            )
            for loop in group["loops"]
            if loop["solved"]
        ]
    return found


def _names(group: Mapping[str, Any]) -> str:
    names = group["components"]
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more


def _forced(group: Mapping[str, Any]) -> str:
    return (
        f"{group['forced']} of the smallest size exceed the tolerance, by a factor of up to "
        f"{group['largest_error']:.3g}, first at {time_text(group['forced_at'], 6)}"
    )


def macro_section(facts: Mapping[str, Any]) -> str:
    """The steps of each group by their sizes, as HTML; "" for a run without any."""
    groups = facts.get("macro_steps") or ()
    head = ["components", "size", "kept", "repeated"]
    rows = [
        (_names(group), time_text(row["size"], 6), str(row["accepted"]), str(row["rejected"]))
        for group in groups
        for row in group["sizes"]
    ]
    said = "".join(
        f"<p>{what}: {text}</p>" for what, text in macro_lines(groups) if what != "macro steps"
    )
    return (
        f"<h2>Macro steps</h2>{table(head, rows, 3)}{said.replace('<p>: ', '<p>')}" if rows else ""
    )
