"""Error messages for an FMU that did not complete a step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from cosim.fmi.component import FmuComponent
from cosim.fmi.failures import step_failure
from cosim.fmi.library import status_name
from cosim.native.enums import EngineResult
from cosim.schedule.parts import Slot, Step

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


#: What computes a step, by the interface of an FMU.
_CALLS = {
    "CoSimulation": "doStep", "ModelExchange": "a call of the solver",
    "ScheduledExecution": "fmi3ActivateModelPartition",
}  # fmt: skip


def refusal(result: EngineResult, status: int, said: str, value: str, call: str = "doStep") -> str:
    """The sentence for a result of engine.c; `said`: in the log, `value`: the signal at fault.

    `call`: what computes a step.
    """
    if result is EngineResult.VALUE:
        return (
            f"{value} is no value of its type: whole numbers within the type's range (64 bits: up "
            "to 2^53, what float64 carries exactly), 0 or 1 for a Boolean"
        )
    if result is EngineResult.STUCK:
        return (
            f"the step does not end: 100000 early returns, events or updates of its states ({said})"
        )
    if result is EngineResult.SOLVER:
        return (
            f"CVODE returned {status}: it found no step that keeps the tolerance, or a state is no "
            f"number ({said})"
        )
    if result is EngineResult.STATE:
        return f"its state could not be saved or restored: {status_name(status)} ({said})"
    if result is EngineResult.EVENT:
        return f"a call in Event Mode failed ({said})"
    if result is EngineResult.INTERVAL:
        return (
            "a changing clock, or one that counts down, was asked for its next interval and gave "
            f"none of 0 s or more, or one that ends when it has just ticked ({said})"
        )
    return step_failure(result, status, said, call)


def wrong_value(slots: Sequence[Slot], signals: NDArray[np.float64], place: int) -> str:
    """``name = value`` of the scalar at `place`; "" where it is none of these slots'."""
    names = {s.start + i: name for s in slots for i, name in enumerate(s.scalars())}
    return f"{names[place]} = {float(signals[place]):.17g}" if place in names else ""


def step_refused(
    step: Step, signals: NDArray[np.float64], result: EngineResult, status: int, place: int
) -> str:
    """Return the message for a step that an FMU refused.

    `signals` (n,): all signals of the plan, in their units; `place`: index of the signal at fault.
    """
    assert isinstance(step.component, FmuComponent)
    slots = (*step.inputs, *step.outputs)
    if result is EngineResult.LOST and step.component.remote is not None:
        return step.component.remote.lost(status, "doStep").removeprefix(f"{step.name}: ")
    said = step.component.instance.log.said()
    call = _CALLS[step.component.description.interface]
    return refusal(result, status, said, wrong_value(slots, signals, place), call)
