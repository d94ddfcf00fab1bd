"""Facts of a serial arm of n joints, and of the laws that have its table.

The inertia of an arm depends on most of its joints. A fixed set of postures within the limits
stands for the workspace: random ones of a fixed seed, the start, and the place of the hand. The
extremes over them are close to those of the workspace, but no bounds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from math import inf, pi

from cosim.base.copies import replace
from cosim.predict.facts import (
    GRAVITY,
    Arm,
    DynamicFeedback,
    Servo,
    ServoCommand,
    Spring,
    SpringDamper,
    Values,
    Vector,
)
from fmus.arms import chain
from fmus.arms.chain import Table
from fmus.arms.chain_law import regressor
from fmus.model.numeric import Array, np
from fmus.models.arm import FREE

#: Random postures that stand for the workspace, and for the mean size of a regressor.
_POSTURES, _FEW = 256, 16
#: A radius of gyration and a distance that raise no doubt, m, and in lengths of the arm.
_SMALL, _LENGTHS = 1.0, 2.0


def table_of(values: Values, inertia: Sequence[float] | None = None) -> Table:
    """The table among the `values` of a model; `inertia` (10 n,) in SI, kg, in place of its own."""
    n = len(values["armature"])
    return Table(
        joint_type=np.asarray(values["joint_type"]),
        rotation=np.reshape(values["rotation"], (n, 3, 3)),
        origin=np.reshape(values["origin"], (n, 3)),
        inertia=np.reshape(values["inertia"] if inertia is None else inertia, (n, 10)),
        armature=np.asarray(values["armature"], dtype=np.float64),
        g=np.asarray(values["g"], dtype=np.float64),
    )


def weights(values: Values) -> Vector:
    """The parameters of gravity in a table, (k,), all 0 without gravity.

    m (kg) and m c (kg.m) of each link, and g, m/s2.
    """
    moments = np.reshape(values["inertia"], (-1, 10))[:, :4].ravel()
    found = (*moments.tolist(), *values["g"])
    return found if any(values["g"]) else (0.0,) * len(found)


def arm(values: Values) -> Arm:
    """The arm: M from its table, viscous friction, grip and wall inside."""
    table, n = table_of(values), len(values["armature"])
    scale = values.get("grip", (1.0,))[0]
    grip = Spring(
        stiffness=tuple(scale * k for k in values["k_p"]),
        damping=tuple(scale * k for k in values["k_d"]),
        place=values.get("q_h", (0.0,) * n),
        names=("k_p", "k_d", "q_h"),
    )
    wall = Spring(
        stiffness=values["k_w"],
        damping=values["b_w"],
        place=values["q_w"],
        names=("k_w", "b_w", "q_w"),
    )
    visited = (values["q"], grip.place) if grip.is_present else (values["q"],)
    postures = np.array([*visited, *_postures(values["q_min"], values["q_max"])])
    workspace = _inertias(table, postures)
    eigenvalues = np.linalg.eigvalsh(workspace)
    return Arm(
        inertia=lambda parameters, q: chain.mass_matrix(
            table_of(values, parameters[: 10 * n]), np.asarray(q, dtype=np.float64)
        ),
        parameters=values["inertia"],
        inertia_range=(float(eigenvalues.min()), float(eigenvalues.max())),
        heaviest=tuple(postures[int(np.argmax(eigenvalues[:, -1]))].tolist()),
        gravity=weights(values),
        q=values["q"],
        grip=grip,
        wall=wall,
        damping=values["damping"],
        weight=lambda gravity, q: _weight(table, gravity, np.asarray(q, dtype=np.float64)),
        workspace=workspace,
        postures=postures,
        h_max=1.0 / values["substeps"][0],
        lower=_limits(values, "q_min", -inf),
        upper=_limits(values, "q_max", inf),
        doubts=tuple(doubts(table)),
    )


def _limits(values: Values, name: str, none: float) -> Vector:
    """The limits that have no stop; `none` where a joint has a stop or no limit."""
    pairs = zip(values[name], values["k_s"], strict=True)
    return tuple(none if k_s > 0.0 or abs(limit) >= FREE else limit for limit, k_s in pairs)


def doubts(table: Table) -> Iterator[str]:
    """Links with the inertia of a body that is much greater than the arm, a sentence each.

    The radius of gyration sqrt(I / m), m, of what has the mass and the greatest principal moment.
    """
    lengths = np.linalg.norm(table.origin, axis=1)
    limit = max(_SMALL, _LENGTHS * float(lengths.sum()))
    for i, theta in enumerate(table.inertia):
        m, mc = theta[0], theta[1:4]
        if m <= 0.0:
            continue
        moment = float(np.linalg.eigvalsh(chain.about_centre(theta))[-1])
        radius, away = max(0.0, moment / m) ** 0.5, float(np.linalg.norm(mc) / m)
        if max(radius, away) > limit:
            yield (
                f"link {i} has {m:.4g} kg, {moment:.4g} kg.m2 (a radius of gyration of"
                f" {radius:.3g} m) and its centre of mass {away:.3g} m away, but the joints of the"
                f" arm are {lengths.sum():.3g} m apart"
            )


def _weight(table: Table, gravity: Sequence[float], q: Array) -> Array:
    """The torque of gravity g(q), (n,) N.m, of what :func:`weights` returns."""
    inertia = np.zeros((table.joints, 10))
    inertia[:, :4] = np.reshape(gravity[:-3], (-1, 4))
    still = np.zeros(table.joints)
    light = Table(
        table.joint_type, table.rotation, table.origin, inertia, still, np.asarray(gravity[-3:])
    )
    return chain.inverse(light, q, still, still)


@lru_cache(maxsize=8)
def _postures(low: Vector, high: Vector) -> Array:
    """Random postures within the limits, (k, n); half a turn each way where there is no limit."""
    free = np.asarray(high) - np.asarray(low) >= FREE
    least, most = np.where(free, -pi, low), np.where(free, pi, high)
    return np.random.default_rng(0).uniform(least, most, (_POSTURES, len(low)))


def _inertias(table: Table, q: Array) -> Array:
    """M + J of each posture, (k, n, n); `q` (k, n). The sum over links of J' I J."""
    k, n = q.shape
    M = np.broadcast_to(np.diag(table.armature), (k, n, n)).copy()
    J = np.zeros((k, 6, n))
    for i in range(n):
        J = _transform(table, i, q[:, i]) @ J
        J[:, :, i] = chain.axis(table, i)
        M += np.swapaxes(J, 1, 2) @ chain.spatial_inertia(table.inertia[i]) @ J
    return M


