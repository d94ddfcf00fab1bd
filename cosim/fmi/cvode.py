"""CVODE of SUNDIALS 7, from the libraries in the package FMPy, as the solver of a stiff FMU.

The solver is made here and stepped by ``cosim/c/engine/cvode.c``. Functions and constants:
SUNDIALS 7, "User Documentation for CVODE", chapter 5.
"""

from __future__ import annotations

import ctypes as c
import weakref
from functools import lru_cache
from importlib.util import find_spec
from math import isfinite
from pathlib import Path
from typing import Any

from cosim.base.errors import FmuError
from cosim.fmi.file.binaries import platform_folder
from cosim.fmi.library import Instance
from cosim.native import shared, structs

_PARTS = ("core", "nvecserial", "sunmatrixdense", "sunlinsoldense", "cvode")  # as they are loaded
_BDF, _MAJOR = 2, 7
_COLUMN = "SUNDenseMatrix_Column"
#: Functions that C calls, by their place in ``exchange_t``.
_CALLED = {
    "advance": "CVode", "restart": "CVodeReInit", "stop_time": "CVodeSetStopTime",
    "dense": "CVodeGetDky", "tolerances": "CVodeSVtolerances", "data": "N_VGetArrayPointer",
    "column": _COLUMN,
}  # fmt: skip


def give_solver(
    x: structs.ExchangeStruct, instance: Instance, name: str, longest: float, alive: list[Any]
) -> None:
    """Give an FMU's struct a solver: backward differentiation, dense matrix, exact Jacobian if any.

    `longest`: of its steps (s), or infinity. What C points to is added to `alive`; the solver is
    freed with it. Raises FmuError where SUNDIALS is missing or refuses.
    """
    try:
        sundials = _sundials()
    except FmuError as error:
        raise FmuError(f"{name}: {error}") from None
    for place, function in _CALLED.items():
        setattr(x, place, shared.address(sundials.function(function)))
    absolute = _absolute(x, instance)
    alive.append(_Solver(sundials, x, absolute, longest, name))


class _Sundials:
    """The loaded libraries. Raises FmuError where they are missing or of another version."""

    def __init__(self) -> None:
        self._libraries = [self._load(part) for part in _PARTS]
        numbers, label = [c.c_int() for _ in range(3)], c.create_string_buffer(32)
        version = self.function("SUNDIALSGetVersionNumber")
        version(*(c.byref(n) for n in numbers), label, c.c_int(len(label)))
        if numbers[0].value != _MAJOR:
            raise FmuError(f"FMPy has SUNDIALS {numbers[0].value}; expected {_MAJOR} for CVODE")

    @staticmethod
    def _load(part: str) -> c.CDLL:
        spec, (platform, suffix) = find_spec("fmpy"), platform_folder("3.0")
        folder = Path(spec.origin).parent if spec and spec.origin else Path()
        path = folder / "sundials" / platform / f"sundials_{part}{suffix}"
        try:
            return c.CDLL(str(path), mode=c.RTLD_GLOBAL)
        except OSError as error:
            raise FmuError(
                f"CVODE is not available, since FMPy has no SUNDIALS for {platform} ({error}); "
                "expected solver = euler, heun or rk4"
            ) from None

    def function(self, name: str, result: Any = c.c_int) -> Any:
        """A function by its name. Raises FmuError where no library has it."""
        for library in self._libraries:
            try:
                function = library[name]
            except AttributeError:
                continue
            function.restype = result
            return function
        raise FmuError(f"SUNDIALS of FMPy has no function {name}")


@lru_cache(maxsize=1)
def _sundials() -> _Sundials:
    return _Sundials()


def _absolute(x: structs.ExchangeStruct, instance: Instance) -> list[float]:
    """Absolute tolerances by the nominal values of the states (FMI 2.0.5 §2.1.3)."""
    nominals = (c.c_double * x.n_states)()
    get = c.CFUNCTYPE(c.c_int, c.c_void_p, c.c_void_p, c.c_size_t)(x.nominals)
    status = get(instance.handle, nominals, x.n_states)
    instance.returned(status)
    good = status in (0, 1) and all(isfinite(n) and n != 0.0 for n in nominals)
    return [0.01 * x.tolerance * (abs(n) if good else 1.0) for n in nominals]


class _Solver:
    """CVODE's memory for one FMU, whose struct `x` is filled in; freed with this object."""

    def __init__(
        self, sundials: _Sundials, x: structs.ExchangeStruct, absolute: list[float], longest: float,
        name: str,
    ) -> None:  # fmt: skip
        self._sundials, self._name = sundials, name
        context = c.c_void_p()
        self._checked("SUNContext_Create", c.c_int(0), c.byref(context))
        self._checked("SUNContext_ClearErrHandlers", context)  # errors are said here
        made = self._made("N_VNew_Serial", c.c_int64(x.n_states), context)
        limits = self._made("N_VNew_Serial", c.c_int64(x.n_states), context)
        for vector, values in ((made, [0.0] * x.n_states), (limits, absolute)):
            data = sundials.function("N_VGetArrayPointer", c.c_void_p)(vector)
            (c.c_double * x.n_states).from_address(data)[:] = [*values]
        solver = self._made("CVodeCreate", c.c_int(_BDF), context)
        matrix = self._made("SUNDenseMatrix", *[c.c_int64(x.n_states)] * 2, context)
        linear = self._made("SUNLinSol_Dense", made, matrix, context)
        rates = c.c_void_p(shared.address(shared.library().exchange_rates))
        self._checked("CVodeInit", solver, rates, c.c_double(0.0), made)
        self._checked("CVodeSVtolerances", solver, c.c_double(x.tolerance), limits)
        self._checked("CVodeSetUserData", solver, c.c_void_p(c.addressof(x)))
        self._checked("CVodeSetMaxHnilWarns", solver, c.c_int(-1))
        self._checked("CVodeSetLinearSolver", solver, linear, matrix)
        if x.directional:
            jacobian = c.c_void_p(shared.address(shared.library().exchange_jacobian))
            self._checked("CVodeSetJacFn", solver, jacobian)
        if isfinite(longest):
            self._checked("CVodeSetMaxStep", solver, c.c_double(longest))
        x.cvode, x.vector, x.absolute = solver.value, made.value, limits.value
        pointers = (solver.value, linear.value, matrix.value, limits.value, made.value)
        weakref.finalize(self, _free, sundials, pointers, context.value)

    def _made(self, name: str, *arguments: Any) -> c.c_void_p:
        found = c.c_void_p(self._sundials.function(name, c.c_void_p)(*arguments))
        if not found.value:
            raise FmuError(f"{self._name}: {name} of SUNDIALS failed")
        return found

    def _checked(self, name: str, *arguments: Any) -> None:
        flag = self._sundials.function(name)(*arguments)
        if flag != 0:
            raise FmuError(f"{self._name}: {name} of SUNDIALS returned {flag}")


def _free(sundials: _Sundials, pointers: tuple[int | None, ...], context: int | None) -> None:
    solver, linear, matrix, *vectors = pointers
    sundials.function("CVodeFree", None)(c.byref(c.c_void_p(solver)))
    sundials.function("SUNLinSolFree")(c.c_void_p(linear))
    sundials.function("SUNMatDestroy", None)(c.c_void_p(matrix))
    for vector in vectors:
        sundials.function("N_VDestroy", None)(c.c_void_p(vector))
    sundials.function("SUNContext_Free")(c.byref(c.c_void_p(context)))
