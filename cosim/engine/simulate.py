"""Runs a scenario offline into a run folder: plan -> engine -> recorder, in chunks of ticks."""

from __future__ import annotations

import platform
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

import cosim
from cosim.base.clock import stopwatch
from cosim.base.convert import Struct
from cosim.base.copies import asdict, replace
from cosim.base.errors import Interrupted, RunError, ScenarioError
from cosim.base.interrupts import stop_on_signal
from cosim.base.names import unknown
from cosim.engine.binding import Termination
from cosim.engine.engine import Engine
from cosim.engine.tables import Aside, LinkRows
from cosim.fmi import components
from cosim.links.storage import TableWriter
from cosim.links.table import Ages, LinkStatistics
from cosim.record import (
    Column,
    Recorder,
    claim_folder,
    held_folder,
    link_file,
    seal,
    write_metadata,
)
from cosim.record.folder import FINISHED, FMU_LOG, LAST, RUNNING, STOPPED, is_unfinished
from cosim.record.link_tables import MANY, TablesWriter
from cosim.scenario.assemble import assemble
from cosim.scenario.connect import part
from cosim.scenario.exposed import is_pattern, matching
from cosim.scenario.spec import Scenario, as_data
from cosim.schedule.parts import Slot
from cosim.schedule.plan import Plan

#: Ticks in a chunk at the most, and signals a chunk may hold: it should stay in the cache.
CHUNK_TICKS, CHUNK_VALUES = 16384, 1 << 17
#: Ticks that are kept when a run fails: of everything, or of what is recorded if there are more
#: signals than this, since copying them all would cost as much as the run.
FLIGHT_RECORDER, EVERYTHING = 1000, 8192


class Keeper(Protocol):
    """Keeps the state of a run at some ticks, so that it can be resumed (``cosim.checkpoint``)."""

    def check(self, engine: Engine, facts: Mapping[str, Any]) -> None:
        """Raise ScenarioError if the run cannot be kept, or is not the one that is resumed.

        Nothing has been written yet. `facts`: the entries of ``run.json``.
        """

    def prepare(self, folder: Path) -> bool:
        """Make the folder ready, which no other run uses; true: it has the run that is resumed.

        Raises RunError.
        """

    def begin(self, engine: Engine, recorder: Recorder) -> None:
        """Bring the run to the tick at which it is resumed, if it is; keep the state.

        Raises RunError, ScenarioError.
        """

    def ahead(self, tick: int) -> int:
        """The ticks from `tick` on that a chunk may have, 1 or more."""

    def keep(self, engine: Engine, recorder: Recorder, *, now: bool) -> None:
        """Keep the state between two chunks, if it is time or with `now`. Raises RunError."""

    @property
    def before(self) -> float:
        """The wall time of earlier parts of the run, s."""


class Execution(Struct, frozen=True):
    """The way to run: by how many `threads`, with the same results, and what keeps its state."""

    threads: int = 1
    keeper: Keeper | None = None


_USUAL = Execution()


class RunOutcome(Struct, frozen=True):
    """The outcome of a run: `wall` s for `seconds` s of simulated time, recorded in `folder`.

    `shared`: whether threads shared its ticks.
    """

    folder: Path
    plan: Plan
    ticks: int
    seconds: float
    wall: float
    ages: Mapping[str, LinkStatistics]
    late_clock_ticks: Mapping[
        str, tuple[int, float]
    ]  # clocks of FMUs: how often, and by how much (s)
    ended: Termination | None = None  # by an FMU, before its time
    shared: bool = False
    macro_steps: Sequence[Mapping[str, Any]] = ()  # what each group with macro steps has done


def columns(plan: Plan, wanted: Sequence[str] = (), place: str = "") -> list[Column]:
    """The recorded columns: all outputs, everything received over links, and inputs that tables or
    events change; or what is `wanted`.

    Raises ScenarioError for a wanted signal that does not exist.
    """
    return _columns(recorded_slots(plan, wanted, place))


