"""The paper's adaptive controller in the coordinates of an arm's tip, for arms that differ.

The law of ``arm_teleoperation`` couples joint by joint, and so equal arms. Here the arms exchange
the motion of their tips, so that arms of any kinematics agree on the place x of the tip: seven
joints, six, or a planar arm. One to three coordinates are the place, six have the turn of the tip
as well (``task_space``). For one arm and its neighbours j, with m coordinates::

    x          = scale F (p(q) - x_0)  (and the turn),   dx = J dq
    xi         = dx + alpha x                                                  sent, (47)
    dz         = -alpha dx + lambda_M (dx - z) - lambda Σ_j w_j l_j (xi - xi_in_j)
    v          = J# z + (1 - J# J) psi,   a = dv/dt
    s          = dq - v
    tau        = -(K + J' K_x J) s + Y(q, dq, v, a) theta_hat + (rotors) a
    dtheta_hat = -Gamma Y'(q, dq, v, a) s

J is that of x, with `scale`. z has one entry a coordinate; the joints that the task leaves free
follow psi, a motion towards the posture `q_n` and away from the limits, which stays local.

What the theorems need. V = s'(M + rotors)s/2 + (theta_hat - theta)' Gamma^-1 (theta_hat - theta)/2
decreases by s'(K + J' K_x J)s for any v with a = dv/dt, so that s is in L2 and bounded, as in the
paper; a is exact here, with dJ/dt. Where J has full row rank and is not damped, J J# = 1, and

    J s = dx - z,    dxi = -lambda Σ_j w_j (xi - xi_j) + lambda_M (J s) + d(J s)/dt

which is (48) in x: Theorems 3 to 5 hold for the tips as for joints, because J s is in L2, too. They
take full row rank all along the motion, with sigma >= sigma_0; a bounded null motion psi with a
bounded rate (|psi_i| <= psi_max by construction); and J and dJ/dt bounded, as of revolute joints.
The null motion is invisible at the tip: J (1 - J# J) = 0. With psi = 0 a push that the tip does not
notice moves the joints for ever, as in Theorem 2; with a posture it meets a spring of K k_n.

Near a singularity J# is damped, and J J# = 1 - mu^2 (J J' + mu^2)^-1. V still decreases, and
|v| <= 1.3 / sigma_0 |z / scale| + |psi|; but z is no longer followed in the direction that is lost,
and the agreement is not proved there. What is sent is dx = J dq, the motion that there is, not the
one that is wanted; lambda_M (dx - z) keeps z bounded.

`lacks` marks coordinates that the arm does not have, such as the height of a planar arm. It sends 0
for them. `listens` l_j (a row a neighbour) tells the others not to take part: 0 for the coordinates
of the neighbour that do not count. Each coordinate of the place is a network of its own, and its
graph must have a spanning tree.

The turn of the tip is counted from the posture q_0, about the axes of F, as twice the vector part
of the quaternion of the short way, times `length`: a coordinate in m like the others, for turns of
less than pi. The theorems hold for it within this range, because x is then one function of q with a
regular Jacobian, whose end sigma tells. Beyond, the turn jumps to the other short way.

At rest a force on the tip, conjugate to x, is (K_x + (J K^-1 J')^-1) (lambda alpha / lambda_M)
(x - x_j): the same on both sides where K is small, because K_x does not depend on the posture.

The rest is as of ``arm_teleoperation``: theta_hat (n, 10), Gamma, `natural`, gravity, `lambda_c`
(in place of K and K_x), limits and bounds, ages. `tip` is the point of the last link, which a
scenario gets from the URDF file, with the limits of the joints. The joints of a prismatic arm are
in m; k_n and k_l are then the same rates.

Sampled: outputs as of t_k; z and theta_hat advance by one step of the explicit Euler method to
t_k + h. The eigenvalues of K + J' K_x J times h must be small against those of the inertia.

Source: the paper, eqs (29)-(32), (42)-(45), (47), (61), (76)-(81), Theorems 2 to 5, in x: our own
derivation. The reference velocity: G. Niemeyer, J.-J. E. Slotine, "Performance in adaptive
manipulator control", Int. J. Robotics Research 10(2), 1991.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cosim.base.component import SharedBase
from cosim.base.errors import FmuError, ScenarioError
from fmus.arms import chain, serial_arm, task_space
from fmus.arms.adaptive_variables import coupling_gains, network_inputs
from fmus.arms.joints import RATE, Joints
from fmus.arms.robot import of_robot
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import Array, np
from fmus.models.arm_teleoperation import Wanted, checked, controlled, gains
from fmus.models.teleoperation import coupling

_FREE = 1e6
_SOURCES = (
    "arm_teleoperation.c",
    "arm_task.h",
    "chain_tip.h",
    "contact.c",
    "contact.h",
    "natural.h",
)


def model(joints: int = 7, coordinates: int = 3, neighbours: int = 1) -> Model:
    """Declare the controller of an arm of `joints` whose tip has 1, 2, 3 or 6 `coordinates`.

    It receives xi from `neighbours` >= 0. Raises FmuError for other numbers.
    """
    if neighbours < 0:
        raise FmuError(f"neighbours is {neighbours}, expected at least 0")
    if coordinates not in (1, 2, 3, 6):
        raise FmuError(f"coordinates is {coordinates}, expected 1, 2, 3 or 6")
    arm = Joints(joints)
    whom = f"{neighbours} neighbour(s)" if neighbours else "one arm alone"
    network = Terminal("network", ("xi", "xi_in", "w", "age"), "Signals of the neighbours")
    turning = coordinates == 6
    stem = "arm_task" + ("_turn" if turning else "") + ("" if neighbours else "_alone")
    return Model(
        identifier=f"{stem}_n{neighbours}" if neighbours > 1 else stem,
        description=f"Adaptive controller of the tip of a serial arm, {whom}",
        kind="sampled",
        variables=(
            arm.q,
            arm.dq,
            *network_inputs(coordinates, neighbours, "m/s"),
            *_outputs(arm, coordinates, neighbours),
            *gains(arm),
            *_task(coordinates),
            *(_turn(arm) if turning else ()),
            *_null(arm),
            *(_network(coordinates, neighbours) if neighbours else ()),
            *chain.variables(arm),
        ),
        sources=(
            *(*_SOURCES, *(("tip_turn.h",) if turning else ())),
            *("neighbours.h", *serial_arm.SOURCES),
        ),
        defines=(("NETWORKED", int(neighbours > 0)), ("TASK", 1), ("TURN", int(turning))),
        step=1e-3,
        terminals=(
            Terminal("joints", ("q", "dq", "tau"), "Position and velocity in, torque out"),
            *((network,) if neighbours else ()),
        ),
        documentation=__doc__ or "",
    )


def _outputs(arm: Joints, m: int, neighbours: int) -> tuple[Variable, ...]:
    received = ("xi_in", "w", "age") if neighbours else ()
    chained = tuple(v.name for v in chain.variables(arm))
    turn = ("q_0", "length") if m == 6 else ()
    where = ("joint_type", "rotation", "origin", "tip", "frame", "lacks", *turn, "scale")
    null = tuple(v.name for v in _null(arm))
    feedback = ("K", "K_x", "alpha", "lambda_M", "lambda_c", "tau_max", "gravity")
    network = ("lambda", "listens", "age_max", "age_fade") if neighbours else ()
    state = ("z", "theta_hat")
    task = ("tip", "frame", "lacks", *turn, "scale", "x_0", "sigma_0")
    everything = (*state, *feedback, *network, *task, *null, *chained)
    theta_hat, theta_hat_next = serial_arm.estimate(arm)
    size, motion = (m,), ("q", "dq")
    return (
        arm.torque((*motion, *received), everything, elementwise=False),
        Variable(
            *("xi", "output", size, "m/s", 0.0, "Signal sent: dx + alpha x"),
            depends=motion,
            start_depends=("alpha", "x_0", *where),
        ),
        Variable(
            *("x", "output", size, "m", 0.0, "Coordinates of the tip"),
            depends=("q",),
            start_depends=("x_0", *where),
        ),
        Variable(
            *("s", "output", (arm.count,), RATE, 0.0, "Sliding vector: dq - v"),
            depends=motion,
            start_depends=("z", "sigma_0", *null, *where),
        ),
        Variable(
            *("sigma", "output", (), "m/rad", 0.0, "About the least singular value of J / scale"),
            depends=("q",),
            start_depends=(*where[:-1], "sigma_0"),
        ),
        Variable(
            *("z", "output", size, "m/s", 0.0, "State of the dynamic feedback"), settable=True
        ),
        theta_hat,
        Variable("z_next", "local", size, "m/s", description="z of the next step"),
        theta_hat_next,
    )


def _task(m: int) -> tuple[Variable, ...]:
    rows = min(m, 3)
    unit = tuple(float(i == k) for i in range(rows) for k in range(3))
    return (
        Variable(
            *("K_x", "parameter", (m,), "N.s/m", 0.0, "Feedback gain of J s in each coordinate"),
            minimum=0.0,
        ),
        Variable("tip", "parameter", (3,), "m", 0.0, "Tip in the frame of the last link"),
        Variable(
            *("frame", "parameter", (rows, 3), "1", unit),
            "F: direction of each coordinate of the place in the base",
        ),
        Variable(
            *("lacks", "parameter", (m,), "1", 0.0, "1 for a coordinate that the arm lacks"),
            type="integer",
            minimum=0.0,
            maximum=1.0,
        ),
        Variable(
            *("scale", "parameter", (), "1", 1.0, "Coordinates per length of this arm's motion"),
            minimum=1e-6,
        ),
        Variable("x_0", "parameter", (3,), "m", 0.0, "Point of the base that has x = 0"),
        Variable(
            *("sigma_0", "parameter", (), "m/rad", 0.05),
            "Singular value of J / scale below which J# is damped",
            minimum=1e-6,
        ),
    )


def _turn(arm: Joints) -> tuple[Variable, ...]:
    text = "Length of the place that counts as much as a turn of 1 rad"
    return (
        arm.vector("q_0", "parameter", "rad", "Posture in which the turn is 0"),
        Variable("length", "parameter", (), "m", 0.3, text, minimum=1e-6),
        Variable("R_0", "local", (3, 3), "1", description="Orientation of the tip there"),
    )


def _null(arm: Joints) -> tuple[Variable, ...]:
    return (
        arm.vector("q_n", "parameter", "rad", "Posture of the null motion"),
        arm.gain("k_n", "1/s", 0.0, "Rate of the null motion towards q_n"),
        arm.vector("q_min", "parameter", "rad", "Lower limit of the joint", -_FREE),
        arm.vector("q_max", "parameter", "rad", "Upper limit of the joint", _FREE),
        arm.gain("k_l", "1/s", 0.0, "Rate of the null motion away from a limit"),
        arm.gain("margin", "rad", 0.2, "Distance of a limit at which this begins", 1e-6),
        arm.gain("psi_max", RATE, 1.0, "Limit of the null motion", 1e-6),
    )


def _network(m: int, neighbours: int) -> tuple[Variable, ...]:
    text = "Part of each neighbour's coordinates that counts, 0 = not"
    listens = Variable("listens", "parameter", (neighbours, m), "1", 1.0, text, minimum=0.0)
    return (*coupling_gains(), listens)


def law(x: Values, t: float, h: float, q: Array, dq: Array, *network: Array) -> Values:
    """The equations above; z and theta_hat advance to t + h, s.

    `q`, `dq` (n,) rad, rad/s. `network`: xi_in (k, m) m/s, w (k,) without a unit and age (k,) s of
    k neighbours, or nothing.
    """
    z, scale, J = x["z_next"], task_space.scales(x), task_space.rows(x, q)
    at = task_space.place(x, q)
    dx = scale * (J @ dq)
    xi = dx + x["alpha"] * at
    pull, stale = _coupling(x, xi, *network) if network else (np.zeros_like(xi), False)
    dz = -x["alpha"] * dx + x["lambda_M"] * (dx - z) - pull
    v = task_space.velocity(x, q, z / scale)
    a = task_space.acceleration(x, q, dq, z / scale, dz / scale)
    feedback = x["K"] * (dq - v) + J.T @ (scale**2 * x["K_x"] * (J @ (dq - v)))
    given = {"xi": xi, "x": at, "sigma": task_space.inverse(x, J)[1]}
    return given | controlled(x, h, q, dq, Wanted(v, a, dz, feedback, stale))


def _coupling(x: Values, xi: Array, xi_in: Array, w: Array, age: Array) -> tuple[Array, bool]:
    """The coupling of each coordinate, (m,) m/s2, without those that are missing; whether stale."""
    pull = [
        coupling(x, xi[[c]], xi_in[:, [c]], w * listens, age)[0][0]
        for c, listens in enumerate(x["listens"].T)
    ]
    stale = coupling(x, xi, xi_in, w, age)[1]
    return np.where(task_space.has(x), pull, 0.0), stale


def start(x: Values, *inputs: Array) -> Values:
    """State at the start. Raises ScenarioError for values that cannot be."""
    if not task_space.has(x).any():
        raise ScenarioError("the arm lacks every coordinate, expected one", "arm_task.lacks")
    if "length" in x and not chain.is_rotation(x["frame"]):
        raise ScenarioError("no rotation matrix, expected one for the turn", "arm_task.frame")
    return checked(x, "arm_task")


fmu, kernel, ArmTask = derive(model, law, start)
prepare = of_robot(model)


def shared_base(
    options: Mapping[str, Any], parameters: Mapping[str, Any], folder: Path
) -> SharedBase | None:
    """The base of the arm in the coordinates x, in which the arms agree; None for one coordinate.

    Of two coordinates the third is at right angles to them. Raises ScenarioError as `prepare`.
    """
    from cosim.base.convert import number, numbers  # not where FMUs are built

    values = {**(prepare(options, folder).values if "urdf" in options else {}), **parameters}
    rows = list(values.get("frame", ((1, 0, 0), (0, 1, 0), (0, 0, 1))))
    F = np.reshape(numbers(rows, (len(rows), 3), "1", "frame"), (-1, 3))
    F = np.vstack([F, np.cross(F[0], F[1])]) if len(F) == 2 else F
    if F.shape != (3, 3) or not chain.is_rotation(F):
        return None
    return SharedBase(
        tuple(F.ravel().tolist()),
        numbers(values.get("x_0", 0.0), (3,), "m", "x_0"),
        number(values.get("scale", 1.0), "1", "scale"),
        numbers(values.get("tip", 0.0), (3,), "m", "tip"),
    )
