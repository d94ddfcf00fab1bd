"""Runs the cases in parallel processes, evaluates the claims, draws the figures.

What is written, under one folder::

    runs/CASE/           run folder of each case: trajectories, link tables, run.json
    figNN.png, .csv      each figure and its numbers
    claims.json          every claim: expected, measured, passed; seed and versions
    report.html          the claims and the figures as one page
"""

from __future__ import annotations

import gc
import json
import multiprocessing
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import groupby
from math import isfinite
from multiprocessing.context import BaseContext
from pathlib import Path
from typing import Any, TypeAlias

from cosim.base.errors import RunError, ScenarioError
from cosim.base.extras import require
from cosim.engine.simulate import simulate, versions
from cosim.record import Run
from cosim.reporting import html
from cosim.reporting.figures import load
from cosim.reporting.html import Badge, PageData, cards, command, folded, picture, write_page
from cosim.scenario.spec import build
from fmus.paper.claim import ClaimVerdict, Stop, judge
from fmus.paper.claims import ClaimSelection, cases, select
from fmus.paper.experiments import Document
from fmus.paper.figures import PaperFigure, draw_figure, draw_graphs

RESULT, PAGE = "claims.json", "report.html"
#: The graphs of Sec. VII-B that the figures show.
PRESET = "ring"

Row: TypeAlias = dict[str, Any]
Submit: TypeAlias = Callable[..., "Future[Any]"]


def listing(wanted: Sequence[str] = ()) -> list[Row]:
    """The claims about `wanted` as rows, nothing measured. Raises ScenarioError."""
    return [
        {"section": title, **claim.as_data()}
        for title, claims in select(wanted).sections.items()
        for claim in claims
    ]


def reproduce(
    folder: Path,
    wanted: Sequence[str] = (),
    *,
    seed: int = 0,
    jobs: int = 2,
    force: bool = False,
    progress: Callable[[int, int], None] = lambda done, all_: None,
) -> list[Row]:
    """Reproduce what is about `wanted` (default all) into `folder`; the rows of the table.

    `progress` is called with (done, all) runs and figures. Raises ScenarioError for what is not
    known, for a folder that holds something (with `force`: something else), and without matplotlib
    for figures; RunError where a run cannot start.
    """
    chosen = select(wanted)
    if chosen.figures or chosen.graphs:
        require("matplotlib")
    documents = {name: d for name, d in cases(seed).items() if name in chosen.cases}
    _claim(folder, force)
    with _workers(jobs) as submit:
        done = _Counter(progress, len(documents) + len(chosen.figures) + chosen.graphs)
        verdicts = _evaluate(chosen, documents, folder, submit, done, force)
    rows = [
        {"section": title, **verdicts[claim.name].as_data()}
        for title, claims in chosen.sections.items()
        for claim in claims
    ]
    _write(folder / RESULT, {"seed": seed, "versions": versions(), "claims": rows})
    return rows


# ---- runs ---------------------------------------------------------------------------------------


def run_case(name: str, document: Document, folder: Path, force: bool = False) -> Stop | None:
    """Run one case into ``folder/name``; a :class:`Stop` if it ended before its time."""
    place = folder / name
    try:
        simulate(build(document, place / "scenario.toml"), place, force=force)
    except RunError as error:
        if not isfinite(error.time):
            raise
        return Stop(error.time, str(error))
    return None


def open_case(name: str, folder: Path, stop: Stop | None) -> Run | Stop:
    """The run, or the stop, that :func:`run_case` left behind."""
    return stop or Run.open(folder / name)


def _evaluate(
    chosen: ClaimSelection,
    documents: Mapping[str, Document],
    folder: Path,
    submit: Submit,
    done: _Counter,
    force: bool,
) -> dict[str, ClaimVerdict]:
    """Run the cases; draw each figure and judge each claim once its cases have run.

    So no process waits for the last case. A case that stopped has no figure, and its claims say
    why.
    """
    runs = folder / "runs"
    drawings = [submit(draw_graphs, PRESET, folder)] if chosen.graphs else []
    found: dict[str, Run | Stop] = {}
    verdicts: dict[str, ClaimVerdict] = {}
    for name, result in _run_all(documents, runs, submit, force):
        found[name] = result
        done()
        if isinstance(result, Run):
            about = [figure for figure in chosen.figures if figure.case == name]
            drawings += [submit(_draw, figure, runs, folder) for figure in about]
        for claim in chosen.claims:
            if name in claim.cases and found.keys() >= set(claim.cases):
                verdicts[claim.name] = judge(claim, found)
    for drawing in as_completed(drawings):
        drawing.result()
        done()
    return verdicts


def _run_all(
    documents: Mapping[str, Document], folder: Path, submit: Submit, force: bool
) -> Iterator[tuple[str, Run | Stop]]:
    """Each case with what its run left, in the order of their ends; the long ones start first."""
    order = sorted(documents, key=lambda name: -_cost(documents[name]))
    waiting = {submit(run_case, name, documents[name], folder, force): name for name in order}
    for future in as_completed(waiting):
        name = waiting[future]
        yield name, open_case(name, folder, future.result())


