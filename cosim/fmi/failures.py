"""Messages for components that do not start, and for steps that fail or that an FMU refuses."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import CosimError, ScenarioError
from cosim.fmi.component import FmuComponent
from cosim.fmi.library import status_name
from cosim.native.enums import EngineResult
from cosim.schedule.parts import Slot, Step

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

#: Folders of installed packages and of Python's own modules.
_LIBRARIES = {"site-packages", "dist-packages", Path(traceback.__file__).parent.name}


def sentence(error: BaseException, name: str = "") -> str:
    """An exception of component `name` as text, with the user's line that led to it.

    ``ZeroDivisionError: division by zero (controller.py, line 12)``; a CosimError needs no
    addition. The last line of a library says little: "Singular matrix (_linalg.py, line 144)".
    """
    if isinstance(error, CosimError):
        return str(error).removeprefix(f"{name}: ")
    text = f"{type(error).__name__}: {error}".removesuffix(": ")
    if isinstance(error, SystemExit):
        text = f"sys.exit({error.code!r})"
    ours = Path(__file__).parents[1]
    frames = [(Path(x.filename), x.lineno) for x in traceback.extract_tb(error.__traceback__)]
    last = [i for i, (file, _) in enumerate(frames) if file.parent.parent == ours][-1:]
    given = [x for x in frames[last[0] + 1 if last else 0 :] if not x[0].name.startswith("<")]
    users = [x for x in given if not _LIBRARIES & {*x[0].parts}] or given
    return f"{text} ({users[-1][0].name}, line {users[-1][1]})" if users else text


@contextmanager
def starting(name: str) -> Iterator[None]:
    """Turn an error of component `name` at the start into a ScenarioError that names it."""
    with starting_one_of(lambda: name):
        yield


@contextmanager
def starting_one_of(name_at_hand: Callable[[], str]) -> Iterator[None]:
    """The same if several components start together.

    `name_at_hand` returns the name of the one that failed; only then it is called. Raises
    ScenarioError.
    """
    try:
        yield
    except (Exception, SystemExit) as error:
        name = name_at_hand()
        raise ScenarioError(f"{name} does not start: {sentence(error, name)}") from error


def not_finite(slots: Sequence[Slot], signals: NDArray[np.float64]) -> str:
    """Return the message that names the outputs that are not finite.

    `signals` (n,): all signals of the plan, in their units.
    """
    bad = [
        f"{name} = {value}"
        for slot in slots
        for name, value in zip(slot.scalars(), signals[slot.start :], strict=False)
        if not np.isfinite(value)
    ]
    return f"not a finite number: {', '.join(bad)}"


def step_failure(result: EngineResult, status: int, said: str, call: str = "doStep") -> str:
    """The error for a failed step of an FMU; `said`: in its log; `call`: what computes a step."""
    if result is EngineResult.EARLY_RETURN:
        return "the FMU returned early from its step, which is not supported"
    verb = {EngineResult.SET: "setting inputs", EngineResult.GET: "getting outputs"}.get(
        result, call
    )
    return f"{verb} returned {status_name(status)} ({said})"


def trapped(result: EngineResult, did: str, said: str) -> str:
    """The error for an FMU in WebAssembly that `did` what ended it; `said`: in its log."""
    verbs = {EngineResult.SET: "setting inputs", EngineResult.GET: "getting outputs"}
    return f"{verbs.get(result, 'doStep')} {did} ({said})"


#: What computes a step, by the interface of an FMU.
_CALLS = {
    "CoSimulation": "doStep",
    "ModelExchange": "a call of the solver",
    "ScheduledExecution": "fmi3ActivateModelPartition",
}


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
    instance = step.component.instance
    said = instance.log.said()
    if did := instance.trapped():
        return trapped(result, did, said)
    call = _CALLS[step.component.description.interface]
    return refusal(result, status, said, wrong_value(slots, signals, place), call)