def _transform(table: Table, i: int, q: Array) -> Array:
    """X of link i, (k, 6, 6), for each entry of `q` (k,): as ``chain.transforms``."""
    R, r = np.broadcast_to(table.rotation[i], (len(q), 3, 3)), table.origin[i]
    place = np.broadcast_to(r, (len(q), 3)).copy()
    if table.joint_type[i]:
        place += np.outer(q, table.rotation[i][:, 2])
    else:
        turn = np.zeros((len(q), 3, 3))
        turn[:, 0, 0] = turn[:, 1, 1] = np.cos(q)
        turn[:, 1, 0], turn[:, 0, 1], turn[:, 2, 2] = np.sin(q), -np.sin(q), 1.0
        R = R @ turn
    transposed = np.swapaxes(R, 1, 2)
    crossed = np.zeros((len(q), 3, 3))
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        crossed[:, a, b], crossed[:, b, a] = -place[:, c], place[:, c]
    X = np.zeros((len(q), 6, 6))
    X[:, :3, :3] = X[:, 3:, 3:] = transposed
    X[:, 3:, :3] = -transposed @ crossed
    return X


# ---- laws ---------------------------------------------------------------------------------------


def adaptive(values: Values) -> DynamicFeedback:
    """The paper's law with the ten parameters of each link, alone or with neighbours."""
    network = "lambda" in values
    natural = values["natural"][0] > 0
    Gamma = (0.0,) * len(values["Gamma"]) if natural else values["Gamma"]
    gravity = GRAVITY[int(values["gravity"][0])]
    return DynamicFeedback(
        K=values["K"],
        Gamma=Gamma,
        alpha=values["alpha"][0],
        lambda_M=values["lambda_M"][0],
        lambda_=values["lambda"][0] if network else 0.0,
        lambda_c=values["lambda_c"][0],
        z=values["z"],
        theta_hat=values["theta_hat"],
        gravity=gravity,
        theta_g=weights(values),
        regressor=_regressor_size(values, Gamma),
        tau_max=values["tau_max"],
        age_max=values.get("age_max", (1e9,))[0],
        received="xi_in" if network else "",
        weights="w" if network else "",
        age="age" if network else "",
        adaptation=("natural",) if natural else ("Gamma",),
    )


