"""What an FMU did instead of a step, in a sentence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from cosim.failures import refused
from cosim.native import Result
from cosim.plan import Slot

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def refusal(result: Result, status: int, lines: Sequence[str], value: str) -> str:
    """The sentence for a result of engine.c; `lines`: of the log, `value`: the signal at fault."""
    said = "; ".join(lines) or "the FMU logged nothing"
    if result is Result.VALUE:
        return (
            f"{value} is no value of its type: whole numbers within the type's range (64 bits: up "
            "to 2^53, what float64 carries exactly), 0 or 1 for a Boolean"
        )
    if result is Result.STUCK:
        return f"the step does not end: 100000 early returns or updates of its states ({said})"
    if result is Result.EVENT:
        return f"a call in Event Mode failed ({said})"
    return refused(result, status, lines)


def wrong_value(slots: Sequence[Slot], signals: NDArray[np.float64], place: int) -> str:
    """``name = value`` of the scalar at `place`; "" where it is none of these slots'."""
    names = {s.start + i: name for s in slots for i, name in enumerate(s.scalars())}
    return f"{names[place]} = {float(signals[place]):.17g}" if place in names else ""
