"""Messages for failed steps."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import CosimError, ScenarioError
from cosim.fmi.library import status_name
from cosim.native.enums import EngineResult
from cosim.schedule.parts import Slot


def sentence(error: BaseException, name: str = "") -> str:
    """An exception of component `name` as text, with the line that raised it.

    ``ZeroDivisionError: division by zero (controller.py, line 12)``; a CosimError needs no
    addition.
    """
    if isinstance(error, CosimError):
        return str(error).removeprefix(f"{name}: ")
    text = f"{type(error).__name__}: {error}".removesuffix(": ")
    if isinstance(error, SystemExit):
        text = f"sys.exit({error.code!r})"
    frames = traceback.extract_tb(error.__traceback__)
    file = Path(frames[-1].filename) if frames else Path("<unknown>")
    if file.name.startswith("<") or file.parent.parent == Path(__file__).parents[1]:
        return text
    return f"{text} ({file.name}, line {frames[-1].lineno})"


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