def recorded_slots(plan: Plan, wanted: Sequence[str] = (), place: str = "") -> list[Slot]:
    """The signals of :func:`columns`. Raises ScenarioError."""
    slots = {s.name: s for c in plan.components for s in c.outputs}
    every = plan.slots()
    received = {x.target.name for x in plan.links}
    changed = [p.target for p in plan.players if "from" in p.source.facts()]
    received |= {f"{x.component}.{x.port}" for x in (*(x.target for x in plan.links), *changed)}
    slots |= {name: s for name, s in every.items() if name in received}
    slots |= {s.name: s for group in plan.groups for s in group.slots}
    if wanted:
        slots = {s.name: s for w in wanted for s in _named(w, every, place)}
        whole = {name for name in slots if name in every}
        parts = {name for name, s in slots.items() if f"{s.component}.{s.port}" in whole - {name}}
        slots = {name: s for name, s in slots.items() if name not in parts}
    return [slot for _, slot in sorted(slots.items())]


def _named(wanted: str, every: Mapping[str, Slot], place: str) -> Sequence[Slot]:
    """The signals, or entries of them, that an entry of ``record.signals`` names."""
    if wanted in every:
        return [every[wanted]]
    if is_pattern(wanted) and (found := matching(wanted, every)):
        return [every[name] for name in found]
    entries = {name: s for s in every.values() if s.shape for name in s.scalars()}
    names = matching(wanted, entries) if is_pattern(wanted) else [wanted] * (wanted in entries)
    if not names:
        raise ScenarioError(unknown(wanted, every, "signal"), place)
    return [part(entries[n], n[len(entries[n].name) + 1 : -1], place) for n in names]


def _columns(slots: Sequence[Slot]) -> list[Column]:
    return [
        Column(name, slot.unit_of(i), slot.start + i)
        for slot in slots
        for i, name in enumerate(slot.scalars())
    ]


