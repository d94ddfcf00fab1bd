"""Passivity of the port of coupled robots: the lambda_M with which its admittance is positive real.

With the estimate right, the impedance at the port is, in the Laplace variable p (matrices over
joints, see :mod:`cosim.predict.network`)::

    Z(p) = D + X(p)/(p + lambda_M)

D is the friction of the arm; X is what its own law and all other robots make of it, and does not
depend on lambda_M of the port. So one response of the network tells for every lambda_M whether
Z + Zᴴ has a negative eigenvalue at some frequency. For a fast hand, ω → ∞, the limit is

    lambda_M <= alpha + lambda_min((K + D) M⁻¹) + lambda Σ w

which is O9 and the couplings of the port. What comes back to the port, a round trip later, takes a
little of it away at slower motions. A weak coupling also has a least lambda_M.

Source: own construction from the linearised network.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np

from cosim.base.convert import Struct
from cosim.base.copies import replace
from cosim.predict import closed_form as closed
from cosim.predict.facts import Array, Vector
from cosim.predict.network import Complex, RobotNetwork

#: Frequencies, rad/s: evenly on a logarithmic scale, and evenly over some turns of an echo.
SPAN, COUNT, EVEN, TURNS = (1e-2, 1e4), 200, 200, 10
#: A negative real part that is no more than rounding, as a share of the impedance.
ROUNDING = 1e-9
#: Halvings of an interval in which a limit is, and the digits after the point that then count.
HALVINGS, DIGITS = 12, 3


class PassiveRange(Struct, frozen=True):
    """The lambda_M, 1/s, from `least` to `limit` with which a port is passive, theta known."""

    least: float
    limit: float

    def margin(self, lambda_M: float) -> float:
        """The distance of `lambda_M` to the nearer end, 1/s; below 0 where it is not passive."""
        above = lambda_M - self.least if self.least else np.inf
        return float(min(self.limit - lambda_M, above))


def passive_range(net: RobotNetwork, q: Sequence[float]) -> PassiveRange:
    """With which lambda_M the port of `net` is passive, all robots at `q` (m,).

    The delays of links count as constant, at their means. Of one robot this is O9. Of more than
    WHOLE coordinates it is the limit for a fast hand only, which no port exceeds.
    """
    alone, fast = _fast_limits(net, q)
    if fast == alone or len(net.laws) * len(q) > closed.WHOLE:
        return PassiveRange(0.0, fast)
    response = _Response.of(net, q)
    inside = [x for x in (net.law.lambda_M, alone, fast / 2, fast / 8) if response.passive(x)]
    if not inside:
        return PassiveRange(fast, fast)
    top = _edge(response, max(inside), fast) if max(inside) < fast else fast
    bottom = 0.0 if response.passive(0.0) else _edge(response, min(inside), 0.0)
    return PassiveRange(bottom, top)


def worst_posture(net: RobotNetwork) -> tuple[Vector, int]:
    """The posture of the workspace where O9 allows least, (m,) rad, and the joint of it."""
    arm = net.arms[net.port]
    _, joint, posture = arm.slowest(closed.damped(net.law.K, arm))
    return posture, joint


def _fast_limits(net: RobotNetwork, q: Sequence[float]) -> tuple[float, float]:
    """The limit of the robot at the port alone, and that of the network for a fast hand, 1/s."""
    law, arm = net.law, net.arms[net.port]
    M = arm.inertia(arm.parameters, q)
    alone = closed.passive_limit(law, M, closed.damped(law.K, arm))
    return alone, alone + float(net.around[net.port])


def _edge(response: _Response, inside: float, outside: float) -> float:
    """The last passive lambda_M on the way from `inside` to `outside`, 1/s."""
    for _ in range(HALVINGS):
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if response.passive(middle) else (inside, middle)
    return round(inside, DIGITS)


class _Response(Struct, frozen=True):
    """D (m, m) and X (k, m, m) at the frequencies `p` (k,), see the module."""

    p: Complex
    D: Array
    X: Complex

    @classmethod
    def of(cls, net: RobotNetwork, q: Sequence[float]) -> _Response:
        ages = tuple(replace(age, spread=()) for age in net.couplings.ages)
        still = replace(net, couplings=replace(net.couplings, ages=ages), periods=())
        omega = np.geomspace(*SPAN, COUNT)
        longest = 2 * max((age.mean for age in ages), default=0.0)
        if longest:
            even = np.arange(1, EVEN + 1) * (2 * pi * TURNS / longest / EVEN)
            omega = np.sort(np.concatenate([omega, even]))
        p = 1j * omega
        Z = np.linalg.inv(p[:, None, None] * still.at(q, still.true_estimates()).gain(p))
        D = np.diag(net.arms[net.port].friction)
        X = (Z - D) * (p + net.law.lambda_M)[:, None, None]
        return cls(p.astype(np.complex128), D, X.astype(np.complex128))

    def passive(self, lambda_M: float) -> bool:
        Z = self.D + self.X / (self.p + lambda_M)[:, None, None]
        least = np.linalg.eigvalsh(Z + np.conj(np.swapaxes(Z, 1, 2)))[:, 0]
        return bool((least >= -ROUNDING * np.linalg.norm(Z, axis=(1, 2))).all())
