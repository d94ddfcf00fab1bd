"""Linear models by name: what of a loop is a state, its poles, and files for other tools."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.base.convert import Struct, field
from cosim.linear.component import Matrix
from cosim.linear.loop import LinearLoop
from cosim.linear.pieces import pieces
from cosim.linear.poles import LARGE, near_the_circle

#: Relative rest at which a held signal counts as a combination of states.
COMBINED = 1e-8
#: Relative change of derivatives with the size of the differences above which one is not smooth.
ROUGH = 1e-3


class Mode(Struct, frozen=True):
    """An eigenvalue of A: `z`, per period, and `s` = ln(z)/period (1/s).

    `frequency` is abs(s)/2 pi (Hz), `damping` -Re(s)/abs(s); `state` takes the greatest part in it.
    """

    z: complex
    s: complex
    frequency: float
    damping: float
    state: str


class LinearModel(Struct, frozen=True):
    """x[k+1] = `A` x[k] + `B` u[k] and y[k] = `C` x[k] + `D` u[k], deviations from a run at `time`.

    `period` (s) from k to k+1; u is held for a period. A (n, n), B (n, m), C (p, n), D (p, m); the
    units of their entries follow from those of `states`, `inputs` and `outputs`, pairs of name and
    unit. `errors`: by component how much its derivatives changed with the size of the differences.
    """

    time: float
    period: float
    states: tuple[tuple[str, str], ...]
    inputs: tuple[tuple[str, str], ...]
    outputs: tuple[tuple[str, str], ...]
    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    errors: dict[str, float] = field(default_factory=dict)

    def modes(self) -> list[Mode]:
        """The eigenvalues other than 0, the slowest first; of a pair, the one above the axis.

        Of a large model (:mod:`cosim.linear.poles`), those that are not near z = 1 are left out.
        Raises RunError for a large one without SciPy.
        """
        if len(self.A) > LARGE:
            found = near_the_circle(self.A)
            whole = zip(found.z, found.state, strict=True)
            integrals = [self._pole(1.0 + 0.0j, self.states[0][0])] * found.integrals
            return integrals + [self._pole(complex(z), self.states[i][0]) for z, i in whole]
        z, vectors = np.linalg.eig(self.A)
        try:
            inverse = np.linalg.inv(vectors)
        except np.linalg.LinAlgError:
            inverse = np.linalg.pinv(vectors)
        parts = np.abs(vectors * inverse.T)
        order = [i for i in np.argsort(-np.abs(z)) if abs(z[i]) > 1e-12 and z[i].imag >= 0.0]
        return [self._mode(complex(z[i]), parts[:, i]) for i in order]

    def _mode(self, z: complex, parts: Matrix) -> Mode:
        return self._pole(z, self.states[int(parts.argmax())][0])

    def _pole(self, z: complex, state: str) -> Mode:
        s = complex(np.log(z)) / self.period
        size = abs(s)
        damping = -s.real / size if size > 0.0 else 0.0
        return Mode(z, s, size / (2.0 * np.pi), damping, state)

    def as_data(self) -> dict[str, Any]:
        """The same for JSON and MATLAB: matrices as nested lists, names and units as lists."""
        ports = {
            key: [{"name": n, "unit": u} for n, u in getattr(self, key)]
            for key in ("states", "inputs", "outputs")
        }
        matrices = {key: getattr(self, key).tolist() for key in "ABCD"}
        times = {"time": self.time, "period": self.period}
        return {**times, **ports, **matrices, "errors": self.errors}


def reduced(
    loop: LinearLoop,
    time: float,
    inputs: Sequence[tuple[str, str]],
    outputs: Sequence[tuple[str, str]],
) -> LinearModel:
    """The model whose states are those of the components, and what else is remembered.

    Left out is what nothing reads, and held signals that are combinations of states at every start
    of a period. Input to output it is the same from the second period on.
    """
    kept = _read(loop.F, loop.H)
    index = np.flatnonzero(kept)
    held = (index >= loop.n_states) & (index < loop.n_states + loop.n_held)
    F, G = loop.F[np.ix_(index, index)], loop.G[index]
    base = _basis(np.hstack([F, G]), held)
    rest = ~base
    S = _combinations(np.hstack([F, G]), base)
    A = F[np.ix_(base, base)] + F[np.ix_(base, rest)] @ S
    H = loop.H[:, index]
    C = H[:, base] + H[:, rest] @ S
    last = _read(A, C)
    named = [(loop.names[i], loop.units[i]) for i in index[base][last]]
    return LinearModel(
        time, loop.period, tuple(named), tuple(inputs), tuple(outputs),
        A[np.ix_(last, last)], G[base][last], C[:, last], loop.J,
        {m.name: m.error for m in loop.components},
    )  # fmt: skip


def _read(F: Matrix, H: Matrix) -> NDArray[np.bool_]:
    """A mask of the states that outputs or other states depend on, directly or indirectly."""
    kept = np.ones(len(F), bool)
    while True:
        read = np.any(F[kept] != 0.0, axis=0) | np.any(H != 0.0, axis=0)
        if (kept <= read).all():
            return kept
        kept &= read


def _basis(rows: Matrix, held: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask of the rows that are states: rows not held, and held ones that do not follow from
    them.
    """
    base = ~held
    for some, columns in pieces(rows, held):
        part = rows[np.ix_(some, columns)]
        for i in np.flatnonzero(held[some]):
            row = part[i]
            if _rest(part[base[some]], row) > COMBINED * float(np.linalg.norm(row)):
                base[some[i]] = True
    return base


def _rest(rows: Matrix, row: Matrix) -> float:
    scale = np.linalg.norm(rows, axis=1)
    scaled = rows / np.where(scale > 0.0, scale, 1.0)[:, None]
    factors = np.linalg.lstsq(scaled.T, row, rcond=None)[0]
    return float(np.linalg.norm(factors @ scaled - row))


def _combinations(rows: Matrix, base: NDArray[np.bool_]) -> Matrix:
    """The factors with which the other rows follow from those of `base`, (rest, base)."""
    found = np.zeros((np.count_nonzero(~base), np.count_nonzero(base)))
    place = np.where(base, np.cumsum(base), np.cumsum(~base)) - 1  # of each row among its kind
    for some, columns in pieces(rows, ~base):
        part, mine = rows[np.ix_(some, columns)], base[some]
        scale = np.linalg.norm(part[mine], axis=1)
        scale = np.where(scale > 0.0, scale, 1.0)
        scaled = (part[mine] / scale[:, None]).T
        factors = np.linalg.lstsq(scaled, part[~mine].T, rcond=None)[0]
        found[np.ix_(place[some[~mine]], place[some[mine]])] = factors.T / scale
    return found