def _cost(document: Document) -> float:
    """Component steps of a run."""
    return float(len(document["components"]) * document["run"]["stop"] / document["run"]["step"])


def _draw(figure: PaperFigure, runs: Path, folder: Path) -> Path:
    load(lean=True)
    return draw_figure(figure, Run.open(runs / figure.case), folder)


# ---- the report ---------------------------------------------------------------------------------


def write_report(rows: Sequence[Mapping[str, Any]], folder: Path, repeat: str) -> Path:
    """Write the report of the claims `rows` (as in ``claims.json``) with the figures in `folder`.

    `repeat`: the command that made it. Raises CosimError if it cannot be written.
    """
    failed = [str(row["name"]) for row in rows if not row["passed"]]
    said = f"{len(rows) - len(failed)} of {len(rows)} claims hold"
    badge = Badge("failed" if failed or not rows else "passed", said)
    numbers = [("claims", str(len(rows))), ("hold", str(len(rows) - len(failed)))]
    numbers += [("do not hold", ", ".join(failed))] if failed else []
    sections = "".join(
        folded(title, _claims(list(claims)), opened=True)
        for title, claims in groupby(rows, key=lambda row: str(row["section"]))
    )
    pictures = "".join(picture(path, path.stem) for path in sorted(folder.glob("fig*.png")))
    figures = f'<h2>Figures</h2><div class="charts">{pictures}</div>' if pictures else ""
    rest = f"{figures}<h2>Claims</h2>{sections}<h2>Repeat it</h2>{command('repeat', repeat)}"
    title = "Towards Manipulability of Interactive Lagrangian Systems: reproduction"
    summary = cards(numbers)
    return write_page(folder / PAGE, title, folder.name, badge, summary, PageData(0.0), rest)


def _claims(claims: Sequence[Mapping[str, Any]]) -> str:
    head = ["claim", "holds", "statement", "source", "expected", "measured"]
    rows = [
        [
            str(row["name"]),
            "✓" if row["passed"] else "✗ no",
            f"{row['text']}{' (a hypothesis is broken on purpose)' if row['breaks'] else ''}"
            + (f"; {row['note']}" if row["note"] else ""),
            str(row["source"]),
            f"{row['expected']}{_unit(row)}",
            _measured(row["measured"]),
        ]
        for row in claims
    ]
    links = {str(row["name"]): f"runs/{row['cases'][0]}/" for row in claims if row["cases"]}
    return html.table(head, rows, 2, links)


def _unit(row: Mapping[str, Any]) -> str:
    return "" if row["unit"] == "1" else f" {row['unit']}"


def _measured(value: object) -> str:
    if isinstance(value, float | int):
        return f"{value:.4g}"
    return "nothing" if value is None else "never" if value == "inf" else str(value)


# ---- processes, files ---------------------------------------------------------------------------


class _Counter:
    """Counts what is done and tells `progress`."""

    def __init__(self, progress: Callable[[int, int], None], all_: int) -> None:
        self._progress, self._done, self._all = progress, 0, all_

    def __call__(self) -> None:
        self._done += 1
        self._progress(self._done, self._all)


@contextmanager
def _workers(jobs: int) -> Iterator[Submit]:
    """A function that submits a call: to `jobs` processes, or done at once for one job."""
    if jobs < 2:
        yield _at_once
        return
    pool = ProcessPoolExecutor(jobs, mp_context=_context(), initializer=_prepare)
    try:
        yield pool.submit
    except BrokenProcessPool as error:
        raise RunError(f"a worker process died: {error}") from error
    finally:
        pool.shutdown(cancel_futures=True)


def _context() -> BaseContext:
    """Forked processes, which need not import anything, where this process has one thread."""
    safe = sys.platform == "linux" and threading.active_count() == 1
    return multiprocessing.get_context("fork" if safe else "spawn")


def _prepare() -> None:
    """In each worker: nearly all of its objects stay, so garbage is rarely looked for."""
    gc.set_threshold(50_000)


def _at_once(function: Callable[..., Any], *arguments: Any) -> Future[Any]:
    future: Future[Any] = Future()
    future.set_result(function(*arguments))
    return future


def _claim(folder: Path, force: bool) -> None:
    """Make the folder, or take one that is empty or, with `force`, holds a reproduction."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        present = {path.name for path in folder.iterdir()}
    except OSError as error:
        raise ScenarioError(f"cannot be used: {error.strerror}", str(folder)) from error
    if present and not (force and present & {RESULT, "runs"}):
        expected = "an empty one, or --force to replace a reproduction"
        raise ScenarioError(f"the folder is not empty; expected {expected}", str(folder))


def _write(path: Path, data: Mapping[str, Any]) -> None:
    try:
        path.write_text(json.dumps(data, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror}") from error
