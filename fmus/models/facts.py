"""Facts of the models, from which predictions and checks are computed without a run.

The table :data:`FACTS` maps the name of a model's module to its function of facts, for each model
that has one; :mod:`cosim.predict.facts` describes the argument and the result.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache

import numpy as np

from cosim.base.copies import replace
from cosim.predict.facts import (
    GRAVITY,
    Arm,
    DynamicFeedback,
    Facts,
    Hand,
    Spring,
    SpringDamper,
    Values,
    Vector,
)
from fmus.arms.dynamics import inertia, regressor
from fmus.model.numeric import Array

#: Postures that stand for the workspace, rad: M depends on the second joint only, evenly.
_POSTURES = np.linspace(0.0, np.pi, 121)


def planar2r(values: Values) -> Arm:
    """The arm: M from theta, grip and wall inside."""
    theta = values["theta"]
    scale = values.get("grip", (1.0,))[0]
    grip = Spring(
        stiffness=tuple(scale * k for k in values["k_p"]),
        damping=tuple(scale * k for k in values["k_d"]),
        place=values.get("q_h", (0.0, 0.0)),
        names=("k_p", "k_d", "q_h"),
    )
    wall = Spring(
        stiffness=values["k_w"],
        damping=values["b_w"],
        place=values["q_w"],
        names=("k_w", "b_w", "q_w"),
    )
    return Arm(
        inertia=_inertia,
        parameters=theta,
        inertia_range=_range(theta),
        heaviest=(0.0, 0.0 if theta[1] >= 0 else np.pi),
        gravity=values.get("theta_g", (0.0, 0.0)),
        q=values["q"],
        grip=grip,
        wall=wall,
        h_max=1.0 / values["substeps"][0],
    )


def _inertia(parameters: Sequence[float], q: Sequence[float]) -> Array:
    return inertia(np.asarray(parameters[:3]), np.asarray(q))


@lru_cache(maxsize=32)
def _range(theta: Vector) -> tuple[float, float]:
    """Least and greatest eigenvalue of M over all postures, kg.m2."""
    c2 = np.cos(_POSTURES)
    m12 = theta[2] + theta[1] * c2
    M = np.array([[theta[0] + 2 * theta[1] * c2, m12], [m12, np.full_like(c2, theta[2])]])
    eigenvalues = np.linalg.eigvalsh(np.moveaxis(M, -1, 0))
    return float(eigenvalues.min()), float(eigenvalues.max())


@lru_cache(maxsize=1)
def _regressor_norm() -> float:
    """Root mean square of ‖Y(q, 0, 0, dz)‖/|dz| over postures and directions of dz."""
    still, first, second = np.zeros(2), np.array([1.0, 0.0]), np.array([0.0, 1.0])
    turns = _POSTURES[::8]  # of q2, and of dz
    each = []
    for q2 in turns:
        Y_1, Y_2 = (regressor(np.array([0.0, q2]), still, still, dz) for dz in (first, second))
        each += [c * Y_1 + s * Y_2 for c, s in zip(np.cos(turns), np.sin(turns), strict=True)]
    norms = np.linalg.norm(np.array(each), 2, axis=(1, 2))
    return float(np.sqrt(np.mean(norms**2)))


def adaptive(values: Values) -> DynamicFeedback:
    """The law alone or with neighbors, with gravity in theta_hat or without."""
    full = any(values.get("K_off", ())) or any(values.get("Gamma_off", ()))
    network = "lambda" in values
    gravity = GRAVITY[int(values["gravity"][0])] if "gravity" in values else "none"
    return DynamicFeedback(
        K=values["K"],
        Gamma=values["Gamma"],
        alpha=values["alpha"][0],
        lambda_M=values["lambda_M"][0],
        lambda_=values["lambda"][0] if network else 0.0,
        lambda_c=values.get("lambda_c", (0.0,))[0],
        z=values["z"],
        theta_hat=values["theta_hat"],
        gravity=gravity,
        theta_g=values.get("theta_g", (0.0, 0.0)),
        regressor=_regressor_norm(),
        tau_max=values["tau_max"],
        age_max=values.get("age_max", (1e9,))[0],
        received="xi_in" if network else "",
        weights="w" if network else "",
        age="age" if network else "",
        adaptation=("Gamma", "Gamma_off") if "Gamma_off" in values else ("Gamma",),
        beyond="K or Gamma is not diagonal" if full else "",
    )


def operator(values: Values) -> Hand:
    """The hand as a separate component."""
    return Hand(stiffness=values["k_p"], damping=values["k_d"], place=values["q_h"])


def damping(values: Values) -> SpringDamper:
    """Damping to the ground, and no other robot."""
    d = values["d"]
    return SpringDamper(
        law="damping", feedback=d, ground=d, stiffness=_zero(d), needs_ground=False,
        theta_g=values["theta_g"], tau_max=_torque(values),
    )  # fmt: skip


def pd(values: Values) -> SpringDamper:
    """Spring and damper, nothing to the ground."""
    return _coupled("PD", values, values["K_p"], values["K_d"], _zero(values["K_p"]))


def p_d(values: Values) -> SpringDamper:
    """Spring, and damping to the ground."""
    return _coupled("P+d", values, values["K"], _zero(values["K"]), values["B"])


def lee_spong(values: Values) -> SpringDamper:
    """Spring, damper, and damping to the ground."""
    ground = _sum(values["K_d"], values["P_eps"])
    return _coupled(
        "PD with dissipation", values, values["K_p"], values["K_v"], ground, constant=True
    )


def _coupled(
    law: str,
    values: Values,
    stiffness: Vector,
    coupling: Vector,
    ground: Vector,
    *,
    constant: bool = False,
) -> SpringDamper:
    return SpringDamper(
        law=law,
        feedback=_sum(coupling, ground),
        ground=ground,
        stiffness=stiffness,
        constant_delay=constant,
        tau_max=_torque(values),
    )


def nuno_adaptive(values: Values) -> SpringDamper:
    """K epsilon + B de is a spring K lambda with dampers; the delay may be any that is constant."""
    feedback = _sum(values["K"], values["B"])
    return _proved("adaptive synchronisation (Nuño)", values, feedback)


def chopra(values: Values) -> SpringDamper:
    """K (r_j - r): the delay may be any that is constant."""
    return _proved("adaptive synchronisation (Chopra)", values, values["K"])


def wang2014(values: Values) -> SpringDamper:
    """K s with static feedback: the delay may be any that is constant."""
    return _proved("static feedback (Wang 2014)", values, values["K"])


def abdessameud2014(values: Values) -> SpringDamper:
    """K s with a filter as reference: at rest a spring k_p K / k_d; any bounded delay."""
    K, (k_p,), (k_d,) = values["K"], values["k_p"], values["k_d"]
    return SpringDamper(
        law="reference filter (Abdessameud)",
        feedback=K,
        ground=_zero(K),
        stiffness=tuple(k * k_p / k_d if k_d > 0 else 0.0 for k in K),
        needs_ground=False,
        tau_max=_torque(values),
    )


def _in(module: str, function: str) -> Callable[[Values], Facts | None]:
    """A function of facts in a module of its own, which is imported when facts are asked for."""

    def facts(values: Values) -> Facts | None:
        found: Callable[[Values], Facts | None] = getattr(importlib.import_module(module), function)
        return found(values)

    return facts


def _serial(law: Callable[[Values], SpringDamper]) -> Callable[[Values], SpringDamper]:
    """The facts of a law for a serial arm, which compensates or adapts gravity by its table."""

    def facts(values: Values) -> SpringDamper:
        from fmus.models import serial_facts

        treated = values["gravity"][0] > 0
        return replace(law(values), theta_g=serial_facts.weights(values) if treated else ())

    return facts


def wave(values: Values) -> SpringDamper:
    """Either end of a wave line: b, or the damper towards the reference, on the own velocity."""
    return _proved("waves", values, values.get("K_d", values["b"]))


def _proved(law: str, values: Values, feedback: Vector) -> SpringDamper:
    """A law that needs no damping for the delay, but a constant delay."""
    gain = values.get("lambda", (0.0,))[0]
    return SpringDamper(
        law=law,
        feedback=feedback,
        ground=_zero(feedback),
        stiffness=tuple(gain * k for k in values.get("K", _zero(feedback))),
        needs_ground=False,
        constant_delay=True,
        tau_max=_torque(values),
    )


def _torque(values: Values) -> Vector:
    return values.get("tau_max", (1e9,))


def _sum(a: Vector, b: Vector) -> Vector:
    return tuple(x + y for x, y in zip(a, b, strict=True))


def _zero(a: Vector) -> Vector:
    return (0.0,) * len(a)


#: By the last name of the model's module.
FACTS: Mapping[str, Callable[[Values], Facts | None]] = {
    "planar2r": planar2r,
    "adaptive": adaptive,
    "teleoperation": adaptive,
    "operator": operator,
    "damping": damping,
    "pd": pd,
    "p_d": p_d,
    "lee_spong": lee_spong,
    "nuno_adaptive": nuno_adaptive,
    "chopra": chopra,
    "wang2014": wang2014,
    "abdessameud2014": abdessameud2014,
    "arm": _in("fmus.models.serial_facts", "arm"),
    "arm_teleoperation": _in("fmus.models.serial_facts", "adaptive"),
    "arm_task": _in("fmus.models.task_facts", "arm_task"),
    "arm_tip": _in("fmus.models.task_facts", "arm_tip"),
    "arm_pd": _in("fmus.models.serial_facts", "pd"),
    "arm_velocity": _in("fmus.models.serial_facts", "velocity"),
    "kinematic": _in("fmus.models.serial_facts", "kinematic"),
    "servo": _in("fmus.models.serial_facts", "servo"),
    "servo_command": _in("fmus.models.serial_facts", "servo_command"),
    "arm_nuno_adaptive": _serial(nuno_adaptive),
    "arm_chopra": _serial(chopra),
    "arm_wang2014": _serial(wang2014),
    "arm_abdessameud2014": _serial(abdessameud2014),
    "wave_impedance": wave,
    "wave_admittance": wave,
}
