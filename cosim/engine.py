"""Executes a plan: native components through their FMI functions, Python ones as call-backs.

The loop itself is ``engine.c``, called in chunks of ticks with the GIL released. What Python does
between chunks: hand over the next rows of the link tables, and a buffer to record into.
"""

from __future__ import annotations

import ctypes as c
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim import native
from cosim.binding import Binding, Vector, Views, store
from cosim.errors import RunError
from cosim.failures import not_finite, sentence, starting
from cosim.fmi import FmuComponent
from cosim.fmi.refusals import step_refused
from cosim.interrupts import deferred
from cosim.native import Result
from cosim.plan import Link, Plan, Slot, Step, Wire


class Engine:
    """One execution of a plan, from :meth:`initialize` on. Use as a context manager.

    `signals` is the signal vector; `tick` the next tick to run. `tables` collects the rows of each
    link's table as they are used, if `keep_tables` is given: called with (link name, rows).
    `gates`: (address of the function, of its context) of each gate of the plan, by its name.
    """

    def __init__(
        self,
        plan: Plan,
        keep_tables: Callable[[str, NDArray[np.int32]], None] | None = None,
        gates: Mapping[str, tuple[int, int]] | None = None,
    ) -> None:
        self.plan = plan
        self.signals: Vector = np.zeros(plan.n_signals)
        self._keep_tables = keep_tables
        self._inputs = [_views(self.signals, s.inputs, writable=False) for s in plan.components]
        self._outputs = [_views(self.signals, s.outputs, writable=True) for s in plan.components]
        self._streams = [link.table.stream() for link in plan.links]
        self._fed: defaultdict[str, list[Wire | Link]] = defaultdict(list)
        edges: list[Wire | Link] = [*plan.wires, *plan.links]
        for edge in edges:
            self._fed[edge.target.component].append(edge)
        self._played = [player.source.stream() for player in plan.players]
        self._rows: dict[str, NDArray[Any]] = {}
        self._bound = Binding(plan, self.signals, self._inputs, self._outputs, gates or {})
        self._state = self._bound.state
        self._library = native.library()

    def __enter__(self) -> Engine:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def tick(self) -> int:
        """The next tick to run; after a failure, the tick that failed."""
        return int(self._state.tick)

    def initialize(self) -> None:
        """Start all components; initial outputs travel along wires until nothing changes."""
        for step in self.plan.components:
            self._start(step)
        for _ in range(len(self.plan.components) + 1):
            before = self.signals.tobytes()
            for i, step in enumerate(self.plan.components):
                self._gather_initial(step.name)
                with starting(step.name):
                    store(self._outputs[i], step.component.initial(self._inputs[i]))
            if self.signals.tobytes() == before:
                break
        for i, step in enumerate(self.plan.components):
            if isinstance(step.component, FmuComponent):
                with starting(step.name):
                    for port, value in step.component.exit_initialization().items():
                        self._outputs[i][port][...] = value
        self._check_start()
        self._bound.bind()

    def _start(self, step: Step) -> None:
        parameters = {p.name: p for p in step.component.parameters}
        values = {k: np.array(v).reshape(parameters[k].shape) for k, v in step.values.items()}
        with starting(step.name):
            step.component.initialize(values)
        for slot, port in zip(step.inputs, step.component.inputs, strict=True):
            value = step.start.get(port.name) or port.default or (0.0,) * port.size
            self.signals[slot.start : slot.start + slot.size] = value

    def _gather_initial(self, name: str) -> None:
        for e in self._fed[name]:
            if isinstance(e, Link) and e.initial is not None:
                value: Any = e.initial
            else:
                value = e.gain * _part(self.signals, e.source) + e.offset
            _part(self.signals, e.target)[:] = value

    def _check_start(self) -> None:
        for step in self.plan.components:
            for slot in step.outputs:
                if not np.isfinite(_part(self.signals, slot)).all():
                    value = _part(self.signals, slot).tolist()
                    raise RunError(
                        f"{slot.name} = {value} at the start", component=step.name, tick=0, time=0.0
                    )

    # ---- running -----------------------------------------------------------------------------

    def run(self, ticks: int, record: Vector | None = None) -> int:
        """Run `ticks` ticks, recording one row a tick into `record` (rows, n_signals).

        Returns the number of rows written. Raises RunError where a component fails or gives a
        value that is not finite, KeyboardInterrupt after the tick in which Ctrl-C was pressed; rows
        recorded until then are in `record`.
        """
        state = self._state
        state.row = 0  # before anything can interrupt: `rows` is then about this run
        self._next_tables(ticks)
        state.record = None if record is None else record.ctypes.data
        with deferred(self.stop):
            result = Result(self._library.engine_run(c.byref(state), ticks))
        if result not in (Result.OK, Result.STOPPED):
            raise self._error(result)
        return int(state.row)

    @property
    def rows(self) -> int:
        """Rows recorded by the last :meth:`run`, also when it failed."""
        return int(self._state.row)

    @property
    def state(self) -> native.EngineState:
        """The C engine's own state, for who calls ``engine_run`` natively; see :meth:`prepare`."""
        return self._state

    def prepare(self, ticks: int) -> None:
        """Hand over the tables of the next `ticks` ticks to a loop that is run from C."""
        self._next_tables(ticks)

    def failure(self, result: int) -> BaseException:
        """What a result of ``engine_run`` other than OK and STOPPED means, as an error."""
        return self._error(Result(result))

    def stop(self) -> None:
        """Ask a running loop to stop after the current tick; callable from any thread."""
        self._state.stop = 1

    def _next_tables(self, ticks: int) -> None:
        for link, bound, stream in zip(
            self.plan.links, self._bound.links, self._streams, strict=True
        ):
            hits = self._hits(link.target.component, ticks)
            rows = np.ascontiguousarray(stream.rows(hits), dtype=np.int32)
            bound.table, bound.row, bound.rows = rows.ctypes.data, 0, hits
            self._rows[link.name] = rows
            if self._keep_tables:
                self._keep_tables(link.name, rows)
        for player, played, values in zip(
            self.plan.players, self._bound.players, self._played, strict=True
        ):
            hits = self._hits(player.target.component, ticks)
            chunk = np.ascontiguousarray(values.rows(hits), dtype=np.float64)
            played.values, played.row, played.rows = chunk.ctypes.data, 0, hits
            self._rows[player.target.name] = chunk

    def _hits(self, name: str, ticks: int) -> int:
        """How often a component is due in the next `ticks` ticks."""
        period = self.plan.component(name).period
        return -(-(self.tick + ticks) // period) - -(-self.tick // period)

    def _error(self, result: Result) -> BaseException:
        failure, self._bound.failure = self._bound.failure, None
        if isinstance(failure, KeyboardInterrupt | SystemExit):
            return failure
        tick, index = self.tick, self._state.failed_index
        time = tick * self.plan.h
        where = f"at tick {tick} (t = {time:.6g} s)"
        if result is Result.HISTORY:
            name = self.plan.links[index].name
            return RunError(f"link {name}: no such sample {where}", tick=tick, time=time)
        if result is Result.GATE:
            gate = self.plan.gates[index]
            text = f"{gate.component}: {gate.name} stopped it {where}"
            return RunError(text, component=gate.component, tick=tick, time=time)
        step = self.plan.components[index]
        text = f"{step.name}: {self._reason(result, step, failure)} {where}"
        error = RunError(text, component=step.name, tick=tick, time=time)
        error.__cause__ = failure
        return error

    def _reason(self, result: Result, step: Step, failure: BaseException | None) -> str:
        if failure is not None:
            return sentence(failure, step.name)
        if result is Result.NOT_FINITE:
            return not_finite(step.outputs, self.signals)
        state = self._state
        return step_refused(step, self.signals, result, state.failed_status, state.failed_signal)

    def texts(self) -> dict[str, list[str]]:
        """String and Binary outputs of all FMUs as they stand, by ``component.port``."""
        return {
            f"{step.name}.{port}": found
            for step in self.plan.components
            if isinstance(step.component, FmuComponent)
            for port, found in step.component.results().items()
        }

    def late(self) -> dict[str, tuple[int, float]]:
        """How often clocks of each FMU ticked after their time, and by how much at the most (s)."""
        return self._bound.late()

    def logs(self) -> dict[str, str]:
        """What FMUs whose logging is on have said, by component; also after :meth:`close`."""
        return {
            step.name: text
            for step in self.plan.components
            if isinstance(step.component, FmuComponent) and (text := step.component.log_text())
        }

    def save_logs(self, folder: Path) -> None:
        """Write what FMUs whose logging is on have said so far into ``folder/NAME.fmu.log``."""
        for name, text in self.logs().items():
            (folder / f"{name}.fmu.log").write_text(text, encoding="utf-8")

    def close(self) -> None:
        """Free the FMUs; may be called twice."""
        for step in self.plan.components:
            if isinstance(step.component, FmuComponent):
                step.component.close()


def _part(signals: Vector, slot: Slot) -> Vector:
    return signals[slot.start : slot.start + slot.size]


def _views(signals: Vector, slots: Sequence[Slot], *, writable: bool) -> Views:
    views = {s.port: _part(signals, s).reshape(s.shape) for s in slots}
    for view in views.values():
        view.flags.writeable = writable
    return views
