"""A minimal adapter of FMUs for other frameworks: set, step and get through ctypes.

The engine loads and starts the FMUs; after that only their own functions are called.
"""

from __future__ import annotations

import ctypes as c
from typing import final

from benchmarks.peers import Absent
from cosim.engine.engine import Engine
from cosim.fmi import FmuComponent
from cosim.schedule.parts import Step
from cosim.schedule.plan import Plan


@final
class Stepper:
    """One FMU: `y`, its outputs as they are; ``step(t, u)`` goes on by one step of `h` (s)."""

    def __init__(self, fmu: FmuComponent, y: list[float], h: float) -> None:
        self.y, self._h = y, h
        self._three = fmu.description.fmi == "3.0"
        handle = c.c_void_p(fmu.instance.handle)
        put, step, get = fmu.instance.loop_functions()
        inputs, outputs = (fmu.references(name) for name in ("input", "output"))
        self._u, self._y = (
            (c.c_double * (sum(p.size for p in fmu.inputs)))(),
            (c.c_double * len(y))(),
        )
        values = [c.c_void_p, c.c_void_p, c.c_size_t, c.c_void_p, *[c.c_size_t] * self._three]
        call = c.CFUNCTYPE(c.c_int, *values)
        self._put, self._get = call(put), call(get)
        self._put_arguments = self._arguments(handle, inputs, self._u)
        self._get_arguments = self._arguments(handle, outputs, self._y)
        flags = [c.c_void_p] * 4 if self._three else []
        of_step = [c.c_void_p, c.c_double, c.c_double, c.c_int, *flags]
        if self._three:
            of_step[3] = c.c_bool
        self._step, self._handle = c.CFUNCTYPE(c.c_int, *of_step)(step), handle
        told = (c.c_bool(), c.c_bool(), c.c_bool(), c.c_double())
        self._told = [c.byref(x) for x in told] if self._three else []

    def _arguments(
        self, handle: c.c_void_p, references: tuple[int, ...], values: object
    ) -> list[object]:
        array = (c.c_uint32 * max(1, len(references)))(*references)
        size = len(values)  # type: ignore[arg-type]
        return [handle, array, len(references), values, *([size] if self._three else [])]

    def step(self, t: float, u: list[float]) -> list[float]:
        """Set inputs `u`, step from `t` (s), return the outputs. Raises Absent on any failure."""
        failed = 0
        if u:
            self._u[:] = u  # type: ignore[assignment]
            failed = self._put(*self._put_arguments)
        failed = failed or self._step(self._handle, t, self._h, 1, *self._told)
        failed = failed or self._get(*self._get_arguments)
        if failed:
            raise Absent(f"an FMU returned status {failed}")
        self.y = list(self._y)
        return self.y


@final
class Steppers:
    """The FMUs of a plan, in its order, at their start."""

    def __init__(self, plan: Plan) -> None:
        self._engine = Engine(plan)
        self._engine.initialize()
        self.all = [self._stepper(step, plan.h) for step in plan.components]

    def _stepper(self, step: Step, h: float) -> Stepper:
        assert isinstance(step.component, FmuComponent)
        s = self._engine.signals
        y = [float(x) for o in step.outputs for x in s[o.start : o.start + o.size]]
        return Stepper(step.component, y, h)

    def close(self) -> None:
        """Free the FMUs."""
        self._engine.close()
