"""The inertial parameters that a law adapts: all, an independent set, or chosen ones.

An adaptive law has an entry of Gamma for each of the ten parameters of a link; 0 keeps a parameter
at its start. Of the columns of the regressor Y(q, dq, z, dz), some are zero and some combinations
of others, in every motion. An independent set of columns spans the torques that all of them do:
with adaptation of these parameters only, theta_hat is an estimate of the *base parameters*, each of
which contains the others at their start. The proofs hold for it, since Y theta = Y_base beta for
the base parameters beta of the arm.

Source: M. Gautier, "Numerical calculation of the base inertial parameters of robots", Journal of
Robotic Systems 8(4), 1991.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from cosim.base.errors import ScenarioError
from fmus.arms import chain_law
from fmus.arms.chain import Table
from fmus.arms.identification import DEPENDENT, FIRST, LINK, independent
from fmus.model.numeric import Array, np

#: Random states for the independent columns, for each joint, and what they are scaled with.
_STATES = 20
_SCALES = np.array([[np.pi], [2.0], [2.0], [5.0]])  # q, dq, z, dz
_NAME = re.compile(r"(\w+)\[(\d+)\]")


def base_set(table: Table) -> Array:
    """1 for an independent set of the parameters (n, 10) of the regressor with gravity, else 0.

    Rotors and friction are no columns: an adaptive law knows them.
    """
    n = table.joints
    random = np.random.default_rng(0)
    states = random.uniform(-1.0, 1.0, (_STATES * n, 4, n)) * _SCALES
    W = np.vstack(
        [
            chain_law.regressor(table, q, dq, z, dz, table.g).reshape(n, -1)
            for q, dq, z, dz in states
        ]
    )  # (rows, 10 n)
    norms = np.linalg.norm(W, axis=0)
    order = [10 * i + k for i in range(n) for k in FIRST]
    effective = [i for i in order if norms[i] > DEPENDENT * norms.max()]
    kept = independent(W[:, effective] / norms[effective], DEPENDENT)
    found = np.zeros(10 * n)
    found[[effective[i] for i in kept]] = 1.0
    return found.reshape(n, 10)


def chosen(table: Table, what: object) -> Array:
    """1 for the parameters (n, 10) that are adapted, else 0.

    `what`: "all", "base", or a list of names such as "m[6]" and of numbers of links. Raises
    ScenarioError for another.
    """
    n = table.joints
    if what == "all":
        return np.ones((n, 10))
    if what == "base":
        return base_set(table)
    if isinstance(what, str) or not isinstance(what, Sequence) or not what:
        raise ScenarioError(
            f"found {what!r}; expected 'all', 'base' or a list such as ['m[6]', 5]", "adapt"
        )
    found = np.zeros((n, 10))
    for one in what:
        found[_places(one, n)] = 1.0
    return found


def _places(one: object, n: int) -> tuple[int, slice | int]:
    """The link, and the parameter or all of them, of an entry of the list."""
    named = _NAME.fullmatch(one) if isinstance(one, str) else None
    link = int(named[2]) if named else one
    if isinstance(link, bool) or not isinstance(link, int) or not 0 <= link < n:
        raise ScenarioError(
            f"found {one!r}; expected the number of a link, 0 to {n - 1}, or a parameter such as "
            "'m[0]'",
            "adapt",
        )
    if named is None:
        return link, slice(None)
    if named[1] not in LINK:
        raise ScenarioError(f"found {one!r}; expected one of {', '.join(LINK)} of a link", "adapt")
    return link, LINK.index(named[1])
