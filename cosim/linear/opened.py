"""A loop with its links cut: a small linear model, from which all delays follow.

The states on their way over links make the model of a whole loop large, and other delays need
another model. Cut at its links the loop has few states, whatever the delays::

    x[k+1] = A x[k] + B u[k]        u: what receivers hold, then other inputs
    y[k]   = C x[k] + D u[k]        y: what is sent, then other outputs

With each link closed by a constant delay, u = Δ(z) y, where the entries of Δ are powers of 1/z, the
loop has the poles at which det(1 - Δ(z) (C (z - A)⁻¹ B + D)) = 0. The number of those outside of a
circle is that of A there, less the turns of the determinant about 0 along the circle (Nyquist).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cosim.base.convert import Struct
from cosim.base.errors import RunError
from cosim.linear.component import Matrix, StepDerivatives
from cosim.linear.determinants import Determinants
from cosim.linear.loop import CutLink, KnownDerivatives, OperatingPoint, cut_loop
from cosim.linear.model import reduced
from cosim.linear.pieces import Index, pieces
from cosim.schedule.parts import Slot
from cosim.schedule.plan import Plan

Complex = NDArray[np.complex128]
#: Change of a value for the differences, in its unit, relative above 1.
SIZE = 1e-4
#: Relative singular value below which a direction counts as neutral.
NEUTRAL = 1e-6
#: The least and the greatest number of first points on half a circle, and rounds of more points.
_FEW, _MANY, _ROUNDS = 40, 3000, 24
#: The largest change of the logarithm of the determinant from one point to the next.
_STEP = 0.8
#: The share of an angle over which a slope is taken, of at least so many rad.
_SLOPE, _LEAST = 1e-6, 1e-3
#: Places at which a pole is looked for, and steps of Newton's method, more for a double zero.
_GUESSES, _NEWTON = 8, 60
#: A motion that is made smaller again.
_HUGE = 1e60
#: Norm of the open loop below which the determinant cannot turn about 0.
_SMALL = 0.3


class OpenLoop(Struct, frozen=True):
    """A sampled loop near an operating point at `time` (s), its links cut, over a period of `ticks`
    base steps of `h` (s).

    A (n, n), B (n, m), C (p, n), D (p, m); the first inputs and outputs are those of `links`
    (see :class:`CutLink`), in their order; the others are `inputs` and `outputs`. `states`,
    `inputs` and `outputs` are pairs of name and unit. `components`: the derivatives of each step;
    their `error` is near 1 at an edge, where there is no linear model. `speed`: the greatest change
    of a state in the period, in its unit a second; 0 at an equilibrium.

    A delay is a number of base steps d for each link: a look at tick t holds the newest sample
    sent at tick t - d or before.
    """

    time: float
    h: float
    ticks: int
    states: tuple[tuple[str, str], ...]
    links: tuple[CutLink, ...]
    inputs: tuple[tuple[str, str], ...]
    outputs: tuple[tuple[str, str], ...]
    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    components: tuple[StepDerivatives, ...]
    speed: float = 0.0

    @property
    def period(self) -> float:
        """The time from k to k + 1, s."""
        return self.ticks * self.h

    @property
    def held(self) -> int:
        """The number of inputs that are held values of links."""
        return sum(c.held.size for c in self.links)

    @property
    def sent(self) -> int:
        """The number of outputs that are values sent over links."""
        return sum(c.sent.size for c in self.links)

    def sources(self, delays: Sequence[int]) -> tuple[Index, Index]:
        """The output that each held input is, (held,), and how many periods before, (held,)."""
        which, before = np.empty(self.held, np.intp), np.empty(self.held, np.intp)
        for link, delay in zip(self.links, delays, strict=True):
            for i, places in enumerate(link.held):
                sample = (i * link.look - delay) // link.send  # of this period: 0, 1, ...
                back, number = divmod(sample, len(link.sent))
                which[places], before[places] = link.sent[number], -back
        return which, before

    def closed(self, delays: Sequence[int]) -> tuple[Matrix, list[str]]:
        """F of z[k+1] = F z[k] with every link closed, and the names of z.

        z is x, then what was sent one period before, two periods before, and so on, as far as it
        is needed.
        """
        which, before = self.sources(delays)
        n, p, depth = len(self.A), self.sent, int(before.max(initial=0))
        now, past = np.zeros((self.held, p)), np.zeros((self.held, n + depth * p))
        for u, (y, back) in enumerate(zip(which, before, strict=True)):
            if back:
                past[u, n + (back - 1) * p + y] = 1.0
            else:
                now[u, y] = 1.0
        B, C, D = self.B[:, : self.held], self.C[:p], self.D[:p, : self.held]
        direct = np.hstack([C, np.zeros((p, depth * p))]) + D @ past
        sent = np.asarray(np.linalg.solve(np.eye(p) - D @ now, direct))
        F = np.zeros((n + depth * p, n + depth * p))
        F[:n, :n] = self.A
        F[:n] += B @ (now @ sent + past)
        if depth:
            F[n : n + p] = sent
            F[n + p :, n:-p] = np.eye((depth - 1) * p)
        names = [name for c in self.links for name in [c.name] * c.sent.size]
        late = [f"{name} ({j + 1} before)" for j in range(depth) for name in names]
        return F, [*(name for name, _ in self.states), *late]

    # ---- equilibria beside the one of the model --------------------------------------------------

    def neutral(self) -> tuple[Matrix, Matrix]:
        """Directions X (n, k) and Y (sent, k) of other equilibria: x = X a, y = Y a stays so.

        Robots that agree elsewhere, or estimates that do not act. The delays do not matter, because
        what is sent is constant. The columns of X are orthonormal.
        """
        A, _, C, _ = self._wired()
        M = A - np.eye(len(A))
        scale = np.linalg.norm(M, axis=1)
        _, values, rows = np.linalg.svd(M / np.where(scale > 0.0, scale, 1.0)[:, None])
        X = rows[values <= NEUTRAL * values.max(initial=1.0)].T
        return X, C @ X

    def _wired(self) -> tuple[Matrix, Matrix, Matrix, Matrix]:
        """The model with u = y + w, w the input: a receiver holds what is sent last."""
        p, m = self.sent, self.held
        last, _ = self.sources([0] * len(self.links))
        E = np.zeros((m, p))
        E[np.arange(m), last] = 1.0
        B, C, D = self.B[:, :m], self.C[:p], self.D[:p, :m]
        back = np.linalg.inv(np.eye(p) - D @ E)
        C, D = back @ C, back @ D
        return self.A + B @ E @ C, B + B @ E @ D, C, D

    def differences(self) -> Differences:
        """The loop without its neutral directions, from lateness to increments; see there."""
        A, B, C, D = self._wired()
        X, Y = self.neutral()
        n, p = len(A), len(C)
        whole = np.zeros((n + p, n + p))
        whole[:n, :n], whole[n:, :n] = A, C
        gone = np.vstack([X, Y])
        Q = np.linalg.svd(gone, full_matrices=True)[0][:, gone.shape[1] :]
        late = np.vstack([B, D])
        less = np.hstack([C, -np.eye(p)])
        return Differences(Q, Q.T @ whole @ Q, Q.T @ late, less @ Q, D)

    # ---- poles -----------------------------------------------------------------------------------

    def unstable(self, delays: Sequence[int], growth: float = 0.0) -> int:
        """The number of poles that grow faster than exp(`growth` t), 1/s, with constant delays.

        Raises RunError if a pole is too near to that, so that it cannot be counted.
        """
        radius = float(np.exp(growth * self.period))
        alone = int(np.count_nonzero(np.abs(_eigenvalues(self.A)) > radius))
        return alone - self._turns(_Return(self, delays), radius)

    def drawn_growth(self, rows: Sequence[Index]) -> float:
        """The growth of small motions, 1/s, while links hold the samples that they draw.

        `rows`: of each link the number of the sample that is held at each look from the start on,
        (looks,), -1: none yet. All begins somewhere, and what moves is fitted by a line in the
        logarithm of its speed.
        """
        r = [len(link.held) for link in self.links]
        periods = min((len(x) // n for x, n in zip(rows, r, strict=True)), default=0)
        sample, place = np.full((2, periods, self.held), -1, np.intp)
        for link, held, n in zip(self.links, rows, r, strict=True):
            number = held[: periods * n].reshape(periods, n, 1)
            at = link.held.reshape(-1)
            sample[:, at] = np.repeat(number // len(link.sent), link.held.shape[1], 2).reshape(
                periods, -1
            )
            place[:, at] = link.sent[number[:, :, 0] % len(link.sent)].reshape(periods, -1)
        m, p = self.held, self.sent
        B, C, D = self.B[:, :m], self.C[:p], self.D[:p, :m]
        x, y = np.random.default_rng(0).standard_normal(len(self.A)), np.zeros((periods + 1, p))
        moved, scale = np.empty(periods), 0.0
        for k in range(periods):
            for _ in range(2):  # what is sent in this period may be held in it
                u = np.where(sample[k] < 0, 0.0, y[sample[k], place[k]])
                y[k] = C @ x + D @ u
            last, x = x, self.A @ x + B @ u
            size = float(np.abs(x - last).max())
            moved[k] = np.log(max(size, 1e-300)) + scale
            if size > _HUGE:
                x, y, scale = x / _HUGE, y / _HUGE, scale + float(np.log(_HUGE))
        if periods < 10:
            return float("nan")
        parts = [float(part.max()) for part in np.array_split(moved[periods // 5 :], 10)]
        middles = 0.08 * periods * self.period * np.arange(10)
        return float(np.polyfit(middles, parts, 1)[0])

    def _turns(self, back: _Return, radius: float) -> int:
        """The turns of the determinant about 0 along a circle, counter-clockwise.

        From one point to the next its logarithm may change by :data:`_STEP`, and by twice of that
        with the slope at either end: a double zero beside the circle turns it by 2 pi.
        """
        if not back.size:
            return 0
        turned = float(_steps(self._around(back, radius)[1]).imag.sum()) / np.pi
        if not abs(turned - round(turned)) < 0.05:
            raise RunError("a pole is too near to the circle to be counted")
        return round(turned)

    def _around(self, back: _Return, radius: float) -> tuple[Matrix, Complex, Matrix]:
        """Angles (k,), rad, close enough to each other, the logarithm there, and its slope."""
        angle = self._angles(radius, min(_MANY, max(_FEW, 3 * back.depth)))
        log, slope, norm = back.logarithm(radius, angle)
        for _ in range(_ROUNDS):
            if not (np.isfinite(log).all() and np.isfinite(norm).all()):
                raise RunError("a pole is too near to the circle to be counted")
            gap = np.diff(angle)
            fast = np.maximum(slope[1:], slope[:-1]) * gap > 2.0 * _STEP
            near = np.maximum(norm[1:], norm[:-1]) > _SMALL
            split = near & (gap * back.depth > 2.0) | fast | (np.abs(_steps(log)) > _STEP)
            split &= gap > 1e-12
            if not split.any():
                break
            if len(angle) + np.count_nonzero(split) > 20 * _MANY:
                raise RunError("the poles are too many to be counted")
            at = np.flatnonzero(split) + 1
            middle = 0.5 * (angle[at - 1] + angle[at])
            more = back.logarithm(radius, middle)
            angle = np.insert(angle, at, middle)
            log, slope, norm = (
                np.insert(old, at, new) for old, new in zip((log, slope, norm), more, strict=True)
            )
        return angle, log, slope

    def fastest(self, delays: Sequence[int], growth: float) -> tuple[complex, str]:
        """The pole that grows the fastest, 1/s, of a loop with one that grows faster than `growth`,
        and the state with the greatest part in it.

        Its growth is found by counting, then it is the zero of the determinant (Newton) that begins
        where the circle of that growth passes it; nan and "" if it is not found. Raises RunError.
        """
        low, high = growth, 4.0 * growth
        while self.unstable(delays, high):
            low, high = high, 4.0 * high
        while high > 1.05 * low:
            middle = float(np.sqrt(low * high))
            low, high = (middle, high) if self.unstable(delays, middle) else (low, middle)
        back, T = _Return(self, delays), self.period
        if back.size:
            angle, _, slope = self._around(back, float(np.exp(low * T)))
            for i in np.argsort(-slope)[:_GUESSES]:
                s = back.zero(complex(low, float(angle[i]) / T), T)
                if s is not None and 0.9 * low < s.real < 1.1 * high:
                    part = np.abs(back.states(np.exp(s * T)))
                    return complex(s.real, abs(s.imag)), self.states[int(part.argmax())][0]
        z, vectors = np.linalg.eig(self.A)  # a pole that no link takes part in
        i = int(np.argmax(np.abs(z)))
        pole = complex(np.log(complex(z[i]))) / T
        if not 0.9 * low < pole.real < 1.1 * high:
            return complex(low, float("nan")), ""
        return complex(pole.real, abs(pole.imag)), self.states[int(np.abs(vectors[:, i]).argmax())][
            0
        ]

    def _angles(self, radius: float, many: int) -> Matrix:
        """The first angles: closer to z = 1, where neutral poles are, and to poles of the open loop
        beside the circle.
        """
        least = min(1e-3, np.pi / many) * self.period
        first = 0.0 if radius != 1.0 else least  # it is real at angle 0, but for neutral poles
        poles = np.log(_eigenvalues(self.A) / radius)
        poles = poles[(np.abs(poles.real) < np.pi / _FEW) & (poles.imag > 0.0)]
        away = np.maximum(np.abs(poles.real), least)[:, None] * 2.0 ** np.arange(-1, 8)
        beside = poles.imag[:, None] + np.hstack([-away, away])
        angle = np.concatenate([
            np.geomspace(least, np.pi, _FEW), np.linspace(0.0, np.pi, _FEW), beside.reshape(-1)
        ])  # fmt: skip
        found = np.sort(np.append(angle[(angle >= least) & (angle <= np.pi)], first))
        return found[np.diff(found, prepend=-1.0) > 0.0]  # numpy.unique would import numpy.ma

    def response(self, delays: Sequence[int], z: Complex) -> Complex:
        """Gain from `inputs` to `outputs` at `z` (k,) with every link closed, (k, outputs, inputs).

        The inputs are held for a period.
        """
        return _Return(self, delays).response(z)


def _steps(log: Complex) -> Complex:
    """Differences of logarithms from one to the next, the short way about 0."""
    step = np.diff(log)
    turn = np.remainder(step.imag + np.pi, 2 * np.pi) - np.pi
    return np.asarray(step.real + 1j * turn)


class Differences(Struct, frozen=True):
    """x[k+1] = `A` x[k] + `B` w[k], v[k] = `C` x[k] + `D` w[k] without the neutral directions.

    v is the increase of what is sent from one period to the next, w what a receiver holds less what
    is sent last. A delay of d periods (one look and one sample in each) is w[k] = -(v[k] + ... +
    v[k-d+1]), d of them, constant or not: the loop is stable if that is stable. `basis`
    (n + sent, .): x stands for basis @ x of the states of the open loop and of what was sent one
    period before.
    """

    basis: Matrix
    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix


def _blocks(A: Matrix) -> Iterator[tuple[Index, Matrix]]:
    """The states of each part of A that no other states act on, and its matrix."""
    linked = (A != 0.0) | (A.T != 0.0) | np.eye(len(A), dtype=bool)
    for some, _ in pieces(linked.astype(float), np.ones(len(A), bool)):
        yield some, A[np.ix_(some, some)]


def _eigenvalues(A: Matrix) -> Complex:
    """The eigenvalues of A, those of equal blocks found once."""
    known: dict[bytes, Complex] = {}
    found = [np.zeros(0, np.complex128)]
    for _, block in _blocks(A):
        if (key := block.tobytes()) not in known:
            known[key] = np.linalg.eigvals(block).astype(np.complex128)
        found.append(known[key])
    return np.concatenate(found)


def _alike(rows: Matrix) -> Index:
    """The number of the first row equal to each of `rows` (n, m), (n,)."""
    i, j = np.nonzero(rows)
    ends = np.searchsorted(i, np.arange(len(rows) + 1)).tolist()
    value, first = rows[i, j], dict[tuple[bytes, bytes], int]()
    parts = [(j[a:b].tobytes(), value[a:b].tobytes()) for a, b in pairwise(ends)]
    return np.array([first.setdefault(part, n) for n, part in enumerate(parts)], np.intp)


def _added(columns: Matrix, index: Index, size: int) -> Matrix:
    """The sums (n, size) of the columns (n, m) that have the same `index` (m,)."""
    found = np.zeros((size, len(columns)))
    np.add.at(found, index, columns.T)
    return found.T


class _Entries:
    """The entries of C (z - A)⁻¹ B + D that are not 0 everywhere: `rows` and `columns` (e,).

    Robots that are alike and in the same posture have blocks of the same numbers, which are
    computed once.
    """

    def __init__(
        self, blocks: Sequence[tuple[Index, Matrix]], B: Matrix, C: Matrix, D: Matrix
    ) -> None:
        known: dict[tuple[bytes, ...], int] = {}
        self._kinds: list[tuple[Matrix, Matrix, Matrix]] = []
        kinds, places = list[int](), [np.flatnonzero(D)]
        for some, A in blocks:
            into, out = np.flatnonzero(B[some].any(axis=0)), np.flatnonzero(C[:, some].any(axis=1))
            if not len(into) or not len(out):
                continue
            kind = A, B[np.ix_(some, into)], C[np.ix_(out, some)]
            key = tuple(x.tobytes() for x in kind)
            if key not in known:
                known[key] = len(self._kinds)
                self._kinds.append(kind)
            kinds.append(known[key])
            places.append((out[:, None] * D.shape[1] + into).reshape(-1))
        every = np.array(sorted(set(np.concatenate(places).tolist())), np.intp)
        self.rows, self.columns = np.divmod(every, max(D.shape[1], 1))
        self._direct = D[self.rows, self.columns]
        at = [np.searchsorted(every, place) for place in places[1:]]
        self._places = list(zip(kinds, at, strict=True))

    def values(self, z: Complex) -> Complex:
        """The entries at `z` (k,), (k, e)."""
        parts = []
        for A, B, C in self._kinds:
            M = z[:, None, None] * np.eye(len(A)) - A
            reached = C @ np.linalg.solve(M, np.broadcast_to(B, (len(z), *B.shape)))
            parts.append(reached.reshape(len(z), len(C) * B.shape[1]))
        found = np.tile(self._direct.astype(np.complex128), (len(z), 1))
        for kind, at in self._places:
            found[:, at] += parts[kind]
        return found


class _Return:
    """Δ(z) (C (z - A)⁻¹ B + D), with one row for each value and its delay."""

    def __init__(self, loop: OpenLoop, delays: Sequence[int]) -> None:
        which, before = loop.sources(delays)
        p, m = loop.sent, loop.held
        alike = _alike(np.hstack([loop.C[:p], loop.D[:p]]))
        pairs = list(zip(alike[which].tolist(), before.tolist(), strict=True))
        place = {pair: i for i, pair in enumerate(dict.fromkeys(pairs))}
        index = np.array([place[pair] for pair in pairs], np.intp)
        first = np.array([y for y, _ in place], np.intp)
        self.size, self.back = len(first), np.array([float(back) for _, back in place])
        self.depth = int(self.back.max(initial=0)) + 1
        self._B = np.hstack([_added(loop.B[:, :m], index, self.size), loop.B[:, m:]])
        self._C = np.vstack([loop.C[first], loop.C[p:]])
        D = np.vstack([loop.D[first], loop.D[p:]])
        self._D = np.hstack([_added(D[:, :m], index, self.size), D[:, m:]])
        self._blocks = list(_blocks(loop.A))
        links = slice(0, self.size)
        self._links = _Entries(self._blocks, self._B[:, links], self._C[links],
                               self._D[links, links])  # fmt: skip
        self._determinants = Determinants(self._links.rows, self._links.columns, self.size)

    def gain(self, z: Complex, inputs: slice, outputs: slice) -> Complex:
        """C (z - A)⁻¹ B + D of some inputs and outputs, (k, p, m)."""
        D, some, links = self._D[outputs, inputs], self._links, slice(0, self.size)
        if not inputs == outputs == links:
            some = _Entries(self._blocks, self._B[:, inputs], self._C[outputs], D)
        found = np.zeros((len(z), *D.shape), np.complex128)
        found[:, some.rows, some.columns] = some.values(z)
        return found

    def logarithm(self, radius: float, angle: Matrix) -> tuple[Complex, Matrix, Matrix]:
        """The logarithm of det(1 - Δ G) on a circle, the size of its slope, 1/rad, and the norm of
        Δ G, (k,) each, at angles (k,), rad. The slope counts as 0 where the norm is small.
        """
        log, norm = self._logarithm(radius, angle)
        slope, near = np.zeros(len(angle)), norm > _SMALL
        beside = _SLOPE * np.maximum(angle[near], _LEAST)
        change = np.stack([log[near], self._logarithm(radius, angle[near] + beside)[0]], axis=1)
        slope[near] = np.abs(_steps(change)[:, 0]) / beside
        return log, slope, norm

    def _logarithm(self, radius: float, angle: Matrix) -> tuple[Complex, Matrix]:
        z = radius * np.exp(1j * angle)
        backs = np.array(sorted(set(self.back.tolist())))
        late = (1.0 / z)[:, None] ** backs
        rows = np.searchsorted(backs, self.back)[self._links.rows]
        values = self._links.values(z) * late[:, rows]
        return self._determinants.logarithms(values), np.sqrt((np.abs(values) ** 2).sum(axis=1))

    def zero(self, s: complex, T: float) -> complex | None:
        """The zero of the determinant next to `s`, 1/s; None if Newton's steps do not end."""
        for _ in range(_NEWTON):
            if abs(s.real * T) > 1.0:
                return None
            angle = s.imag * T + _SLOPE * np.array([0.0, max(abs(s.imag * T), _LEAST)])
            log, _ = self._logarithm(float(np.exp(s.real * T)), angle)
            slope = complex(_steps(log)[0] / (angle[1] - angle[0])) * T / 1j
            if not np.isfinite(slope) or slope == 0.0:
                return s if np.isneginf(log[0].real) else None
            s -= 1.0 / slope
            if abs(slope * s) > 1.0 / _SLOPE:
                return s
        return None

    def states(self, z: complex) -> Complex:
        """The states, (n,), of the motion z^k, a zero of the determinant."""
        at, links = np.array([z]), slice(0, self.size)
        late = z ** -self.back[:, None]
        sent = np.linalg.svd(np.eye(self.size) - late * self.gain(at, links, links)[0])[2][-1]
        x = np.zeros(len(self._B), np.complex128)
        for some, A in self._blocks:
            x[some] = np.linalg.solve(z * np.eye(len(A)) - A, self._B[some, links] @ sent.conj())
        return x

    def response(self, z: Complex) -> Complex:
        """The gain from the other inputs to the other outputs, with the links closed."""
        links, rest = slice(0, self.size), slice(self.size, None)
        late = (1.0 / z)[:, None, None] ** self.back[:, None]
        direct = self.gain(z, rest, rest)
        if not self.size:
            return direct
        loop = np.eye(self.size) - late * self.gain(z, links, links)
        held = np.linalg.solve(loop, late * self.gain(z, rest, links))
        return np.asarray(direct + self.gain(z, links, rest) @ held)


