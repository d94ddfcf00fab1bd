"""The number of steps of the classical Runge-Kutta method where friction and stops are stiff.

The method is stable while the fastest rate of an oscillation or a decay, times the step, is below
2.78. ``stiff.h`` has the same numbers for C.
"""

from __future__ import annotations

from math import ceil

from cosim.base.errors import RunError

#: Rate times step in which the method is stable in every direction, and the most steps.
BEARABLE, MOST_STEPS = 2.5, 1000


def steps_in(h: float, rate: float, least: int, name: str) -> int:
    """Steps of the method in h, s, that a `rate`, 1/s, needs; at least `least`.

    Raises RunError of the model `name` for more than MOST_STEPS.
    """
    needed = ceil(h * rate / BEARABLE)
    if needed > max(MOST_STEPS, least):
        raise RunError(
            f"{name}: friction and stops need {needed} steps of the integrator in a step, expected"
            f" at most {MOST_STEPS}: a greater v_f or inertia, or a shorter step"
        )
    return max(needed, least)
