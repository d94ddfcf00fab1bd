"""Two equal joints that follow each other with delay: roots, onset and limit cycle, without a run.

Each joint is one of ``fmus.models.elastic_joint``, whose references are the motion of the other a
time T ago, and whose friction is compensated with its own velocity a time T_o ago. In the
difference of the two (sign -1) and in their sum (sign +1), with their motion x::

    dx/dt = A x + sign B x(t - T) + C x(t - T_o)

The rigid joint of inertia M without friction is stable in the difference up to (T_o plays no part)::

    T* = (2 / w) atan(D w / K),   w = sqrt(2 K / M)          M s^2 + (D s + K)(1 + exp(-s T)) = 0

An oscillation that a limit of the torque stops has the frequency at which the loop is on its border
with the torque scaled by a factor N < 1; the describing function of the limit gives the torque that
belongs to N, and the dynamics of the joint the motion.

Source: own construction; T* is the exact border of the rigid case. Roots: D. Breda, S. Maset, R.
Vermiglio, "Pseudospectral differencing methods for characteristic roots of delay differential
equations", SIAM J. Scientific Computing 27(2), 2005. Describing function of a limit: J.-J. E.
Slotine, W. Li, "Applied Nonlinear Control", 1991, Sec. 5.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, atan, pi, sqrt
from typing import NamedTuple, final

from fmus.models import elastic_joint
from fmus.numeric import Array, np
from fmus.reference import Values

_STATES = 6  # of a joint
_NODES = 16  # of the motion during a delay


class Mode(NamedTuple):
    """The least damped motion: `growth`, 1/s, positive if unstable, and `frequency`, Hz."""

    growth: float
    frequency: float


class Cycle(NamedTuple):
    """A limit cycle: `frequency`, Hz, and amplitudes of `torque`, N.m, and joint, `angle`, rad."""

    frequency: float
    torque: float
    angle: float


def rigid_limit(K: float, D: float, M: float) -> float:
    """T*, s, of the stiffness `K` (N.m/rad), damping `D` (N.m.s/rad) and inertia `M` (kg.m2)."""
    omega = sqrt(2.0 * K / M)
    return 2.0 / omega * atan(D * omega / K)


@final
@dataclass(frozen=True, slots=True)
class Pair:
    """Two joints with the same parameters: those of ``elastic_joint`` for one joint, each (1,).

    Friction is linear here, with the slope that tanh has at rest.
    """

    values: Values

    def mode(self, delay: float, own: float, scale: float = 1.0) -> Mode:
        """The least damped motion of the pair.

        `delay`, `own`: T and T_o, s; `scale`: factor N of the torque of the drive. The sum of the
        pair can move without a force: its root at 0 does not count.
        """
        found = []
        A, b = self._passive(), self._response_to_torque()
        for sign in (-1.0, 1.0):
            s = roots(A, b, *self._gains(sign, scale), delay, own)
            s = s[(np.abs(s) > 1.0) & (s.imag >= 0.0)]
            found += [Mode(float(x.real), float(x.imag) / (2 * pi)) for x in s]
        return max(found)

    def onset(self, own: float, longest: float = 0.1) -> tuple[float, float]:
        """The least delay T, s, at which the pair is unstable, and the frequency, Hz.

        `longest`: the greatest delay that is looked at; beyond, (inf, nan). `own`: T_o, s.
        """
        step = 0.5e-3
        delays = np.arange(step, longest, step)
        for T in delays:
            if self.mode(float(T), own).growth > 0.0:
                low, high = float(T) - step, float(T)
                for _ in range(12):
                    middle = 0.5 * (low + high)
                    if self.mode(middle, own).growth > 0.0:
                        high = middle
                    else:
                        low = middle
                return high, self.mode(high, own).frequency
        return float("inf"), float("nan")

    def cycle(self, delay: float, own: float) -> Cycle | None:
        """The limit cycle at `tau_max`, from describing functions; None if stable or unlimited."""
        if self.mode(delay, own).growth <= 0.0 or self.mode(delay, own, 1e-3).growth > 0.0:
            return None
        low, high = 1e-3, 1.0  # of the factor: stable, unstable
        for _ in range(30):
            middle = sqrt(low * high)
            low, high = (middle, high) if self.mode(delay, own, middle).growth <= 0.0 else (
                low, middle,
            )  # fmt: skip
        frequency = self.mode(delay, own, high).frequency
        torque = high * _input_over_limit(high) * float(self.values["tau_max"][0])
        return Cycle(frequency, torque, torque / abs(self.stiffness(2j * pi * frequency)))

    def stiffness(self, s: complex) -> complex:
        """Torque of the drive over the motion of the motor at `s`, 1/s; N.m/rad."""
        A, b = self._passive(), self._response_to_torque()
        return complex(1.0 / np.linalg.solve(s * np.eye(_STATES) - A, b)[0])

    def _passive(self) -> Array:
        """The matrix of the joint without its drive, (6, 6)."""
        x = {**self.values, "friction": np.zeros(1)}
        x["damping"] = self.values["damping"] + self.values["friction"] / self.values["v_f"]
        zero = np.zeros(1)
        columns = [elastic_joint.rate(x, y[:, None], zero, zero)[:, 0] for y in np.eye(_STATES)]
        return np.array(columns).T

    def _response_to_torque(self) -> Array:
        """The rate of the state by one N.m of the drive, (6,)."""
        rest = np.zeros((_STATES, 1))
        return elastic_joint.rate(self.values, rest, np.ones(1), np.zeros(1))[:, 0]

    def _gains(self, sign: float, scale: float) -> tuple[Array, Array, Array]:
        """Torque per position and velocity: of the joint now, of the other, of its own past."""
        x = self.values
        spring = scale * np.array([x["K_p"][0], x["K_d"][0]])
        slope = scale * float((x["F_v"] + x["F_c"] / x["v_c"])[0])
        return -spring, sign * spring, np.array([0.0, slope])


def roots(A: Array, b: Array, now: Array, past: Array, own: Array, T: float, T_o: float) -> Array:
    """Characteristic roots, 1/s, of dx/dt = (A + b now) x + b past x(t - T) + b own x(t - T_o).

    A (n, n), b (n,); `now`, `past`, `own` (2,): gains of the first two states; delays in s. They
    are eigenvalues of the motion of these states at Chebyshev points of the longest delay.
    """
    longest, n = max(T, T_o, 1e-6), len(A)
    k = np.arange(_NODES + 1)
    at = 0.5 * longest * (np.cos(pi * k / _NODES) - 1.0)  # 0 to -longest
    c = np.where((k == 0) | (k == _NODES), 2.0, 1.0) * (-1.0) ** k
    apart = at[:, None] - at[None, :] + np.eye(_NODES + 1)
    slope = np.outer(c, 1.0 / c) / apart
    slope -= np.diag(slope.sum(axis=1))
    history = np.kron(slope[1:], np.eye(2))  # rates of the states in the past
    whole = np.zeros((n + 2 * _NODES, n + 2 * _NODES))
    whole[:n, :n] = A
    whole[:n, :2] += np.outer(b, now)
    whole[n:, :2], whole[n:, n:] = history[:, :2], history[:, 2:]
    for gains, delay in ((past, T), (own, T_o)):
        acts = np.kron(_weights(at, c, -delay), gains[None, :])[0]
        whole[:n, :2] += np.outer(b, acts[:2])
        whole[:n, n:] += np.outer(b, acts[2:])
    return np.linalg.eigvals(whole)


def _weights(at: Array, c: Array, t: float) -> Array:
    """Barycentric weights (1, nodes) of the values at `at` for the value at `t`."""
    distance = t - at
    if (hit := np.abs(distance) < 1e-12).any():
        return hit[None, :].astype(np.float64)
    w = 1.0 / (c * distance)
    return (w / w.sum())[None, :]


def _input_over_limit(N: float) -> float:
    """The amplitude over the limit, of a sine whose limited form has N times its fundamental."""
    low, high = 1.0, 4.0 / (pi * N) + 1.0
    for _ in range(60):
        r = 0.5 * (low + high)
        found = 2.0 / pi * (asin(1.0 / r) + sqrt(1.0 - 1.0 / r**2) / r)
        low, high = (r, high) if found > N else (low, r)
    return low
