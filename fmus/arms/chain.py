"""Dynamics of a serial chain of n joints, described by a table: what every model of one shares.

Link i and its frame sit on joint i. Joint i moves about (revolute) or along (prismatic) the z axis
of its frame, so that the pose of link i in the frame of its parent is::

    revolute     p_parent = R_i Rz(q_i) p + r_i
    prismatic    p_parent = R_i p + r_i + R_i e_z q_i

The parent of link 0 is the base. Each link has ten inertial parameters: m, m c (x y z) and I about
the origin of its frame (xx xy yy xz yz zz). The equation of motion, with `armature` J::

    (M(q) + diag J) ddq + C(q, dq) dq + g(q) = tau

Twists and wrenches are six numbers, angular part first, at the origin of a link's frame and in its
axes. Entries of q, dq and tau are in rad, rad/s and N.m for a revolute joint, in m, m/s and N for a
prismatic one.

Here stand the variables of the table and a reference in NumPy that follows the definitions: the
inertia matrix from the Jacobian of each link. ``chain.h`` and ``chain_forward.h`` compute the same
by recursive algorithms.

Source: R. Featherstone, Rigid Body Dynamics Algorithms, Springer, 2008; the limits of an inertia:
P. Wensing, S. Kim, J.-J. Slotine, "Linear matrix inequalities for physically consistent inertial
parameter identification", IEEE Robotics and Automation Letters 3(1), 2018.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import final

from cosim.base.copies import asdict, field_names
from cosim.base.errors import FmuError, ScenarioError
from fmus.arms.joints import Joints
from fmus.build.reference import Values
from fmus.model import Variable
from fmus.model.numeric import Array, np

#: Joints that a chain may have: the C code has arrays of this length.
MOST = 16
#: The part of a trace by which an inertia may miss the limits: a table has rounded numbers.
ROUNDING = 1e-9


@final
@dataclass(frozen=True, slots=True)
class Table:
    """A chain of n joints; shapes and units as of the variables that :func:`variables` declares."""

    joint_type: Array  # (n,), 0 revolute, 1 prismatic
    rotation: Array  # (n, 3, 3)
    origin: Array  # (n, 3), m
    inertia: Array  # (n, 10)
    armature: Array  # (n,), kg.m2
    g: Array  # (3,), m/s2

    @property
    def joints(self) -> int:
        """The number of joints."""
        return len(self.joint_type)

    def values(self) -> Values:
        """The table as values of the variables that have the same names and shapes."""
        return asdict(self)


def of_values(x: Values) -> Table:
    """The table among the values `x` of a model, which have the names, shapes and units of it."""
    return Table(**{name: x[name] for name in field_names(Table)})


def variables(arm: Joints) -> tuple[Variable, ...]:
    """The parameters of the table; by default equal rods of 0.3 m and 1 kg in a horizontal plane.

    Raises FmuError for more than 16 joints.
    """
    n = arm.count
    if n > MOST:
        raise FmuError(f"joints is {n}; expected at most {MOST}")
    unit = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    rod = (1.0, 0.15, 0.0, 0.0, 0.0005, 0.0, 0.03025, 0.0, 0.0, 0.03025)
    return (
        Variable(
            "joint_type",
            "parameter",
            (n,),
            description="0 revolute, about the z axis of its frame; 1 prismatic, along it",
            type="integer",
            minimum=0.0,
            maximum=1.0,
        ),
        Variable(
            *("rotation", "parameter", (n, 3, 3), "1", unit * n),
            "Axes of each link's frame at q = 0 in the frame of its parent, the columns of R",
        ),
        Variable(
            *("origin", "parameter", (n, 3), "m", (0.0,) * 3 + (0.3, 0.0, 0.0) * (n - 1)),
            "Origin r of each link's frame at q = 0 in the frame of its parent",
        ),
        Variable(
            *("inertia", "parameter", (n, 10), "1", rod * n),
            "Of each link m (kg), m c (x y z, kg.m) and I about the origin of its frame"
            " (xx xy yy xz yz zz, kg.m2)",
        ),
        arm.gain(
            "armature",
            "kg.m2",
            0.0,
            "Inertia of each motor's rotor at the joint: times the square of the gear ratio",
        ),
        Variable(
            *("g", "parameter", (3,), "m/s2", (0.0, 0.0, -9.81)), "Gravity in the frame of the base"
        ),
    )


# ---- kinematics -----------------------------------------------------------------------------


def poses(table: Table, q: Array) -> Iterator[tuple[Array, Array]]:
    """(R, r) of each link in the frame of its parent, (3, 3) and (3,) m; `q` (n,) rad or m."""
    for kind, R, r, angle in zip(table.joint_type, table.rotation, table.origin, q, strict=True):
        if kind:
            yield R, r + R[:, 2] * angle
        else:
            c, s = np.cos(angle), np.sin(angle)
            yield R @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), r


def placements(table: Table, q: Array) -> Iterator[tuple[Array, Array]]:
    """(R, r) of each link in the frame of the base, (3, 3) and (3,) m; `q` (n,) rad or m."""
    turned, place = np.eye(3), np.zeros(3)
    for R, r in poses(table, q):
        turned, place = turned @ R, place + turned @ r
        yield turned, place


def transforms(table: Table, q: Array) -> Iterator[Array]:
    """X of each link, (6, 6): a twist of the parent, given in the frame of the link."""
    for R, r in poses(table, q):
        X = np.zeros((6, 6))
        X[:3, :3] = X[3:, 3:] = R.T
        X[3:, :3] = -R.T @ skew(r)
        yield X


def axis(table: Table, i: int) -> Array:
    """S of joint i, (6,): about z or along z."""
    S = np.zeros(6)
    S[5 if table.joint_type[i] else 2] = 1.0
    return S


def jacobians(table: Table, q: Array) -> Iterator[Array]:
    """J of each link, (6, n): its twist is J dq; `q` (n,) rad or m."""
    J = np.zeros((6, table.joints))
    for i, X in enumerate(transforms(table, q)):
        J = X @ J
        J[:, i] = axis(table, i)
        yield J


def skew(a: Array) -> Array:
    """[a], (3, 3), with [a] b = a x b for every b; `a` (3,) in any unit."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def motion_cross(v: Array) -> Array:
    """V x, (6, 6): how a twist fixed in a frame that moves with the twist v changes."""
    w = skew(v[:3])
    return np.block([[w, np.zeros((3, 3))], [skew(v[3:]), w]])


