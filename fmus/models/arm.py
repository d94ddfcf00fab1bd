"""Serial arm of 1 to 16 revolute and prismatic joints, described by a table.

The table (``joint_type`` to ``g``) is the one of the module ``fmus.arms.chain``; a scenario fills
it in from a URDF file with ``options.urdf`` (docs/arm.md). The equation of motion is::

    (M(q) + diag J) ddq + C(q, dq) dq + g(q) = tau + tau_ext + tau_h - tau_e - tau_f + tau_s

    J       armature: inertia of the rotors at the joints
    tau_f   damping dq + friction tanh(dq / v_f)           viscous and smooth Coulomb friction
    tau_s   max(0,  k_s (q_min - q) - b_s dq)  for q < q_min      soft stops of the joints
           -max(0,  k_s (q - q_max) + b_s dq)  for q > q_max      where k_s > 0

All entries of a prismatic joint are in m, m/s, N, N/m and N.s/m where the table says rad, rad/s,
N.m, N.m/rad and N.m.s/rad. Without rotors and friction, a very light last link makes a stiff
equation; the step must then be short, or `substeps` greater.

As ``planar2r``, the arm can include two parts of its environment, evaluated at every stage of the
integrator and off by default. The first is the torque of an operator on the robot, at each joint;
the input `q_h` is the position of the hand, and `grip` releases (0) or grasps (1) the arm::

    tau_h = grip (-k_d dq - k_p (q - q_h))

The second is the torque of the robot on its environment, at each joint, at the depth x = q - q_w
beyond the wall. The parameter `contact` selects the law::

    0   tau_e = max(0, k_w x + b_w dq)              spring and damper
    1   tau_e = max(0, x (k_w + b_w dq))            Hunt and Crossley, exponent 1
    2   tau_e = max(0, x^1.5 (k_w + b_w dq))        Hunt and Crossley, exponent 1.5

The classical Runge-Kutta method of order 4 integrates the equation with `substeps` equal substeps
in a communication step h, with the inputs held. It makes more of them where friction and stops are
so stiff that the method would be unstable: n of them, so that::

    h (d + sqrt(d^2 + 4 k)) / 2 <= 2.5 n       d = trace M^-1 diag(damping + friction / v_f + b_s)
                                               k = trace M^-1 diag(k_s),   M with rotors, at t_k

If these are more than 1000 and than `substeps`, the step is refused. Each stage solves the equation
by the articulated body algorithm, in a time that grows in proportion to the number of joints.

Source: R. Featherstone, Rigid Body Dynamics Algorithms, Springer, 2008; the environment as in
``planar2r``.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from pathlib import Path
from typing import Any

from cosim.base.component import Drawing
from cosim.base.errors import RunError, ScenarioError
from fmus.arms import chain, environment
from fmus.arms.environment import grip_torque, wall_torque
from fmus.arms.joints import DAMPING, RATE, STIFFNESS, TORQUE, Joints
from fmus.arms.robot import of_robot
from fmus.arms.stiff import steps_in
from fmus.build.reference import Values, derive
from fmus.model import Model, Variable
from fmus.model.numeric import Array, np

#: Where a joint has no limit, rad.
FREE = 1e6


def _friction(arm: Joints) -> tuple[Variable, ...]:
    return (
        arm.gain("damping", DAMPING, 0.0, "Viscous friction"),
        arm.gain("friction", TORQUE, 0.0, "Coulomb friction"),
        arm.gain("v_f", RATE, 0.1, "Velocity at which 76 % of the Coulomb friction act", 1e-6),
    )


def _stops(arm: Joints) -> tuple[Variable, ...]:
    return (
        arm.vector("q_min", "parameter", "rad", "Lower limit of the joint", -FREE),
        arm.vector("q_max", "parameter", "rad", "Upper limit of the joint", FREE),
        arm.gain("k_s", STIFFNESS, 0.0, "Stiffness of the stops at the limits, 0 = no stops"),
        arm.gain("b_s", DAMPING, 0.0, "Damping of the stops, where k_s is more than 0"),
    )


def model(joints: int = 7) -> Model:
    """Declare the arm of `joints`; by default equal rods in a horizontal plane, without friction.

    Raises FmuError for a number of joints that is not a whole number from 1 to 16.
    """
    arm = Joints(joints)
    chains = ("chain.h", "chain_check.h", "chain_forward.h")
    return environment.plant(
        "arm",
        "Serial arm of any revolute and prismatic joints",
        arm,
        (*chain.variables(arm), *_friction(arm), *_stops(arm)),
        ("arm.c", *chains, "hyperbolic.c", "hyperbolic.h", "stiff.h"),
        __doc__,
        lanes=True,
    )


def law(
    x: Values, t: float, h: float, tau: Array, tau_ext: Array, q_h: Array, grip: Array
) -> Values:
    """The motion over [t, t + h), s, with the inputs held; tau_h and tau_e (n,) N.m at its end.

    `tau`, `tau_ext` (n,) N.m; `q_h` (n,) rad; `grip` scalar, 0 to 1. Raises RunError where the
    inertia matrix is singular.
    """
    table = chain.of_values(x)

    def acceleration(q: Array, dq: Array) -> Array:
        pushed = tau + tau_ext + grip_torque(x, q, dq, q_h, grip) - wall_torque(x, q, dq)
        return chain.forward(table, q, dq, pushed - _losses(x, q, dq))

    try:
        steps = _steps(x, chain.mass_matrix(table, x["q"]), h)
        q, dq = environment.integrate(x, acceleration, h, steps)
    except np.linalg.LinAlgError as error:
        raise RunError(f"arm: {error}", time=t) from None
    return environment.outputs_at(x, q, dq, q_h, grip)


def start(x: Values, tau: Array, tau_ext: Array, q_h: Array, grip: Array) -> Values:
    """Outputs at the start; the inputs have the shapes and units of :func:`law`.

    Raises ScenarioError for a table or limits that no arm has.
    """
    table = chain.of_values(x)
    chain.check(table, "arm")
    if np.linalg.eigvalsh(chain.mass_matrix(table, x["q"]))[0] <= 0.0:
        raise ScenarioError(
            "a joint moves no inertia at the start; expected mass or armature", "arm.inertia"
        )
    for i, (low, high) in enumerate(zip(x["q_min"], x["q_max"], strict=True)):
        if low >= high:
            raise ScenarioError(f"{low:g} is not below q_max {high:g}", f"arm.q_min[{i}]")
        if x["k_s"][i] > 0.0 and not low <= x["q"][i] <= high:
            raise ScenarioError(
                f"{x['q'][i]:g} is outside the stops {low:g} to {high:g}", f"arm.q[{i}]"
            )
    return environment.outputs_at(x, x["q"], x["dq"], q_h, grip)


def _steps(x: Values, M: Array, h: float) -> int:
    """Steps of the integrator in h in which friction and stops are stable. Raises RunError."""
    gain = x["damping"] + x["friction"] / x["v_f"] + np.where(x["k_s"] > 0, x["b_s"], 0.0)
    moved = np.diag(np.linalg.inv(M))
    d, k = float(gain @ moved), float(x["k_s"] @ moved)
    return steps_in(h, (d + sqrt(d**2 + 4.0 * k)) / 2.0, int(x["substeps"]), "arm")


def _losses(x: Values, q: Array, dq: Array) -> Array:
    """tau_f - tau_s, N.m."""
    friction = x["damping"] * dq + x["friction"] * np.tanh(dq / x["v_f"])
    below, above = x["q_min"] - q, q - x["q_max"]
    b_s = np.where(x["k_s"] > 0, x["b_s"], 0.0)
    up = np.where(below > 0, np.maximum(0.0, x["k_s"] * below - b_s * dq), 0.0)
    down = np.where(above > 0, np.maximum(0.0, x["k_s"] * above + b_s * dq), 0.0)
    return np.asarray(friction + down - up)


fmu, kernel, Arm = derive(model, law, start)
prepare = of_robot(model)


def drawing(options: Mapping[str, Any], folder: Path) -> Drawing | None:
    """The arm in a report; without a robot of its own, None. Raises ScenarioError as `prepare`.

    The last link ends at twice the distance of its centre of mass.
    """
    if "urdf" not in options:
        return None
    from fmus.arms.options import robot_of

    robot = robot_of(options, folder)
    values = robot.table.values()
    mass, *moment = np.asarray(values["inertia"], dtype=np.float64)[-1][:4]
    return Drawing(
        tuple(bool(kind) for kind in values["joint_type"]),
        tuple(tuple(np.ravel(R).tolist()) for R in values["rotation"]),
        tuple(tuple(np.ravel(r).tolist()) for r in values["origin"]),
        tuple(2.0 * x / mass if mass else 0.0 for x in moment),
        torque="tau_h",
        names=robot.names,
    )
