"""Schedule of a grip: a signal of 0 (released) and 1 (grasped) that changes at up to eight times::

    grip = 1 (or 0 if `released`) before all times; at each time it changes

Wired to the input `grip` of an arm, the signal simulates that the operator releases and grasps the
arm. Two equal times cancel each other; a time beyond the end of the run has no effect.

Source: own construction.

Sampled: the signal of t_k is held to the next step; a step that begins less than a millionth of its
length before a time counts as beginning at that time. The output at the start is that of t = 0.
"""

from __future__ import annotations

from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import np

_NEVER = 1e9  # s


def model() -> Model:
    """Declare the signal; by default the hand holds on for ever."""
    return Model(
        identifier="grasp",
        description="Times at which a hand releases and grasps the arm",
        kind="sampled",
        variables=(
            Variable(
                "grip",
                "output",
                description="1 while the hand holds the arm, 0 otherwise",
                start_depends=("released",),
            ),
            Variable(
                "released",
                "parameter",
                start=0.0,
                description="1: the hand is off the arm at the start",
                type="integer",
                minimum=0.0,
                maximum=1.0,
            ),
            Variable("times", "parameter", (8,), "s", _NEVER, "Times of change", minimum=1e-9),
        ),
        sources=("grasp.c", "schedule.h"),
        step=5e-3,
        terminals=(Terminal("hand", ("grip",), "Whether the hand holds the arm"),),
        documentation=__doc__ or "",
    )


def law(x: Values, t: float, h: float) -> Values:
    """The equation above: grip, 0 or 1, at `t` (s); times up to 1e-6 `h` later count as reached."""
    changes = np.count_nonzero(t + 1e-6 * h >= x["times"])
    return {"grip": np.array(1.0 - (x["released"] + changes) % 2)}


fmu, kernel, Grasp = derive(model, law)