def _regressor_size(values: Values, Gamma: Vector) -> float:
    """The size of Y as one gain for all parameters and joints would see it.

    The root mean square, over postures and directions of dz, of that Y for which
    max(Gamma) Y²/min(K) is the greatest eigenvalue of K^-½ Y Gamma Y' K^-½, per |dz|.
    """
    if not any(Gamma) or not min(values["K"]):
        return 0.0
    n = len(values["armature"])
    table, still = table_of(values), np.zeros(n)
    draw = np.random.default_rng(0)
    K, squares = np.asarray(values["K"]), []
    for _ in range(_FEW):
        q, dz = draw.uniform(-pi, pi, n), draw.normal(size=n)
        Y = regressor(table, q, still, still, dz / np.linalg.norm(dz), np.zeros(3)).reshape(n, -1)
        scaled = Y * np.sqrt(Gamma) / np.sqrt(K)[:, None]
        squares.append(np.linalg.norm(scaled, 2) ** 2)
    return float(np.sqrt(np.mean(squares) * K.min() / max(Gamma)))


def velocity(values: Values) -> DynamicFeedback:
    """The law for velocity-commanded arms: K is that of its servo, the estimates start from 0."""
    return DynamicFeedback(
        K=(),
        Gamma=values["Gamma"],
        alpha=values["alpha"][0],
        lambda_M=values["lambda_M"][0],
        lambda_=values["lambda"][0],
        z=values["z"],
        gravity=GRAVITY[int(values["gravity"][0])],
        age_max=values["age_max"][0],
        torque="dq_c",
        received="xi_in",
        weights="w",
        age="age",
        estimate="",
    )


def kinematic(values: Values) -> DynamicFeedback:
    """The coupling as a command, without a model of the arm."""
    return replace(
        velocity({**values, "Gamma": (0.0,), "gravity": (0.0,)}),
        feeds_forward=False,
        beyond="it is moved by a measured torque" if any(values["b"]) else "",
    )


def servo(values: Values) -> Servo:
    """The inner loop of a robot that takes positions or velocities."""
    by_position = values["mode"][0] == 1
    return Servo(
        K_v=values["K_v"],
        K_p=values["K_p"],
        feed_forward=values["feed_forward"][0] if by_position else 1.0,
        by_position=by_position,
        command="q_c" if by_position else "dq_c",
        T_c=values.get("T_c", (0.0,))[0],
        v_max=values["v_max"],
        tau_max=values.get("tau_max", (1e9,)),
    )


def servo_command(values: Values) -> ServoCommand:
    """The component that turns a torque into commands of a servo."""
    return ServoCommand(servo=servo(values))


def pd(values: Values) -> SpringDamper:
    """Spring and damper with gravity compensated; friction that is compensated drives the arm."""
    slope = _slope(values)
    feedback = tuple(d - s for d, s in zip(values["K_d"], slope, strict=True))
    return SpringDamper(
        law="PD",
        feedback=tuple(max(0.0, f) for f in feedback),
        ground=(0.0,) * len(feedback),
        stiffness=values["K_p"],
        theta_g=weights(values),
        tau_max=values["tau_max"],
    )


def _slope(values: Values) -> Vector:
    """The slope at rest of the friction that is compensated, N.m.s/rad."""
    terms = zip(values["F_v"], values["F_c"], values["v_c"], strict=True)
    return tuple(viscous + dry / speed for viscous, dry, speed in terms)
