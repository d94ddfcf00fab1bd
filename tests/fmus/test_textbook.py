"""Laws of serial arms against formulas of a textbook, term by term, in C and in NumPy.

The planar arm of two rods has its inertia, Coriolis matrix and gravity in closed form, and the law
stands here in scalars, without a function of the models. A term that C and NumPy leave out alike
is noticed: lambda_c, limits of torque, of estimates and of commands, fading and old signals.

Source: M. W. Spong, S. Hutchinson, M. Vidyasagar, "Robot Modeling and Control", Wiley, 2006,
Sec. 7.5; the law: the paper's eqs (42)-(45), (47), Remark 3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from cosim.base.component import Component
from fmus.models import arm_task, arm_teleoperation, arm_velocity, kinematic
from fmus.models.arm_task import ArmTask
from fmus.models.arm_teleoperation import ArmTeleoperation
from fmus.models.arm_velocity import ArmVelocity
from fmus.models.kinematic import Kinematic

pytestmark = pytest.mark.usefixtures("compiled_once")
Vector = np.ndarray[Any, np.dtype[np.float64]]
H, L, G = 1e-2, 0.7, 9.81
#: The parameters of a link that act in the plane, by their place among ten: m, mx, Izz.
ACTING = (0, 1, 9)
ROTORS = np.array([0.03, 0.05])
TABLE = {
    "origin": np.array([[0.0, 0.0, 0.0], [L, 0.0, 0.0]]),
    "armature": ROTORS,
    "g": np.array([0.0, -G, 0.0]),
}


def book(q: Vector, dq: Vector, v: Vector, a: Vector) -> Vector:
    """Y, (2, 6), of m, mx, Izz of each rod: M a + C v + g, linear in these."""
    s2, c2 = np.sin(q[1]), np.cos(q[1])
    up, both = G * np.cos(q[0]), G * np.cos(q[0] + q[1])
    coriolis = (-dq[1] * v[0] - (dq[0] + dq[1]) * v[1], dq[0] * v[0])
    first = [0.0, up, a[0], L * L * a[0] + L * up]
    first += [L * (c2 * (2 * a[0] + a[1]) + s2 * coriolis[0]) + both, a[0] + a[1]]
    second = [0.0, 0.0, 0.0, 0.0, L * (c2 * a[0] + s2 * coriolis[1]) + both, a[0] + a[1]]
    return np.array([first, second])


@dataclass
class Adaptive:
    """The law of ``arm_teleoperation`` with one neighbour, step by step."""

    x: dict[str, Any]
    z: Vector = field(default_factory=lambda: np.zeros(2))
    theta: Vector = field(default_factory=lambda: np.zeros(6))

    def step(self, u: dict[str, Vector]) -> dict[str, Vector]:
        x, q, dq, z, theta = self.x, u["q"], u["dq"], self.z.copy(), self.theta.copy()
        age, w = float(u["age"][0]), float(u["w"][0])
        old = age > x["age_max"] and w > 0.0
        if old:
            w *= max(0.0, 1.0 - (age - x["age_max"]) / x["age_fade"])
        xi = dq + x["alpha"] * q
        s = dq - z
        dz = -x["alpha"] * dq + x["lambda_M"] * s - x["lambda"] * w * (xi - u["xi_in"][0])
        Y = book(q, dq, z, dz)
        inertia = book(q, dq, np.zeros(2), s) - book(q, dq, np.zeros(2), np.zeros(2))
        resisting = x["lambda_c"] * (inertia @ theta + ROTORS * s)
        free = Y @ theta + ROTORS * dz - (resisting if x["lambda_c"] else x["K"] * s)
        tau = np.clip(free, -x["tau_max"], x["tau_max"])
        if (tau == free).all():
            self.z = z + H * dz
            if not old:
                regressor = Y - x["lambda_c"] * inertia
                moved = theta - H * x["Gamma"] * (regressor.T @ s)
                self.theta = np.minimum(np.maximum(moved, x["theta_min"]), x["theta_max"])
        return {"tau": tau, "s": s, "z": z, "theta": theta, "xi": xi}


def spread(values: Vector, rest: float) -> Vector:
    """Six numbers of the plane among ten of each link, (2, 10); `rest` the others."""
    found = np.full((2, 10), rest)
    found[:, ACTING] = np.reshape(values, (2, 3))
    return found


def motions(seed: int, steps: int, **more: Callable[[np.random.Generator], Vector]) -> list[dict]:
    draw = np.random.default_rng(seed)
    rows = []
    for _ in range(steps):
        row = {name: draw.uniform(-1.5, 1.5, 2) for name in ("q", "dq")}
        row |= {"xi_in": draw.uniform(-2, 2, (1, 2)), "age": draw.uniform(0, 1.2, 1)}
        row["w"] = draw.choice([0.0, 0.8], 1)
        rows.append(row | {name: make(draw) for name, make in more.items()})
    return rows


def compare(component: Component, law: Any, u: list[dict], pick: dict[str, Any]) -> None:
    component.initial(u[0])
    for k, given in enumerate(u):
        found, expected = component.step(k * H, H, given), law.step(given)
        for name, value in expected.items():
            mine = pick.get(name, lambda y, name=name: y[name])(found)
            assert np.allclose(mine, value, rtol=1e-9, atol=1e-9), (k, name, mine, value)


OPTIONS = {
    "plain": {},
    "Remark 3": {"lambda_c": 4.0},
    "old signals": {"age_max": 0.5, "age_fade": 0.4},
    "bounds": {"theta_min": 0.05, "theta_max": 0.45},
    "limited torque": {"tau_max": np.array([18.0, 6.0])},
    "all": {"lambda_c": 2.0, "age_max": 0.6, "age_fade": 0.3, "theta_max": 0.5, "tau_max": 25.0},
}


@pytest.mark.parametrize("make", [ArmTeleoperation, arm_teleoperation.kernel], ids=["NumPy", "C"])
@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_the_adaptive_law_is_that_of_the_book(make: Any, options: dict[str, Any]) -> None:
    x: dict[str, Any] = {
        "alpha": 0.8, "lambda_M": 3.0, "lambda": 1.3, "lambda_c": 0.0, "K": np.array([4.0, 2.0]),
        "tau_max": 1e9, "theta_min": -1e9, "theta_max": 1e9, "age_max": 1e9, "age_fade": 1.0,
        "Gamma": np.array([0.3, 0.2, 0.4, 0.5, 0.6, 0.1]), **options,
    }  # fmt: skip
    start = np.array([0.3, 0.2, 0.1, 0.4, 0.25, 0.15])
    given = {name: np.asarray(value, float) for name, value in x.items()} | TABLE
    given |= {"gravity": np.array(2.0), "tau_max": np.full(2, x["tau_max"])}
    if np.ndim(x["tau_max"]):
        given["tau_max"] = np.asarray(x["tau_max"])
    given |= {"Gamma": spread(x["Gamma"], 0.0), "theta_hat": spread(start, 0.0)}
    given |= {name: spread(np.full(6, x[name]), s * 1e9) for name, s in
              (("theta_min", -1.0), ("theta_max", 1.0))}  # fmt: skip
    component = make(joints=2)
    component.initialize(given)
    law = Adaptive(x, theta=start)
    u = motions(3, 60)
    compare(component, law, u, {"theta": lambda y: np.asarray(y["theta_hat"])[:, ACTING].ravel()})
    assert np.abs(law.theta - start).max() > 0.02  # the estimates have moved


@dataclass
class Commanded:
    """The law of ``arm_velocity``, or of ``kinematic`` (no estimates), with one neighbour."""

    x: dict[str, Any]
    estimates: bool
    q_c: Vector
    z: Vector = field(default_factory=lambda: np.zeros(2))
    theta: Vector = field(default_factory=lambda: np.zeros((2, 6)))
    own: Vector = field(default_factory=lambda: np.zeros((2, 2)))

    def step(self, u: dict[str, Vector]) -> dict[str, Vector]:
        x, q, dq, z, limited = self.x, u["q"], u["dq"], self.z.copy(), False
        old = u["age"][0] > x["age_max"] and u["w"][0] > 0.0
        w = u["w"][0] * (max(0.0, 1 - (u["age"][0] - x["age_max"]) / x["age_fade"]) if old else 1)
        s, xi = dq - z, dq + x["alpha"] * q
        dz = -x["alpha"] * dq + x["lambda_M"] * s - x["lambda"] * w * (xi - u["xi_in"][0])
        dz = dz + x["b"] * u.get("tau_m", 0.0)
        Y, theta, own = book(q, dq, z, dz), self.theta.copy(), self.own.copy()
        dq_c, q_c, later = np.zeros(2), self.q_c.copy(), z.copy()
        for i in range(2):
            wanted = z[i]
            if self.estimates:
                wanted += Y[i] @ theta[i] + own[i] @ [dz[i], z[i]]
            dq_c[i] = min(max(wanted, -x["v_max"]), x["v_max"])
            limited |= dq_c[i] != wanted or u["clamped"][i] != 0
            pushes = u["clamped"][i] * (dq_c[i] - dq[i]) > 0  # against the limit of the servo
            q_c[i] += H * (dq[i] if pushes else dq_c[i])
            if not u["clamped"][i] * dz[i] > 0:
                later[i] = min(max(z[i] + H * dz[i], -x["v_max"]), x["v_max"])
        if self.estimates and not limited and not old:
            for i in range(2):
                self.theta[i] -= H * x["Gamma_row"][i] * x["Gamma"] * Y[i] * s[i]
                self.own[i] -= H * x["Gamma_own"] * np.array([dz[i], z[i]]) * s[i]
        self.q_c, self.z = q_c, later
        found = {"q_c": q_c, "dq_c": dq_c, "xi": xi, "s": s, "z": z}
        return found | ({"theta": theta, "own_hat": own} if self.estimates else {})


SIGNS = {"clamped": lambda draw: draw.choice([-1.0, 0.0, 1.0], 2, p=[0.15, 0.7, 0.15])}
GAINS: dict[str, Any] = {"alpha": 0.8, "lambda_M": 3.0, "lambda": 1.3, "v_max": 0.9}
OLD = {"fresh": {"age_max": 1e9, "age_fade": 1.0}, "old": {"age_max": 0.5, "age_fade": 0.4}}


@pytest.mark.parametrize("make", [ArmVelocity, arm_velocity.kernel], ids=["NumPy", "C"])
@pytest.mark.parametrize("ages", OLD.values(), ids=OLD)
def test_the_law_for_velocities_is_that_of_the_book(make: Any, ages: dict[str, float]) -> None:
    x = {**GAINS, **ages, "b": 0.0, "v_max": 2.0, "Gamma_row": np.array([0.5, 0.8])}
    x |= {"Gamma": np.array([0.3, 0.2, 0.4, 0.5, 0.6, 0.1]), "Gamma_own": np.array([0.2, 0.3])}
    given = {name: np.asarray(x[name], float) for name in (*GAINS, *ages, "Gamma_row")} | TABLE
    given |= {"v_max": np.full(2, x["v_max"]), "Gamma": spread(x["Gamma"], 0.0)}
    given |= {"Gamma_own": np.tile(x["Gamma_own"], (2, 1)), "gravity": np.array(2.0)}
    component = make(joints=2)
    component.initialize(given)
    u = motions(4, 60, **SIGNS)
    law = Commanded(x, estimates=True, q_c=u[0]["q"])
    act = {"theta": lambda y: np.asarray(y["theta_hat"])[:, :, ACTING].reshape(2, 6)}
    compare(component, law, u, act)
    assert np.abs(law.theta).max() > 0.01


@pytest.mark.parametrize("make", [Kinematic, kinematic.kernel], ids=["NumPy", "C"])
@pytest.mark.parametrize("ages", OLD.values(), ids=OLD)
def test_the_kinematic_law_is_that_of_its_equations(make: Any, ages: dict[str, float]) -> None:
    x = {**GAINS, **ages, "b": np.array([0.4, 0.7])}
    given = {name: np.asarray(value, float) for name, value in x.items()}
    component = make(joints=2)
    component.initialize(given | {"v_max": np.full(2, x["v_max"])})
    u = motions(5, 60, tau_m=lambda draw: draw.uniform(-3, 3, 2), **SIGNS)
    compare(component, Commanded(x, estimates=False, q_c=u[0]["q"]), u, {})


@pytest.mark.parametrize("make", [ArmTask, arm_task.kernel], ids=["NumPy", "C"])
@pytest.mark.parametrize("angle", [0.0, 1e-3, 0.1, 0.25, 0.35, 1.2])
def test_the_damped_inverse_is_that_of_the_singular_values(make: Any, angle: float) -> None:
    """V = Σ u_k σ_k/(σ_k² + μ²) of z, with σ = (Σ 1/σ_k²)^(-1/2), (σ_0/2)² (1 - σ²/σ_0²)² = μ²."""
    sigma_0, z = 0.3, np.array([-0.3, 0.1])
    component = make(joints=2, coordinates=2)
    given = {"origin": TABLE["origin"], "tip": np.array([0.5, 0.0, 0.0]), "z": z}
    zero = {"Gamma": np.zeros((2, 10)), "gravity": np.array(0.0), "k_n": np.zeros(2)}
    component.initialize({**given, **zero, "k_l": np.zeros(2), "sigma_0": np.array(sigma_0)})
    q, dq = np.array([0.4, angle]), np.array([0.2, -0.3])
    u = {"q": q, "dq": dq, "xi_in": np.zeros((1, 2))}
    y = component.initial(u)
    y = component.step(0.0, H, u)
    s1, c1, s12, c12 = (f(a) for a in (q[0], q[0] + q[1]) for f in (np.sin, np.cos))
    J = np.array([[-L * s1 - 0.5 * s12, -0.5 * s12], [L * c1 + 0.5 * c12, 0.5 * c12]])
    U, singular, V = np.linalg.svd(J)
    singular = np.where(singular < 1e-12, 0.0, singular)
    sigma = 0.0 if 0.0 in singular else float((1.0 / singular**2).sum() ** -0.5)
    mu2 = (sigma_0 / 2) ** 2 * max(0.0, 1.0 - (sigma / sigma_0) ** 2) ** 2
    v = V.T @ (singular / (singular**2 + mu2) * (U.T @ z))
    assert np.allclose(dq - np.asarray(y["s"]), v, rtol=1e-4, atol=1e-9)
    assert y["sigma"] == pytest.approx(sigma, rel=1e-4, abs=1e-12)
