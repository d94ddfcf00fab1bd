"""Two equal joints that follow each other with delay: roots, onset and limit cycle, without a run.

Each joint is one of ``fmus.models.elastic_joint``, whose references are the motion of the other a
time T ago, and whose friction is compensated with its own velocity a time T_o ago. In the
difference of the two (sign -1) and in their sum (sign +1), with their motion x::

    dx/dt = A x + sign B x(t - T) + C x(t - T_o)

The rigid joint of inertia M without friction is stable in the difference up to T*::

    T* = (2 / w) atan(D w / K),   w = sqrt(2 K / M)          M s^2 + (D s + K)(1 + exp(-s T)) = 0

An oscillation that grows ends where the limit of the torque and the dry friction, compensated or
not, leave the loop on its border: they act by their describing functions, which depend on the
amplitude.

Source: own construction; T* is the exact border of the rigid case. Roots: D. Breda, S. Maset, R.
Vermiglio, "Pseudospectral differencing methods for characteristic roots of delay differential
equations", SIAM J. Scientific Computing 27(2), 2005. Describing function of a limit: J.-J. E.
Slotine, W. Li, "Applied Nonlinear Control", 1991, Sec. 5.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, atan, pi, sqrt
from typing import NamedTuple, final

from numpy.typing import NDArray

from fmus.build.reference import Values
from fmus.model.numeric import Array, np
from fmus.models import elastic_joint

_STATES = 6  # of a joint
_NODES = 16  # of the motion during a delay


class LeastDamped(NamedTuple):
    """The least damped motion: `growth`, 1/s, positive if unstable, and `frequency`, Hz."""

    growth: float
    frequency: float


class LimitCycle(NamedTuple):
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
class CoupledJoints:
    """Two joints with the same parameters: those of ``elastic_joint`` for one joint, each (1,)."""

    values: Values

    def mode(self, delay: float, own: float, amplitude: float = 0.0) -> LeastDamped:
        """The least damped motion of the pair; with an `amplitude` of the joints, rad, that motion.

        `delay`, `own`: T and T_o, s. The sum of the pair can move without a force: its root at 0
        does not count.
        """
        found = self._least_damped(delay, own, 1.0, 0.0)
        for _ in range(4 if amplitude > 0.0 else 0):  # the frequency decides the velocity
            omega = 2 * pi * found.frequency
            torque = amplitude * abs(self.stiffness(1j * omega, amplitude * omega))
            scale = _limited_gain(torque / float(self.values["tau_max"][0]))
            found = self._least_damped(delay, own, scale, amplitude * omega)
        return found

    def onset(self, own: float = 0.0, longest: float = 0.1) -> tuple[float, float]:
        """The delay T, s, from which on the pair vibrates, and its frequency there, Hz.

        `longest`: the greatest delay that is looked at; beyond, (inf, nan). T_o is T + `own`, s.
        """
        step = 1e-3
        for low in np.arange(2 * step, longest, step):
            if self.mode(low + step, low + step + own).growth > 0.0:
                low, high = float(low), float(low) + step
                for _ in range(12):
                    middle = 0.5 * (low + high)
                    stable = self.mode(middle, middle + own).growth <= 0.0
                    low, high = (middle, high) if stable else (low, middle)
                return high, self.mode(high, high + own).frequency
        return float("inf"), float("nan")

    def cycle(self, delay: float, own: float, largest: float = 1.0) -> LimitCycle | None:
        """The limit cycle at which a small oscillation ends, by describing functions.

        None if it decays, or is not stopped below the amplitude `largest`, rad.
        """
        if self.mode(delay, own).growth <= 0.0:
            return None
        low = 1e-6
        for high in np.geomspace(1e-5, largest, 60):
            if self.mode(delay, own, float(high)).growth <= 0.0:
                break
            low = float(high)
        else:
            return None
        for _ in range(12):
            middle = sqrt(low * high)
            grows = self.mode(delay, own, middle).growth > 0.0
            low, high = (middle, high) if grows else (low, middle)
        frequency = self.mode(delay, own, low).frequency
        omega = 2 * pi * frequency
        return LimitCycle(frequency, low * abs(self.stiffness(1j * omega, low * omega)), low)

    def stiffness(self, s: complex, velocity: float = 0.0) -> complex:
        """Torque of the drive over the motion of the motor at `s`, 1/s; N.m/rad.

        `velocity`: the amplitude of the velocity, rad/s, on which dry friction depends.
        """
        A, b = self._passive(velocity), self._response_to_torque()
        return complex(1.0 / np.linalg.solve(s * np.eye(_STATES) - A, b)[0])

    def _least_damped(self, delay: float, own: float, scale: float, velocity: float) -> LeastDamped:
        """With the torque times `scale`, and dry friction for the amplitude `velocity`, rad/s."""
        found = []
        A, b = self._passive(velocity), self._response_to_torque()
        for sign in (-1.0, 1.0):
            s = roots(A, b, *self._gains(sign, scale, velocity), delay, own)
            s = s[(np.abs(s) > 1.0) & (s.imag >= 0.0)]
            found += [LeastDamped(float(x.real), float(x.imag) / (2 * pi)) for x in s]
        return max(found)

    def _passive(self, velocity: float) -> Array:
        """The matrix of the joint without its drive, (6, 6)."""
        x = {**self.values, "friction": np.zeros(1)}
        x["damping"] = x["damping"] + self._slope("friction", "v_f", velocity)
        zero = np.zeros(1)
        columns = [elastic_joint.rate(x, y[:, None], zero, zero)[:, 0] for y in np.eye(_STATES)]
        return np.array(columns).T

    def _slope(self, torque: str, at: str, velocity: float) -> float:
        """F tanh(dq / v) for a sine of dq, by its describing function, N.m.s/rad."""
        F, v = float(self.values[torque][0]), float(self.values[at][0])
        return F / v * _tanh_gain(velocity / v)

    def _response_to_torque(self) -> Array:
        """The rate of the state by one N.m of the drive, (6,)."""
        rest = np.zeros((_STATES, 1))
        return elastic_joint.rate(self.values, rest, np.ones(1), np.zeros(1))[:, 0]

    def _gains(self, sign: float, scale: float, velocity: float) -> tuple[Array, Array, Array]:
        """Torque per position and velocity: of the joint now, of the other, of its own past."""
        x = self.values
        spring = scale * np.array([x["K_p"][0], x["K_d"][0]])
        slope = scale * (float(x["F_v"][0]) + self._slope("F_c", "v_c", velocity))
        return -spring, sign * spring, np.array([0.0, slope])


def roots(
    A: Array, b: Array, now: Array, past: Array, own: Array, T: float, T_o: float
) -> NDArray[np.complex128]:
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
    return np.asarray(np.linalg.eigvals(whole), dtype=np.complex128)


def _weights(at: Array, c: Array, t: float) -> Array:
    """Barycentric weights (1, nodes) of the values at `at` for the value at `t`."""
    distance = t - at
    if (hit := np.abs(distance) < 1e-12).any():
        return hit[None, :].astype(np.float64)
    w = 1.0 / (c * distance)
    return np.asarray(w / w.sum())[None, :]


def _limited_gain(torque: float) -> float:
    """The gain of a limit whose output has a fundamental of `torque` limits; 0 where none has."""
    if torque <= 1.0:
        return 1.0
    if torque >= 4.0 / pi:
        return 0.0
    low, high = 1.0, 1e6  # of the input over the limit
    for _ in range(60):
        r = sqrt(low * high)
        low, high = (r, high) if r * _limit(r) < torque else (low, r)
    return _limit(low)


def _limit(r: float) -> float:
    """The describing function of a limit for an input of `r` > 1 limits."""
    return 2.0 / pi * (asin(1.0 / r) + sqrt(1.0 - 1.0 / r**2) / r)


def _tanh_gain(x: float) -> float:
    """The fundamental of tanh(x sin) over x; 1 for x = 0."""
    if x < 1e-6:
        return 1.0
    sine = np.sin(2 * pi * (np.arange(64) + 0.5) / 64)
    return float(2.0 * np.mean(np.tanh(x * sine) * sine) / x)