def simulate(
    scenario: Scenario,
    folder: str | Path,
    progress: Callable[[int, int], None] = lambda done, all_: None,
    plan: Plan | None = None,
    *,
    force: bool = False,
    further: Mapping[str, Any] | None = None,
    execution: Execution = _USUAL,
) -> RunOutcome:
    """Run a scenario from start to stop, recording into `folder` (see :func:`claim_folder`).

    The folder is made once all components have started: what cannot start leaves nothing behind.
    From then on it can be read at any moment, also after the process was killed. `progress` is
    called with (ticks done, ticks in all) between chunks; `further`: more entries of ``run.json``.
    Raises CosimError; a RunError leaves in the
    folder what was recorded, and the last ticks of every signal (of those recorded, if there are
    more than :data:`EVERYTHING`). Ctrl-C (and the engine's `stop`) becomes Interrupted, and leaves
    what was recorded.
    """
    called, folder = Path(folder), Path(folder).absolute()  # an FMU may change the directory
    plan = plan or assemble(scenario)
    recorded = columns(plan, scenario.run.record.signals, scenario.place("run.record.signals"))
    if scenario.run.record.events:
        from cosim.engine.event_times import check_events

        check_events(plan, scenario.place("run.record.events"))
    slots = [s for c in plan.components for s in (*c.inputs, *c.outputs)]
    slots += [s for group in plan.groups for s in group.slots]
    taken: Sequence[int] | None = None  # the signals in a row, if not all
    if sum(slot.size for slot in slots) > EVERYTHING:
        taken = [column.index for column in recorded]
        recorded = [replace(column, index=i) for i, column in enumerate(recorded)]
    everything = _columns(slots) if taken is None else recorded
    width = plan.n_signals if taken is None else len(taken)
    every = 1 if taken is None else scenario.run.record.every
    rows = max(64, min(CHUNK_TICKS, CHUNK_VALUES // max(1, width), plan.ticks + 2))
    ages = _ages(plan)
    takers: list[Callable[[LinkRows], None]] = [lambda found: ages.add(found.rows, found.counts)]
    aside: Aside[None] = Aside("link tables, kept")

    def keep(found: LinkRows) -> None:
        aside.result()
        work = partial(_hand_over, takers, found)
        if len(plan.links) >= MANY:
            aside.start(work)
        else:
            work()

    with ExitStack() as stack:
        engine = stack.enter_context(
            Engine(plan, keep, threads=execution.threads, columns=taken, every=every)
        )
        engine.initialize()
        facts = {**metadata(scenario, plan), **(further or {})}
        keeper = execution.keeper
        if keeper is not None:
            keeper.check(engine, facts)
        stack.enter_context(stop_on_signal(engine.stop))  # what is opened from here on is closed
        stack.enter_context(held_folder(folder))
        resumed = keeper is not None and keeper.prepare(folder)
        claim_folder(folder, force=force or resumed, resumed=resumed)
        events = None
        if scenario.run.record.events:
            from cosim.engine.event_times import EventTimes  # few runs ask for it

            events = EventTimes(engine)
            stack.callback(events.write, folder)
        stack.enter_context(_completed(folder, facts))
        stack.callback(_save_logs, engine, folder)
        takers.append(_table_writer(folder, plan, facts["links"], stack))
        stack.callback(aside.result)  # before the tables are closed
        recorder = Recorder(
            folder, recorded, h=plan.h, start=plan.start, every=scenario.run.record.every,
            rows_per_chunk=rows, n_signals=width, everything=everything, sparse=taken is not None,
            ticks=plan.ticks,
        )  # fmt: skip
        stack.enter_context(recorder)
        watch = stopwatch()
        try:
            if keeper is not None:
                keeper.begin(engine, recorder)
            _loop(engine, recorder, rows, taken, keeper, sparse=every > 1, progress=progress)
        except BaseException as error:
            _save_failure(error, recorder, everything, folder)
            if isinstance(error, RunError | Interrupted):
                error.saved = str(called)
            facts |= _macro_facts(engine)
            raise
        recorder.close()
        aside.result()
        wall = watch()
        if keeper is not None:
            wall += keeper.before
        late, shared = engine.late_clock_ticks(), engine.shares
        facts |= {} if events is None else {"events": events.counts()}
        facts |= _macro_facts(engine) | {
            "status": FINISHED,
            "wall": wall,
            "texts": engine.texts(),
            "late_clocks": late,
            "ended": None if engine.ended is None else asdict(engine.ended),
        }
    statistics = dict(zip([x.name for x in plan.links], ages.results(), strict=True))
    return RunOutcome(
        called, plan, engine.tick, plan.time(engine.tick), wall, statistics, late, engine.ended,
        shared, facts.get("macro_steps", ()),
    )  # fmt: skip


def _macro_facts(engine: Engine) -> dict[str, Any]:
    found = engine.macro_steps()
    return {"macro_steps": found} if found else {}


def _table_writer(
    folder: Path, plan: Plan, facts: Mapping[str, Mapping[str, Any]], stack: ExitStack
) -> Callable[[LinkRows], None]:
    """The writer of the rows of the links' tables: into a file for each, or one for many links."""
    if len(plan.links) >= MANY and not plan.buses:
        together = stack.enter_context(TablesWriter(folder, facts))
        return lambda found: together.write(found.rows, found.counts)
    files = [
        stack.enter_context(TableWriter(link_file(folder, name), text))
        for name, text in facts.items()
    ]

    def write(found: LinkRows) -> None:
        for file, rows in zip(files, found.parts(), strict=True):
            file.write(rows)

    return write


def _ages(plan: Plan) -> Ages:
    """The counter of the ages of all links."""
    longer = {name: n for bus in plan.buses for name, n in bus.history.items()}
    histories = [longer.get(x.name, x.table.history) for x in plan.links]
    return Ages([x.table.grid for x in plan.links], histories)


def _hand_over(takers: Sequence[Callable[[LinkRows], None]], found: LinkRows) -> None:
    for take in takers:
        take(found)


def _loop(
    engine: Engine,
    recorder: Recorder,
    rows: int,
    taken: Sequence[int] | None,
    keeper: Keeper | None,
    *,
    sparse: bool,
    progress: Callable[[int, int], None],
) -> None:
    plan = engine.plan
    while True:
        first = engine.tick
        ticks = min(rows - 1, plan.ticks - first)
        if keeper is not None:
            ticks = min(ticks, keeper.ahead(first))
        buffer = recorder.buffer()
        failed = True
        try:
            engine.run(ticks, buffer, recorder.begin(buffer, first))
            failed = False
        finally:
            n = engine.rows
            done = engine.tick == plan.ticks or engine.ended is not None
            early = failed or engine.ended is not None
            last = failed or (done and n == engine.tick - first)
            last &= not (sparse and early)  # other parts may be ahead, and no row says of what
            if last:  # as everything stands
                buffer[n] = engine.signals if taken is None else engine.signals[taken]
                n += 1
            recorder.submit(buffer, first, n, last=last)
        stopped = engine.tick < first + ticks and not done
        if keeper is not None and not done:
            keeper.keep(engine, recorder, now=stopped)
        if stopped:
            raise Interrupted(plan.time(engine.tick), str(recorder.path.parent))
        progress(engine.tick, plan.ticks)
        if done:
            return


@contextmanager
def _completed(folder: Path, facts: dict[str, Any]) -> Iterator[None]:
    """Write ``run.json`` before the block and after it, which adds to `facts`; then the sums."""
    write_metadata(folder, facts, indented=False)
    try:
        yield
    except BaseException as error:
        try:
            write_metadata(folder, facts | stop_metadata(error))
            if not is_unfinished(folder):
                seal(folder)
        except RunError as failure:  # what stopped the run comes first
            error.add_note(str(failure))
        raise
    write_metadata(folder, facts)
    seal(folder)


def _save_logs(engine: Engine, folder: Path) -> None:
    """Write what FMUs with logging enabled logged so far, and the logs of buses between FMUs."""
    for name, text in engine.logs().items():
        (folder / f"{name}{FMU_LOG}").write_text(text, encoding="utf-8")
    for step in engine.plan.components:
        for name, text in components.files(step.component).items():
            (folder / name).write_text(text, encoding="utf-8")


def _save_failure(
    error: BaseException, recorder: Recorder, everything: Sequence[Column], folder: Path
) -> None:
    """Keep the last ticks of every signal; their last row is what the failure left behind."""
    if isinstance(error, RunError):
        try:
            recorder.save_last(folder / LAST, FLIGHT_RECORDER, everything)
        except RunError as failure:  # what stopped the run comes first
            error.add_note(str(failure))


def stop_metadata(error: BaseException) -> dict[str, Any]:
    """The entries of ``run.json`` for a run that had to stop."""
    return {"status": STOPPED, "error": f"{type(error).__name__}: {error}"}


def metadata(scenario: Scenario, plan: Plan) -> dict[str, Any]:
    """The entries of ``run.json`` at the start: scenario, seeds, versions, hashes, links."""
    files = {path: total for c in plan.components for path, total in c.files.items()}
    simulators = {
        c.name: found
        for c in plan.components
        if (found := components.simulator_facts(c.component)) is not None
    }
    return {
        "status": RUNNING,
        "scenario": as_data(scenario),
        "seed": scenario.run.seed,
        "step": plan.h,
        **({"start": plan.start} if plan.start else {}),
        "ticks": plan.ticks,
        "algorithm": plan.algorithm,
        "order": list(plan.later if plan.algorithm == "gauss-seidel" else plan.order),
        "versions": versions(),
        "fmus": {
            c.name: found
            for c in plan.components
            if (found := components.facts(c.component)) is not None
        },
        **({"files": files} if files else {}),
        **({"simulators": simulators} if simulators else {}),
        "weights": {p.target.name: p.source.facts() for p in plan.players},
        "links": {x.name: x.table.facts() for x in plan.links},
        "wall": None,
        "error": None,
    }


def versions() -> dict[str, str]:
    """Versions of what a result depends on."""
    return {
        "cosim": cosim.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "platform": f"{platform.machine()}-{sys.platform}",
    }
