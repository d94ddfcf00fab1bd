"""``report.html`` of a campaign or a soak test: its runs, its faults, and what was wrong."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bridge.campaign.judgement import JudgedRun, table
from bridge.campaign.table import facts
from bridge.results.verdict import Word
from cosim.reporting import html
from cosim.reporting.html import Badge, PageData, cards, command, write_page

PAGE = "report.html"
Record = Mapping[str, Any]


def write_campaign(
    judged: Sequence[tuple[str, JudgedRun]], title: str, folder: Path, repeat: str
) -> Path:
    """Write the report of a campaign: (folder of the run in `folder`, its judgement) for each.

    `repeat`: the command that made it. Raises CosimError if it cannot be written.
    """
    wrong = [name for name, run in judged if run.failures]
    badge = Badge("failed" if wrong or not judged else "passed", _said(len(judged), wrong))
    head, *rows = table([run for _, run in judged])
    named = [[name, *row[1:]] for (name, _), row in zip(judged, rows, strict=True)]
    links = {name: f"{name}/{PAGE}" for name, _ in judged if (folder / name / PAGE).is_file()}
    rest = f"<h2>Runs</h2>{html.table(head, named, links=links)}{_again(repeat)}"
    torque = max((run.torque for _, run in judged), default=0.0)
    numbers = [
        ("runs", str(len(judged))),
        ("frames corrupted", str(sum(run.corrupted for _, run in judged))),
        ("of these accepted", str(sum(run.undetected for _, run in judged))),
        ("greatest torque", f"{torque:.0%} of its limit"),
    ]
    summary = cards(numbers)
    return write_page(folder / PAGE, title, folder.name, badge, summary, PageData(0.0), rest)


def write_many(
    records: Sequence[Record], kinds: Sequence[Sequence[str]], title: str, folder: Path, repeat: str
) -> Path:
    """Write the report of many runs with random faults.

    `kinds`: the table of the faults, its heading first; `repeat`: the command. Raises CosimError if
    it cannot be written.
    """
    words = Counter(str(r["verdict"]) for r in records)
    wrong = [str(r["run"]) for r in records if r["verdict"] not in (Word.PASSED, Word.INCONCLUSIVE)]
    word = Word.FAILED if wrong else Word.PASSED if words[Word.PASSED] else Word.INCONCLUSIVE
    badge = Badge(word.value, _said(len(records), wrong))
    head, *rows = kinds
    runs = [
        (str(r["run"]), str(r["verdict"]), str(r.get("faults", "")), str(r["reason"]))
        for r in sorted(records, key=lambda r: (r["verdict"] == Word.PASSED, r["run"]))
    ]
    found = html.table(["run", "verdict", "faults", "why"], runs, links=_kept(folder, records))
    rest = (
        f"<h2>Faults</h2>{html.table(head, rows)}"
        f"<h2>All runs together</h2>{html.table(['', ''], facts(records), 1)}"
        f"<h2>Runs</h2>{found}{_again(repeat)}"
    )
    numbers = [(word.value, str(words[word.value])) for word in Word if words[word.value]]
    summary = cards(numbers)
    return write_page(folder / PAGE, title, folder.name, badge, summary, PageData(0.0), rest)


def campaign_as_data(judged: Sequence[tuple[str, JudgedRun]], folder: Path) -> dict[str, Any]:
    """The runs of a campaign as plain data; `torque`: the greatest share of its limit."""
    runs = [
        {
            "name": name, "passed": not run.failures, "failures": list(run.failures),
            "corrupted": run.corrupted, "accepted": run.undetected, "torque": run.torque,
            "replay_exact": run.exact, "ended": dict(run.ended),
        }
        for name, run in judged
    ]  # fmt: skip
    return {"folder": str(folder), "runs": runs}


def many_as_data(records: Sequence[Record], folder: Path) -> dict[str, Any]:
    """The runs of a soak test or a campaign of many faults as plain data."""
    keys = ("run", "verdict", "faults", "reason")
    return {"folder": str(folder), "runs": [{k: r.get(k, "") for k in keys} for r in records]}


def _said(count: int, wrong: Sequence[str]) -> str:
    if not wrong:
        return f"all {count} runs were as expected" if count else "no run"
    named = ", ".join(wrong[:8]) + (", …" if len(wrong) > 8 else "")
    return f"{len(wrong)} of {count} runs were not as expected: {named}"


def _again(repeat: str) -> str:
    return f"<h2>Repeat it</h2>{command('repeat', repeat)}"


def _kept(folder: Path, records: Sequence[Record]) -> dict[str, str]:
    """Folders of the runs that were kept."""
    names = (str(r["run"]) for r in records)
    return {name: f"runs/{name}/" for name in names if (folder / "runs" / name).is_dir()}