# ---- inertia --------------------------------------------------------------------------------


def tensor(theta: Array) -> Array:
    """I about the origin of the frame, (3, 3) kg.m2, of ten parameters `theta` (10,)."""
    xx, xy, yy, xz, yz, zz = theta[4:]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def spatial_inertia(theta: Array) -> Array:
    """The inertia of a link, (6, 6): momentum per twist; `theta` (10,) as in the module."""
    m, mc = theta[0], skew(theta[1:4])
    return np.block([[tensor(theta), mc], [-mc, m * np.eye(3)]])


def about_centre(theta: Array) -> Array:
    """I about the centre of mass, (3, 3) kg.m2, of ten parameters `theta` (10,) with a mass."""
    m, mc = theta[0], theta[1:4]
    shift = (mc @ mc * np.eye(3) - np.outer(mc, mc)) / m
    return np.asarray(tensor(theta) - shift, dtype=np.float64)


def unphysical(theta: Array) -> str | None:
    """The reason why no body has the ten parameters `theta` (10,), or None where one has.

    A body has a density that is not negative: its pseudo-inertia [Σ, mc; mc', m] with
    Σ = ½ tr(I) - I is positive semidefinite. For a mass m > 0 this is the triangle inequality of
    the principal moments about the centre of mass. A link without mass has no inertia at all.
    """
    m, I = theta[0], tensor(theta)  # noqa: E741
    if m < 0.0:
        return f"the mass is {m:g} kg, expected at least 0"
    if m == 0.0:
        return "without mass, expected all ten parameters 0" if theta.any() else None
    moments = np.linalg.eigvalsh(about_centre(theta))
    allowed = ROUNDING * abs(np.trace(I))
    found = ", ".join(f"{moment:.4g}" for moment in moments)
    if moments[0] < -allowed:
        return f"principal moments {found} kg.m2 about the centre of mass, expected none below 0"
    if moments[0] + moments[1] < moments[2] - 2.0 * allowed:
        return (
            f"principal moments {found} kg.m2 about the centre of mass, expected none greater than"
            " the sum of the other two (triangle inequality)"
        )
    return None


def mass_matrix(table: Table, q: Array) -> Array:
    """M(q) + diag of the armature, (n, n) kg.m2 for revolute joints; `q` (n,) rad or m."""
    M = np.diag(table.armature)
    for theta, J in zip(table.inertia, jacobians(table, q), strict=True):
        M = M + J.T @ spatial_inertia(theta) @ J
    return M


# ---- dynamics -------------------------------------------------------------------------------


def inverse(table: Table, q: Array, dq: Array, ddq: Array) -> Array:
    """Tau (n,), N.m or N, of the motion q, dq, ddq (n,): recursive Newton-Euler algorithm."""
    X = list(transforms(table, q))
    v, a, wrenches = np.zeros(6), np.concatenate([np.zeros(3), -table.g]), []
    for i, theta in enumerate(table.inertia):
        S, inertia = axis(table, i), spatial_inertia(theta)
        v = X[i] @ v + S * dq[i]
        a = X[i] @ a + S * ddq[i] + motion_cross(v) @ S * dq[i]
        wrenches.append(inertia @ a - motion_cross(v).T @ inertia @ v)
    tau, wrench = table.armature * ddq, np.zeros(6)
    for i in reversed(range(table.joints)):
        wrench = wrench + wrenches[i]
        tau[i] += axis(table, i) @ wrench
        wrench = X[i].T @ wrench
    return tau


def forward(table: Table, q: Array, dq: Array, tau: Array) -> Array:
    """Ddq (n,), rad/s2 or m/s2, of the torques `tau` (n,) at q, dq (n,), by the inertia matrix."""
    bias = inverse(table, q, dq, np.zeros(table.joints))
    return np.asarray(np.linalg.solve(mass_matrix(table, q), tau - bias), dtype=np.float64)


def is_rotation(R: Array) -> bool:
    """True if R (3, 3), without a unit, is a rotation, to 1e-6."""
    return bool(np.abs(R @ R.T - np.eye(3)).max() <= 1e-6 and np.linalg.det(R) > 0.0)


def check(table: Table, place: str) -> None:
    """Raise ScenarioError at `place` for a table that no arm has; it says which link is wrong."""
    for i, (R, theta) in enumerate(zip(table.rotation, table.inertia, strict=True)):
        if not is_rotation(R):
            raise ScenarioError(
                f"found {R.tolist()}, expected a rotation matrix", f"{place}.rotation[{i}]"
            )
        if (why := unphysical(theta)) is not None:
            raise ScenarioError(why, f"{place}.inertia[{i}]")
