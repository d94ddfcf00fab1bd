"""A second simulator of the paper, of its own making: short, slow, and finer than the engine.

Arms move in absolute angles (p, r) = (q_1, q_1 + q_2), where the inertia is [a, b cos d; b cos d,
c] with d = r - p, a = θ1 - θ3, b = θ2, c = θ3, by Runge-Kutta steps of a twentieth of a sample. The
controllers are written down from the same energy, not from the regressor of the models. Nothing
here imports what it is to check.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import cos, isfinite, sin

Pair = tuple[float, float]
FINE = 20


@dataclass
class Hand:
    """A spring and a damper of each joint; `holds` says how firmly from a time (s) on."""

    k_p: Pair = (0.0, 0.0)
    k_d: Pair = (0.0, 0.0)
    q_h: Pair = (0.0, 0.0)
    holds: Callable[[float], float] = lambda t: 1.0


@dataclass
class Body:
    """An arm: θ, where it starts, who holds it, a wall, and a constant push."""

    theta: tuple[float, float, float]
    q: Pair
    dq: Pair = (0.0, 0.0)
    hand: Hand = field(default_factory=Hand)
    k_w: float = 0.0
    b_w: float = 0.0
    q_w: float = 0.0
    push: Pair = (0.0, 0.0)

    def rate(self, x: Sequence[float], tau: Pair, firm: float) -> tuple[float, ...]:
        """Derivative of (p, r, dp, dr) under `tau`."""
        p, r, dp, dr = x
        q, dq = (p, r - p), (dp, dr - dp)
        load = []
        for i in (0, 1):
            grip = -self.hand.k_d[i] * dq[i] - self.hand.k_p[i] * (q[i] - self.hand.q_h[i])
            depth = q[i] - self.q_w
            wall = max(0.0, self.k_w * depth + self.b_w * dq[i]) if depth > 0 else 0.0
            load.append(tau[i] + self.push[i] + firm * grip - wall)
        a, b, c = self.theta[0] - self.theta[2], self.theta[1], self.theta[2]
        co, si = b * cos(r - p), b * sin(r - p)
        first, second = load[0] - load[1] + si * dr * dr, load[1] - si * dp * dp
        det = a * c - co * co
        return dp, dr, (c * first - co * second) / det, (a * second - co * first) / det

    def move(self, tau: Pair, firm: float, h: float) -> None:
        """Advance by `h` (s) with `tau` and the firmness of the hand held."""
        x = (self.q[0], sum(self.q), self.dq[0], sum(self.dq))
        e = h / FINE
        for _ in range(FINE):
            k = [self.rate(x, tau, firm)]
            for step in (e / 2, e / 2, e):
                k.append(
                    self.rate([u + step * v for u, v in zip(x, k[-1], strict=True)], tau, firm)
                )
            x = tuple(
                u + e / 6 * (s + 2 * v + 2 * w + y) for u, s, v, w, y in zip(x, *k, strict=True)
            )
        self.q, self.dq = (x[0], x[1] - x[0]), (x[2], x[3] - x[2])


@dataclass
class Law:
    """Eqs (29)-(32), (61), (76)-(81) and Remark 3, sampled; the options of the models."""

    alpha: float
    lambda_M: float
    K: Pair = (16.0, 16.0)
    Gamma: tuple[float, ...] = (1.0, 1.0, 1.0)
    coupling: float = 0.0
    lambda_c: float = 0.0
    least: tuple[float, ...] = (-1e9,) * 3
    most: tuple[float, ...] = (1e9,) * 3
    tau_max: Pair = (1e9, 1e9)
    theta_hat: tuple[float, ...] = (0.0, 0.0, 0.0)
    z: Pair = (0.0, 0.0)

    def xi(self, body: Body) -> Pair:
        """The signal that is sent."""
        return tuple(v + self.alpha * u for u, v in zip(body.q, body.dq, strict=True))  # type: ignore[return-value]

    def act(self, body: Body, heard: Pair | None, h: float) -> Pair:
        """The torque of this sample; z and theta_hat go on to the next, `h` (s) later."""
        q, dq, own = body.q, body.dq, self.xi(body)
        s = [v - w for v, w in zip(dq, self.z, strict=True)]
        dz = [-self.alpha * dq[i] + self.lambda_M * s[i] for i in (0, 1)]
        if heard is not None:
            dz = [dz[i] - self.coupling * (own[i] - heard[i]) for i in (0, 1)]
        e = [dz[i] - self.lambda_c * s[i] for i in (0, 1)]
        (zp, zr), (ep, er), (sp, sr) = ((v[0], v[0] + v[1]) for v in (self.z, e, s))
        dp, dr, co, si = dq[0], dq[0] + dq[1], cos(q[1]), sin(q[1])
        cross = co * er - si * dr * zr, co * ep + si * dp * zp
        a, b, c = (self.theta_hat[0] - self.theta_hat[2], *self.theta_hat[1:])
        first, second = a * ep + b * cross[0], b * cross[1] + c * er
        K = (0.0, 0.0) if self.lambda_c else self.K
        wanted = first + second - K[0] * s[0], second - K[1] * s[1]
        tau = tuple(max(-m, min(m, x)) for x, m in zip(wanted, self.tau_max, strict=True))
        if tau == wanted:
            of_a = sp * ep
            Ys = of_a, sp * cross[0] + sr * cross[1], sr * er - of_a
            self.theta_hat = tuple(
                max(low, min(high, t - h * g * y))
                for t, g, y, low, high in zip(
                    self.theta_hat, self.Gamma, Ys, self.least, self.most, strict=True
                )
            )
            self.z = self.z[0] + h * dz[0], self.z[1] + h * dz[1]
        return tau  # type: ignore[return-value]


def newest(delays: Sequence[float], k: int, h: float) -> int:
    """The newest packet that has arrived by sample `k`, -1 for none; lost ones are not finite."""
    arrived = (j for j in range(k, -1, -1) if isfinite(delays[j]))
    return next((j for j in arrived if j * h + delays[j] <= k * h + 1e-9), -1)


def simulate(
    bodies: Sequence[Body],
    laws: Sequence[Law],
    delays: Sequence[Sequence[float]],
    samples: int,
    h: float,
) -> list[list[Pair]]:
    """Positions of each arm (rad) at each sample, the first and the last included.

    One arm alone, or two whose packet j to arm i takes ``delays[i][j]`` (s).
    """
    sent: list[list[Pair]] = [[] for _ in bodies]
    places = [[body.q] for body in bodies]
    for k in range(samples):
        for i, (body, law) in enumerate(zip(bodies, laws, strict=True)):
            sent[i].append(law.xi(body))
        torques = []
        for i, (body, law) in enumerate(zip(bodies, laws, strict=True)):
            heard = None
            if len(bodies) == 2:
                heard = sent[1 - i][max(0, newest(delays[i], k, h))]
            torques.append(law.act(body, heard, h))
        for body, tau, place in zip(bodies, torques, places, strict=True):
            body.move(tau, body.hand.holds(k * h), h)
            place.append(body.q)
    return places
