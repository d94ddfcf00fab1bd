"""The bare C loop (``floor.c``) over the FMUs of a plan: what everything is measured against."""

from __future__ import annotations

import ctypes as c
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers import Absent
from cosim.base.clock import stopwatch
from cosim.engine.engine import Engine
from cosim.fmi import FmuComponent
from cosim.native.enums import Code
from cosim.schedule.parts import Step
from cosim.schedule.plan import Plan
from fmus.build.toolchain import compile_shared, shared_suffix

Rows = NDArray[np.float64]
#: Functions of Event Mode.
EVENTS = ("EnterEventMode", "UpdateDiscreteStates", "EnterStepMode")


class _Fmu(c.Structure):
    _fields_ = (
        *((name, c.c_void_p) for name in ("instance", "set", "step", "get")),
        *((name, c.c_void_p) for name in ("enter_event", "update", "enter_step")),
        ("next_event", c.c_double),
        *((name, c.c_void_p) for name in ("inputs", "outputs")),
        *((name, c.c_size_t) for name in ("n_inputs", "n_outputs")),
        *((name, c.c_void_p) for name in ("u", "y")),
        *((name, c.c_size_t) for name in ("n_u", "n_y")),
    )


class _Copy(c.Structure):
    _fields_ = (("source", c.c_void_p), ("target", c.c_void_p), ("n", c.c_size_t))


class _Loop(c.Structure):
    _fields_ = (
        *((name, c.c_void_p) for name in ("fmus", "copies", "signals", "rows")),
        *((name, c.c_int64) for name in ("n_fmus", "n_copies", "n_signals", "tick")),
        ("h", c.c_double),
    )


class _Pair(c.Structure):
    _fields_ = (
        ("loop", _Loop),
        *((name, c.c_void_p * 2) for name in ("sent_from", "held_at", "sent", "held")),
        *((name, c.c_int64) for name in ("n", "every")),
    )


@lru_cache(maxsize=1)
def _library() -> c.CDLL:
    folder = tempfile.mkdtemp(prefix="floor-")
    path = Path(folder, f"floor{shared_suffix()}")
    loaded = c.CDLL(str(compile_shared([Path(__file__).with_name("floor.c")], path)))
    loaded.floor_sizes.restype = c.c_size_t
    assert [loaded.floor_sizes(i) for i in range(4)] == [
        c.sizeof(t) for t in (_Fmu, _Copy, _Loop, _Pair)
    ]
    for run in (loaded.floor_run, loaded.floor_teleoperation):
        run.argtypes, run.restype = [c.c_void_p, c.c_int, c.c_int64], c.c_int
    return loaded


@final
class Floor:
    """A session of the bare loop: `plan` as far as it is FMUs that all step every tick.

    The FMUs are started by the engine, whose `rows` come out the same if both are right.
    `length`: ticks that fit into `rows`, or 0 to record nothing. `events`: whether it handles
    events and early returns of FMI 3.0, as an importer must; else it ignores them.
    """

    def __init__(self, plan: Plan, length: int = 0, *, events: bool = False) -> None:
        self._engine = Engine(plan)
        self._engine.initialize()
        self._steps = plan.components
        self._signals = self._engine.signals.copy()
        self._alive: list[Any] = []
        self.rows: Rows = np.zeros((length, plan.n_signals))
        fmus = (_Fmu * len(self._steps))(*(self._fmu(step) for step in self._order(plan)))
        copies = self._copies(plan)
        self._alive += [fmus, copies]
        self._version = 3 if _fmu(self._steps[0]).description.fmi == "3.0" else 2
        if events:
            self._version = 4
        self._loop = _Loop(
            fmus=c.addressof(fmus), copies=c.addressof(copies), signals=self._signals.ctypes.data,
            n_fmus=len(fmus), n_copies=len(copies), n_signals=plan.n_signals, h=plan.h,
        )  # fmt: skip
        self._run = _library().floor_run
        self._address = c.addressof(self._loop)
        if plan.links:
            self._pair = self._delays(plan)
            self._loop = self._pair.loop
            self._run = _library().floor_teleoperation
            self._address = c.addressof(self._pair)

    def _order(self, plan: Plan) -> list[Step]:
        """Sampled ones first, each kind by name."""
        return [plan.component(name) for name in plan.order] + [
            step for step in self._steps if step.name not in plan.order
        ]

    def _place(self, index: int) -> int:
        return int(self._signals.ctypes.data) + 8 * index

    def _fmu(self, step: Step) -> _Fmu:
        component = _fmu(step)
        fmu = _Fmu(instance=component.instance.handle)
        fmu.set, fmu.step, fmu.get = component.instance.loop_functions()
        fmu.next_event = component.instance.next_event
        if component.events:
            fmu.enter_event, fmu.update, fmu.enter_step = map(component.instance.address, EVENTS)
        for name in ("input", "output"):
            references = component.references(name)
            array = (c.c_uint32 * max(1, len(references)))(*references)
            self._alive.append(array)
            setattr(fmu, f"{name}s", c.addressof(array))
            setattr(fmu, f"n_{name}s", len(references))
        for place, count, slots in (("u", "n_u", step.inputs), ("y", "n_y", step.outputs)):
            setattr(fmu, place, self._place(slots[0].start if slots else 0))
            setattr(fmu, count, sum(slot.size for slot in slots))
        return fmu

    def _copies(self, plan: Plan) -> Any:
        """The same copies the engine makes, in the same order."""
        found = [op for op in plan.operations if op.code is Code.COPY]
        return (_Copy * len(found))(
            *(_Copy(self._place(op.source), self._place(op.target), op.count) for op in found)
        )

    def _delays(self, plan: Plan) -> _Pair:
        """The links of the teleoperator: two vectors, a table each, everything sent kept."""
        period = plan.component(plan.order[0]).period
        hits = -(-plan.ticks // period)
        pair = _Pair(loop=self._loop, n=plan.links[0].source.size, every=period)
        for i, name in enumerate(plan.order):
            (link,) = (x for x in plan.links if x.target.component == name)
            held = np.ascontiguousarray(link.table.stream(hits).rows(hits), dtype=np.int32)
            out = next(x for x in plan.links if x.source.component == name)
            sent = np.zeros((1 + hits, out.source.size))
            sent[0] = self._signals[out.target.start : out.target.start + out.target.size]
            self._alive += [held, sent]
            pair.held[i], pair.sent[i] = held.ctypes.data, sent.ctypes.data
            pair.held_at[i] = self._place(link.target.start)
            pair.sent_from[i] = self._place(out.source.start)
        return pair

    def run(self, ticks: int) -> float:
        """Go on for `ticks` ticks, recording from the first row; returns s."""
        self._loop.rows = self.rows.ctypes.data if len(self.rows) else None
        watch = stopwatch()
        failed = self._run(self._address, self._version, ticks)
        seconds = watch()
        if failed:
            raise Absent("a call fails")
        return seconds

    def outputs(self) -> bytes:
        """The outputs of all FMUs as they are."""
        return b"".join(
            self._signals[s.start : s.start + s.size].tobytes()
            for step in self._steps
            for s in step.outputs
        )

    def recorded(self, n: int) -> bytes:
        """The first `n` rows since the last `run`; empty where nothing is recorded."""
        return self.rows[:n].tobytes()

    def close(self) -> None:
        """Free the FMUs."""
        self._engine.close()


def _fmu(step: Step) -> FmuComponent:
    assert isinstance(step.component, FmuComponent)
    return step.component
