"""Executes a plan: native components through their FMI functions, Python ones as call-backs.

The loop itself is ``engine.c``, called in chunks of ticks with the GIL released. What Python does
between chunks: hand over the next rows of the link tables, and a buffer to record into.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.base.component import NativeComponent
from cosim.base.errors import RunError
from cosim.base.files import return_to, working_folder
from cosim.base.interrupts import stop_on_signal, stops_on_signal
from cosim.base.python import without_collections
from cosim.engine.arrays import address_of, in_lines, rows_of
from cosim.engine.binding import Binding, Termination, Vector, Views, part
from cosim.engine.initialization import initialize
from cosim.engine.tables import NEVER, DrawnRows, LinkRows, RowTables, filled_rows
from cosim.fmi import components
from cosim.fmi.failures import not_finite, sentence
from cosim.native import shared, structs
from cosim.native.enums import EngineResult
from cosim.schedule.parts import RunningBus, Slot, Step
from cosim.schedule.plan import Plan

if TYPE_CHECKING:
    from cosim.engine.macro_loops import Feedthrough
    from cosim.engine.macro_steps import MacroBinding
    from cosim.engine.plant_loops import PlantLoop
    from cosim.engine.threads import Team


class Engine:
    """One execution of a plan, from :meth:`initialize` on. Use as a context manager.

    `signals` is the signal vector; `tick` the next tick to run; `loops` those among plants that its
    steps iterate, and `late` the outputs that are half a step old. `keep_tables` is called with the
    next rows of all links' tables as they are used.
    `gates`: (address of the function, of its context) of each gate of the plan, by its name; those
    of the plan's buses come with them. `threads`: how many share the components; the results are
    the same for any number. `columns`: the signals in a recorded row; None: all of them. `every`: a
    row is filled in at ticks k with k mod every = 0 only. `longest`: ticks for which tables are
    drawn at once, at most; 0: as :mod:`cosim.engine.tables` says.
    """

    def __init__(
        self,
        plan: Plan,
        keep_tables: Callable[[LinkRows], None] | None = None,
        gates: Mapping[str, tuple[int, int]] | None = None,
        threads: int = 1,
        columns: Sequence[int] | None = None,
        every: int = 1,
        longest: int = 0,
    ) -> None:
        self.plan, self._threads, self._longest = plan, threads, longest
        self._place = working_folder()
        self.signals: Vector = in_lines(plan.n_signals)
        self.ended: Termination | None = None
        self._keep_tables = keep_tables
        self._inputs = SignalViews(self.signals, [s.inputs for s in plan.components], fixed=True)
        self._outputs = SignalViews(self.signals, [s.outputs for s in plan.components])
        self._team: Team | None = None
        self._macros: MacroBinding | None = None
        self._direct: Feedthrough = {}
        self.loops: Sequence[PlantLoop] = ()
        self.late: Sequence[str] = ()
        self._tables: RowTables | None = None
        self._drawn = _no_rows(0)
        self._buses: dict[str, RunningBus] = {}  # of links whose table the run fills in
        gates = dict(gates or {})
        for bus in plan.buses:
            running = bus.start()
            self._buses |= dict.fromkeys(bus.history, running)
            gates |= running.gates
        self._bound = Binding(
            plan, self.signals, self._inputs, self._outputs, gates, threads, columns
        )
        self._state = self._bound.state
        self._state.every = every
        self._library = shared.library()

    def __enter__(self) -> Engine:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def tick(self) -> int:
        """The next tick to run; after a failure, the tick that failed."""
        return int(self._state.tick)

    def initialize(self, tick: int = 0) -> None:
        """Start all components; initial outputs propagate along wires until nothing changes.

        The signals are then those of `tick`, the next one to run: the outputs of an FMU after
        Initialization Mode, and after the events at the start. At a `tick` other than 0, all
        components must be due; tables start with their first row in any case. Raises ScenarioError.
        """
        with without_collections():
            self._start(tick)
        if self.plan.groups:
            from cosim.engine.macro_steps import MacroBinding

            self._macros = MacroBinding(
                self.plan, self._bound.units, self.signals, self._direct, self._bound.fail
            )
            self._state.macros = c.addressof(self._macros.macros)
        if self._bound.partition is not None:
            from cosim.engine.threads import Team

            self._team = Team(self._bound, self._threads, tick)

    def _start(self, tick: int) -> None:
        self._begin_tables(tick)
        components.share_texts(step.component for step in self.plan.components)
        for step in self.plan.components:
            components.begin_at(step.component, self.plan.time(tick))
        self.ended = initialize(self.plan, self.signals, self._inputs, self._outputs, self._measure)
        self._bound.bind(tick)

    def _begin_tables(self, tick: int) -> None:
        if self._tables:
            self._tables.close()
            self._tables = None
        if self.plan.links or self.plan.players:
            self._tables = RowTables(self.plan, self._buses, self._longest)
        self._drawn = _no_rows(NEVER if self._tables is None else tick)

    @property
    def bound(self) -> Binding:
        """The plan as C runs it."""
        return self._bound

    @property
    def macros(self) -> c.Array[structs.MacroStruct] | None:
        """Its groups with macro steps, if it has any."""
        return None if self._macros is None else self._macros.macros

    def begin_again(self, plan: Plan, signals: Vector | None = None) -> None:
        """Stand at tick 0 of `plan` as a new engine would: see :mod:`cosim.engine.reuse`.

        `signals` (n_signals,): those after the start, if the components have gone back there
        already; None: they start here. Raises ScenarioError, RunError.
        """
        self.plan, self.ended = plan, None
        self._begin_tables(0)
        if signals is None:
            self.signals[:] = 0.0
            self.ended = initialize(plan, self.signals, self._inputs, self._outputs, self._look)
        else:
            self.signals[:] = signals
        from cosim.engine.reset import rewind

        rewind(self._bound, plan)

    def _look(self) -> None:
        """Find loops among plants, while all are in their initial states; refuse what diverges."""
        from cosim.engine.plant_loops import late_outputs, plant_loops

        self.loops = plant_loops(self.plan, self.signals, self._inputs)
        if any(step.extrapolate for step in self.plan.components):
            self.late = late_outputs(self.plan, self._inputs)

    def _measure(self) -> None:
        """Find what must be known of outputs with direct feed-through, at the start."""
        self._look()
        if self.plan.groups:
            from cosim.engine.macro_steps import measure

            self._direct = measure(self.plan, self._inputs)

    # ---- running -----------------------------------------------------------------------------

    def run(self, ticks: int, record: Vector | None = None, recorded: int = 0) -> int:
        """Run `ticks` ticks, recording one row per tick into `record` (rows, columns).

        `recorded`: address of an int64 that counts these rows during the run; 0: none. Returns the
        number of rows written. If an FMU ends the simulation, the run stops there, and
        :attr:`ended` is set; nothing can be run after that. Raises RunError if a component fails or
        returns a value that is not finite, and KeyboardInterrupt after the tick in which Ctrl-C was
        pressed; the rows recorded until then are in `record`.
        """
        if self.ended is not None:
            ticks = 0
        self.record_into(record, recorded)
        if stops_on_signal(self.stop):
            result = self._run(self.tick + ticks)
        else:
            with stop_on_signal(self.stop):
                result = self._run(self.tick + ticks)
        error = None if result is EngineResult.OK else self.finish(result)
        if error is not None or self.tick >= self.plan.ticks:
            return_to(self._place)
        if error is not None:
            raise error
        return self.rows

    def record_into(self, record: Vector | None, recorded: int = 0) -> None:
        """Let the next rows go to `record` (rows, columns) from its start on; see :meth:`run`."""
        self._state.row = 0  # before anything can interrupt: `rows` is then about this run
        self._state.record = None if record is None else address_of(record)
        self._state.recorded = recorded or None

    def finish(self, result: int) -> BaseException | None:
        """Take a result of ``engine_run``: :attr:`ended` is set, or the error is returned."""
        if result in (EngineResult.OK, EngineResult.STOPPED):
            return None
        self.ended = self.end(result)
        return self._error(EngineResult(result)) if self.ended is None else None

    def _run(self, end: int) -> EngineResult:
        """Run up to the tick `end`, as far as tables reach at a time."""
        state, team = c.byref(self._state), self._team
        while True:
            ticks = end - self.tick
            if self._drawn.end < end:
                ticks = self._next_tables(ticks)
            if team and team.window:
                with team:
                    result = self._library.engine_run(state, ticks)
            else:
                result = self._library.engine_run(state, ticks)
            if self._drawn.filled:
                self._keep_filled_tables()
            if result or self.tick >= end:
                return EngineResult(result) if result else EngineResult.OK

    @property
    def shares(self) -> bool:
        """True if threads share the components, as far as it is known now."""
        return self._threads > 1 and self._team is not None and self._team.window > 0

    @property
    def rows(self) -> int:
        """Rows recorded by the last :meth:`run`, also when it failed."""
        return int(self._state.row)

    @property
    def state(self) -> structs.EngineStruct:
        """The C engine's own state, for code that calls ``engine_run``; see :meth:`prepare`."""
        return self._state

    def prepare(self, ticks: int) -> int:
        """Hand over tables to a loop that is run from C; returns for how many of the next `ticks`
        ticks they last.
        """
        return self._next_tables(ticks)

    def failure(self, result: int) -> BaseException:
        """The error for a result of ``engine_run`` other than OK and STOPPED."""
        return self._error(EngineResult(result))

    def end(self, result: int) -> Termination | None:
        """The FMU that ended the simulation, if that is what a result of ``engine_run`` means."""
        return self._bound.ended(self._state.failed_index, EngineResult(result))

    def stop(self) -> None:
        """Ask a running loop to stop after the current tick; callable from any thread."""
        self._state.stop = 1

    def _next_tables(self, ticks: int) -> int:
        """Take the next rows where none are left; return for how many of `ticks` they last."""
        if self._drawn.end <= self.tick and self._tables:
            self._take(self._tables.draw(self.tick, ticks))
        return min(ticks, self._drawn.end - self.tick)

    def _take(self, drawn: DrawnRows) -> None:
        """Let the links and players use these rows, from their first on."""
        self._drawn = drawn
        if self.plan.links:
            links = rows_of(self._bound.links)
            links["table"], links["row"] = drawn.addresses, 0
            links["rows"] = drawn.links.counts
            if self._keep_tables and not drawn.filled:
                self._keep_tables(drawn.links)
        for played, values in zip(self._bound.players, drawn.values, strict=True):
            played.values, played.row, played.rows = values.ctypes.data, 0, len(values)
        if self._team:
            self._team.allow(drawn.links, drawn.start)

    @property
    def drawn(self) -> tuple[int, int]:
        """The ticks from which on, and before which, rows of tables have been drawn last."""
        return self._drawn.start, self._drawn.end

    def draw_again(self, start: int, end: int) -> None:
        """Draw tables up to tick `end` as an earlier run did, whose :attr:`drawn` is given.

        The engine is at tick 0 and stays there; what is kept of the state of links and players is
        to be restored afterwards. Raises RunError.
        """
        if self._tables and end > 0:
            for drawn in self._tables.draw_again(start, end):
                self._take(drawn)

    def _keep_filled_tables(self) -> None:
        """Keep the rows that the run has filled in, as far as it came."""
        if self._keep_tables:
            self._keep_tables(filled_rows(self._drawn, [x.row for x in self._bound.links]))

    def _error(self, result: EngineResult) -> BaseException:
        failure, self._bound.failure = self._bound.failure, None
        if isinstance(failure, KeyboardInterrupt):
            return failure
        tick, index = int(self._state.failed_tick), self._state.failed_index
        time = self.plan.time(tick)
        where = f"at tick {tick} (t = {time:.6g} s)"
        if result is EngineResult.HISTORY:
            name = self.plan.links[index].name
            return RunError(f"link {name}: no such sample {where}", tick=tick, time=time)
        if result is EngineResult.GATE:
            gate = self.plan.gates[index]
            text = f"{gate.component}: {gate.name} stopped it {where}"
            return RunError(text, component=gate.component, tick=tick, time=time)
        step = self.plan.components[index]
        text = f"{step.name}: {self._reason(result, step, failure)} {where}"
        error = RunError(text, component=step.name, tick=tick, time=time)
        error.__cause__ = failure
        return error

    def _reason(self, result: EngineResult, step: Step, failure: BaseException | None) -> str:
        if failure is not None:
            return sentence(failure, step.name)
        if result is EngineResult.NOT_FINITE:
            return not_finite(step.outputs, self.signals)
        if result is EngineResult.LOOP and self._macros is not None:
            return self._macros.loop_failure(step.name)
        if isinstance(step.component, NativeComponent):
            return step.component.failure()
        from cosim.fmi.failures import step_refused  # few runs fail

        state = self._state
        return step_refused(step, self.signals, result, state.failed_status, state.failed_signal)

    def texts(self) -> dict[str, list[str]]:
        """String and Binary outputs of all FMUs as they stand, by ``component.port``."""
        return {
            f"{step.name}.{port}": found
            for step in self.plan.components
            for port, found in components.texts(step.component).items()
        }

    def late_clock_ticks(self) -> dict[str, tuple[int, float]]:
        """Number of late clock ticks of each FMU, and their greatest delay (s)."""
        return self._bound.late_clock_ticks()

    def macro_steps(self) -> list[dict[str, Any]]:
        """The work of each group with macro steps so far, as plain data."""
        return [] if self._macros is None else self._macros.facts()

    def logs(self) -> dict[str, str]:
        """The log texts of FMUs with logging enabled, by component; also after :meth:`close`."""
        return {
            step.name: text
            for step in self.plan.components
            if (text := components.log_text(step.component))
        }

    def close(self) -> None:
        """Free the FMUs; may be called twice.

        After a fatal status the standard forbids every call to any instance of that FMU. The
        working directory is then the one that it was, whatever an FMU has made of it.
        """
        state = self._state
        if self._tables:
            self._tables.close()
        if self._team:
            self._team.close()
            self._team = None
        saved = {} if self._macros is None else self._macros.saved()
        components.close(
            [s.component for s in self.plan.components],
            state.failed_index,
            state.failed_status,
            saved,
        )
        return_to(self._place)


def _no_rows(end: int) -> DrawnRows:
    nothing = np.empty(0, np.int64)
    return DrawnRows(end, end, LinkRows(np.empty(0, np.int32), nothing), nothing, {}, ())


class SignalViews(Sequence[Views]):
    """The signals of the inputs or outputs of each component, as views by port; read-only: `fixed`.

    They are made when they are asked for: FMUs need none.
    """

    def __init__(
        self, signals: Vector, slots: Sequence[Sequence[Slot]], *, fixed: bool = False
    ) -> None:
        self._signals, self._slots, self._fixed = signals, slots, fixed
        self._known: dict[int, Views] = {}

    def __len__(self) -> int:
        return len(self._slots)

    def __getitem__(self, i: Any) -> Any:
        if i not in self._known:
            slots = self._slots[i]
            self._known[i] = {s.port: part(self._signals, s).reshape(s.shape) for s in slots}
            for view in self._known[i].values():
                view.flags.writeable = not self._fixed
        return self._known[i]