def open_loop(
    plan: Plan,
    at: OperatingPoint,
    inputs: Sequence[Slot] = (),
    outputs: Sequence[Slot] = (),
    known: KnownDerivatives | None = None,
) -> OpenLoop:
    """The model of `plan` at an operating point with its links cut.

    `known`: derivatives that need not be made again.

    The locals that are states must be among the outputs of the plan's FMUs
    (:func:`cosim.linear.scenario.observed`). Raises RunError for a component that has no linear
    model, ScenarioError for a plan that has none.
    """
    loop, links = cut_loop(plan, at, inputs, outputs, SIZE, known)
    n_u, n_y = (sum(part.size for c in links for part in (getattr(c, name),))
                for name in ("held", "sent"))  # fmt: skip
    names = [(n, s.unit) for s in inputs for n in s.scalars()]
    ends = [(n, s.unit) for s in outputs for n in s.scalars()]
    found = reduced(loop, plan.time(at.tick), [("", "")] * n_u + names, [("", "")] * n_y + ends)
    places = [i for part in loop.components for s in part.states
              for i in range(s.start, s.start + s.size)]  # fmt: skip
    change = np.abs(at.signals[-1, places] - at.signals[0, places]).max(initial=0.0)
    return OpenLoop(
        found.time, plan.h, at.ticks, found.states, links, tuple(names), tuple(ends),
        found.A, found.B, found.C, found.D, loop.components, float(change) / (at.ticks * plan.h),
    )  # fmt: skip
