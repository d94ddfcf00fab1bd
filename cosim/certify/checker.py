"""The decision that a certificate holds, in integers: no solver, no NumPy, no rounding.

Small gain: with P > 0 and X_i > 0, for all states x and errors w other than 0::

    V(x+) - V(x) + sum_i (g_i^2 v_i' X_i v_i - w_i' X_i w_i) < 0        V(x) = x' P x

Lyapunov: with P > 0 for the ages m of one step and P' > 0 for any that may follow::

    x' A_m' P' A_m x < x' P x

Each is a symmetric matrix of integers, and positive definite or not
(:func:`cosim.certify.exact.positive_definite`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cosim.certify.exact import Exact, beside, positive_definite
from cosim.certify.model import ClosedParts
from cosim.certify.nominal import Centre, nominal, squared_gain
from cosim.certify.switched import Ages, follow, modes, switched


def small_gain_holds(
    parts: ClosedParts, centres: Sequence[Centre], P: Exact, X: Sequence[Exact]
) -> bool:
    """True if P and X prove that the loop is stable with any ages within the bounds."""
    found = nominal(parts, centres)
    n, m = len(found.F), parts.B.width
    if len(P) != n or [len(x) for x in X] != [len(p) for p in found.places]:
        return False
    if not all(positive_definite(x) for x in (P, *X)):
        return False
    state = beside(Exact.eye(n), Exact.zeros(n, m))
    falls = state.T @ P @ state - found.F.T @ P @ found.F
    every = zip(parts.links, centres, X, found.places, found.steps, strict=True)
    for link, centre, x, place, steps in every:
        w = beside(Exact.zeros(len(place), n), Exact.eye(m).take(place))
        falls = falls + w.T @ x @ w
        for i in range(0, len(steps), len(place)):
            v = found.V.take(steps[i : i + len(place)])
            falls = falls - (v.T @ x @ v).times(squared_gain(link, centre))
    return positive_definite(falls)


def lyapunov_holds(parts: ClosedParts, P: Mapping[Ages, Exact] | Exact) -> bool:
    """True if P, common or one for each combination of ages, proves stability with any ages."""
    if any(x.sends > 1 for x in parts.links):
        return False
    every = modes(parts.links)
    given = {m: P for m in every} if isinstance(P, Exact) else P
    if set(given) != set(every):
        return False
    known = list({id(x): x for x in given.values()}.values())
    if not all(positive_definite(x) for x in known):
        return False
    for m in every:
        A = switched(parts, m)
        if any(len(x) != len(A) for x in known):
            return False
        after = {id(given[o]): given[o] for o in every if follow(parts.links, m, o)}
        if not all(positive_definite(given[m] - A.T @ x @ A) for x in after.values()):
            return False
    return True
