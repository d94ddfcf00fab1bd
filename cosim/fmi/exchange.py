"""An FMU for model exchange as the engine steps it: its functions, its solver, its memory."""

from __future__ import annotations

import ctypes as c
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from cosim.base.errors import FmuError
from cosim.fmi.file.model_structure import ContinuousStates
from cosim.fmi.library import Instance
from cosim.fmi.options import FmuOptions
from cosim.native import enums, structs

#: Vectors of states and of event indicators that ``model_exchange.c`` works with.
_STATES, _INDICATORS = 7, 4
#: Relative tolerance of CVODE, where neither a scenario nor the FMU states one.
TOLERANCE = 1e-6
SOLVERS = {kind.name.lower(): kind for kind in enums.SolverKind}


@dataclass(frozen=True, slots=True)
class ExchangeLayout:
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
        from cosim.fmi.cvode import give_solver

        give_solver(found, instance, layout.name, layout.longest, alive)
    return c.addressof(found)


def _references(values: Sequence[int], alive: list[Any]) -> int:
    array = (c.c_uint32 * max(1, len(values)))(*values)
    alive.append(array)
    return c.addressof(array)
