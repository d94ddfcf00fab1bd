"""An FMU for model exchange as the engine steps it: its functions, its solver, its memory.

CVODE of SUNDIALS 7, from the libraries in the package FMPy, solves stiff FMUs: it is made here and
stepped by ``cosim/c/engine/cvode.c``. Functions and constants: SUNDIALS 7, "User Documentation for
CVODE", chapter 5.
"""

from __future__ import annotations

import ctypes as c
import weakref
from collections.abc import Sequence
from functools import lru_cache
from importlib.util import find_spec
from math import isfinite
from pathlib import Path
from typing import Any

from cosim.base.convert import Struct
from cosim.base.errors import FmuError
from cosim.fmi.file.binaries import platform_folder
from cosim.fmi.file.model_structure import ContinuousStates
from cosim.fmi.library import Instance
from cosim.fmi.options import FmuOptions
from cosim.native import enums, shared, structs

#: Vectors of states and of event indicators that ``model_exchange.c`` works with.
_STATES, _INDICATORS = 7, 4
#: Relative tolerance of CVODE, where neither a scenario nor the FMU states one.
TOLERANCE = 1e-6
SOLVERS = {kind.name.lower(): kind for kind in enums.SolverKind}


class ExchangeLayout(Struct, frozen=True):
    """The integration of an FMU; `longest`: a step of the solver (s), `tolerance`: CVODE's."""

    name: str
    fmi: str
    states: ContinuousStates
    solver: enums.SolverKind
    longest: float
    tolerance: float


def exchange_layout(
    name: str, fmi: str, states: ContinuousStates, options: FmuOptions, stated: float | None,
    preferred: float | None,
) -> ExchangeLayout:  # fmt: skip
    """The layout that options ask for.

    `stated`: the tolerance and `preferred` the step (s) of the FMU's DefaultExperiment. A method of
    fixed steps takes the latter if nothing is said; CVODE chooses its steps. Raises FmuError for an
    unknown solver.
    """
    word = options.solver or "rk4"
    if word not in SOLVERS:
        raise FmuError(f"{name}: unknown solver {word!r}; expected one of {', '.join(SOLVERS)}")
    kind = SOLVERS[word]
    if kind is enums.SolverKind.CVODE and not states.count:
        kind = enums.SolverKind.EULER  # there is nothing to integrate, only events
    longest = options.max_step
    if longest is None:
        longest = None if kind is enums.SolverKind.CVODE else preferred
    tolerance = options.tolerance or stated or TOLERANCE
    return ExchangeLayout(name, fmi, states, kind, longest or float("inf"), tolerance)


def bind_exchange(instance: Instance, layout: ExchangeLayout, alive: list[Any]) -> int:
    """The address of the engine's struct of an instance, which is in Continuous-Time Mode.

    Its memory is added to `alive`. Raises FmuError where a function is missing, or CVODE is.
    """
    x, two, one = layout.states, layout.fmi == "2.0", layout.fmi == "1.0"
    memory = (c.c_double * max(1, _STATES * x.count + _INDICATORS * x.indicators))()
    found = structs.ExchangeStruct(
        memory=c.addressof(memory), n_states=x.count, n_indicators=x.indicators,
        n_references=len(x.references), states=_references(x.references, alive),
        rates=_references(x.rates, alive), longest=layout.longest, now=float("-inf"),
        next_event=instance.next_event, fresh=1, fmi=int(layout.fmi[0]), solver=layout.solver,
        tolerance=layout.tolerance,
    )  # fmt: skip
    alive += [memory, found]
    functions = {"set_time": "SetTime"}
    if one:  # which has no modes
        functions["update"] = "EventUpdate"
    else:
        functions["enter_event"] = "EnterEventMode"
        functions["update"] = "NewDiscreteStates" if two else "UpdateDiscreteStates"
        functions["enter_continuous"] = "EnterContinuousTimeMode"
    if x.count:
        functions |= {"set_states": "SetContinuousStates", "get_states": "GetContinuousStates"}
        functions["derivatives"] = (
            "GetDerivatives" if one or two else "GetContinuousStateDerivatives"
        )
        nominals = "GetNominalContinuousStates" if one else "GetNominalsOfContinuousStates"
        functions["nominals"] = nominals
    if x.indicators:
        functions["indicators"] = "GetEventIndicators"
    if x.completed:
        functions["completed"] = "CompletedIntegratorStep"
    if x.directional:
        functions["directional"] = "GetDirectionalDerivative"
    for name, suffix in functions.items():
        setattr(found, name, instance.address(suffix))
    if layout.solver is enums.SolverKind.CVODE:
        give_solver(found, instance, layout.name, layout.longest, alive)
    return c.addressof(found)


def _references(values: Sequence[int], alive: list[Any]) -> int:
    array = (c.c_uint32 * max(1, len(values)))(*values)
    alive.append(array)
    return c.addressof(array)


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
