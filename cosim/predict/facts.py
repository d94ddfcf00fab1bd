"""Facts that a model states about itself, so that predictions need no other knowledge of it.

Nothing in :mod:`cosim` knows a robot or a law. What does is the module a scenario names, and it may
offer a function::

    def facts(values: Mapping[str, tuple[float, ...]]) -> Facts | None

or, if it does not, its package may have a module ``facts`` with a table ``FACTS`` from the module's
last name to such a function. `values` holds every parameter, start value and input that nothing
feeds, flattened, by name, as they are in the scenario. What comes back is one of the structs below.
A model without facts runs as well; it is only predicted less.

SI throughout; vectors have one entry a joint.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from math import inf
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from cosim.base.convert import Struct
from cosim.mujoco import PREFIX

Array = NDArray[np.float64]
Vector: TypeAlias = tuple[float, ...]
Values: TypeAlias = Mapping[str, Vector]
Gravity = Literal["none", "compensated", "adapted"]
#: In the order of the values of a parameter `gravity`.
GRAVITY: tuple[Gravity, ...] = get_args(Gravity)


class Spring(Struct, frozen=True, kw_only=True):
    """A spring and a damper to `place` (rad): stiffness N.m/rad, damping N.m.s/rad.

    `names`: what stiffness, damping and place are called in the model, so that they can be set.
    """

    stiffness: Vector
    damping: Vector
    place: Vector
    names: tuple[str, str, str]

    @property
    def is_present(self) -> bool:
        """True if it does anything."""
        return any(self.stiffness) or any(self.damping)


class Arm(Struct, frozen=True, kw_only=True, eq=False):
    """A robot, M(q) ddq + C dq + g + damping dq = tau + tau_ext + tau_h - tau_e.

    `inertia(parameters, q)` is M, (m, m), kg.m2, for any parameters, `parameters` those that are
    true; `inertia_range` the least and greatest eigenvalue of M(q) over the workspace, `heaviest` a
    posture that has the greatest; `gravity` the parameters of g, all 0 if there is none, N.m;
    `weight(gravity, q)` is g, (m,), N.m, where it is known; `q` where it starts; `damping` is the
    viscous friction, N.m.s/rad, () for none; `h_max` the longest step that the integrator of grip
    and wall takes in a communication step, as a share of it.

    `workspace`: M in `postures`, which stand for the workspace, (k, m, m) kg.m2 and (k, m) rad. A
    model whose joints differ gives them: the least eigenvalue of M belongs to one joint, and the
    greatest gain perhaps to another. `lower`, `upper`: limits of the joints at which no stop acts,
    rad, infinite where there is none, () for none at all; `doubts`: sentences about numbers of its
    links that are hardly right.

    The strings are names of ports: control torque in, external torque in, position, velocity,
    torque of the operator and torque on the environment out.
    """

    inertia: Callable[[Sequence[float], Sequence[float]], Array]
    parameters: Vector
    inertia_range: tuple[float, float]
    heaviest: Vector
    gravity: Vector
    q: Vector
    grip: Spring
    wall: Spring
    damping: Vector = ()
    weight: Callable[[Sequence[float], Sequence[float]], Array] | None = None
    workspace: Array | None = None
    postures: Array | None = None
    h_max: float = 1.0
    lower: Vector = ()
    upper: Vector = ()
    doubts: tuple[str, ...] = ()
    torque: str = "tau"
    external: str = "tau_ext"
    position: str = "q"
    rate: str = "dq"
    hand: str = "tau_h"
    environment: str = "tau_e"

    @property
    def friction(self) -> Vector:
        """The viscous friction of each joint, N.m.s/rad."""
        return self.damping or (0.0,) * len(self.q)

    def slowest(self, gains: Sequence[float]) -> tuple[float, int, Vector]:
        """The least eigenvalue of M⁻¹ diag(gains) in the workspace, the joint, and the posture.

        `gains`: one for all joints or one each, N.m.s/rad (the result is 1/s) or N.m/rad (1/s²).
        """
        if self.workspace is None or self.postures is None:
            gain = min(gains)
            return float(gain) / self.inertia_range[1], list(gains).index(gain), self.heaviest
        each = np.broadcast_to(np.asarray(gains, dtype=np.float64), (len(self.q),))
        root = np.sqrt(each)
        values, vectors = np.linalg.eigh(root[:, None] * np.linalg.inv(self.workspace) * root)
        k = int(np.argmin(values[:, 0]))
        joint = int(np.argmax(np.abs(vectors[k, :, 0])))
        return float(values[k, 0]), joint, tuple(self.postures[k].tolist())


class TipTask(Struct, frozen=True, kw_only=True):
    """The coordinates of a tip, (k,), in which a law couples in place of the joints, (m,).

    `jacobian(q)` is J (k, m), and `feedback(q)` the gain of s, (m, m), N.m.s/rad; `regular(q)` how
    far from a singularity a posture is: 1 where the inverse of J begins to be damped, 0 in it.
    `lacks`: 1 for a coordinate that the arm does not have; `listens`: a row a neighbour, 0 for
    those that do not count. `posture`: whether what the tip leaves free has a place to go to.
    """

    jacobian: Callable[[Sequence[float]], Array]
    feedback: Callable[[Sequence[float]], Array]
    regular: Callable[[Sequence[float]], float]
    lacks: Vector
    listens: tuple[Vector, ...] = ()
    posture: bool = True

    def has(self, c: int) -> bool:
        """True if the arm has the coordinate `c`."""
        return c < len(self.lacks) and not self.lacks[c]

    def hears(self, row: int, c: int) -> bool:
        """True if coordinate `c` of the neighbour of a row counts."""
        return self.has(c) and (row >= len(self.listens) or self.listens[row][c] > 0)


class DynamicFeedback(Struct, frozen=True, kw_only=True):
    """The law of the paper, one robot and its neighbours j, eqs (29)-(32), (42)-(45), (76)-(81)::

        dz  = -alpha dq + lambda_M s - lambda Σ_j w_j (xi - xi_j),   s = dq - z,   xi = dq + alpha q
        tau = -K s + Y(q, dq, z, dz) theta_hat,   dtheta_hat = -Gamma Yᵀ s

    `lambda_c` > 0: K is lambda_c M_hat (Remark 3). `z`, `theta_hat`: at the start. `theta_g`: the
    gravity parameters that are compensated. `regressor`: root mean square of ‖Y(q, 0, 0, dz)‖/|dz|
    over postures and directions. `tau_max`: limit of the torque; `age_max`: age beyond which what
    was received is not used, s, inf where there is no limit. `task`: xi and z are those of the
    coordinates of a tip; closed forms, which take each joint alone, then do not apply.

    A law whose command is a velocity, to a :class:`Servo`, has the servo's gain as its own: K = ().
    `feeds_forward`: whether the law has the term with Y; `beyond`: why closed forms do not hold for
    it, or "".

    The strings are names: torque out, received signals (a row a neighbour), their weights and ages,
    the start value of the estimate ("" where it cannot be that of the arm), adaptation gains.
    """

    K: Vector
    Gamma: Vector
    alpha: float
    lambda_M: float
    lambda_: float = 0.0
    lambda_c: float = 0.0
    z: Vector = ()
    theta_hat: Vector = ()
    gravity: Gravity = "none"
    theta_g: Vector = ()
    regressor: float = 0.0
    tau_max: Vector = (inf,)
    age_max: float = inf
    task: TipTask | None = None
    torque: str = "tau"
    received: str = ""
    weights: str = ""
    age: str = ""
    estimate: str = "theta_hat"
    adaptation: Sequence[str] = ("Gamma",)
    feeds_forward: bool = True
    beyond: str = ""

    @property
    def feedback(self) -> Vector:
        """The gain of the velocity, N.m.s/rad; none where it follows the estimate (Remark 3)."""
        return (0.0,) * len(self.K) if self.lambda_c else self.K


class SpringDamper(Struct, frozen=True, kw_only=True):
    """A coupling by a spring with the delayed position of another robot, and damping to the ground.

    `feedback`: total gain of the own velocity, N.m.s/rad, of which `ground` is to the ground;
    `stiffness` of the coupling, N.m/rad. `needs_ground`: the law is passive only with enough of it
    for the round-trip delay, 2 ground >= T_rt stiffness. `constant_delay`: the law is proved for a
    constant delay only. `theta_g`: the gravity parameters that are compensated. `law`: its name in
    messages.
    """

    law: str
    feedback: Vector
    ground: Vector
    stiffness: Vector
    needs_ground: bool = True
    constant_delay: bool = False
    theta_g: Vector = ()
    tau_max: Vector = (inf,)
    torque: str = "tau"


class Hand(Struct, frozen=True, kw_only=True):
    """An operator as a separate component: tau_h = -k_d dq - k_p (q - q_h), sampled."""

    stiffness: Vector
    damping: Vector
    place: Vector


def combined_hand(hands: Sequence[Hand], m: int) -> Hand | None:
    """The hand that acts like all `hands` on an arm of `m` joints; None where none pulls.

    Stiffness and damping add up; the place is the mean, weighted by stiffness.
    """
    k, d, x = (
        np.array([np.broadcast_to(getattr(hand, name), (m,)) for hand in hands])
        for name in ("stiffness", "damping", "place")
    )
    stiffness = k.sum(axis=0)
    if not (stiffness > 0).all():
        return None
    place = (k * x).sum(axis=0) / stiffness
    return Hand(
        stiffness=tuple(stiffness.tolist()),
        damping=tuple(d.sum(axis=0).tolist()),
        place=tuple(place.tolist()),
    )


class Servo(Struct, frozen=True, kw_only=True):
    """The inner loop of a robot that takes positions or velocities, between an arm and commands.

    tau = K_v (f dq_r - dq) + K_p (q_r - q): `feed_forward` f, 1 for velocities. `command`: the name
    of the input that it reads; `by_position`: whether that is a position, which the reference
    reaches along a line in the time `T_c`, s. `v_max` limits its velocity, rad/s.
    """

    K_v: Vector
    K_p: Vector
    feed_forward: float
    by_position: bool
    command: str
    T_c: float = 0.0
    v_max: Vector = (inf,)
    tau_max: Vector = (inf,)


class ServoCommand(Struct, frozen=True, kw_only=True):
    """A component that turns a torque (input `torque`) into a command of a servo like `servo`."""

    servo: Servo
    torque: str = "tau"


class TipContact(Struct, frozen=True, kw_only=True):
    """Springs and dampers at the tip of an arm, in a separate, sampled component.

    `hand` and `wall`: stiffness N/m and damping N.s/m of the stiffest direction; `jacobian(q)`
    (3, m) of the tip.
    """

    hand: tuple[float, float]
    wall: tuple[float, float]
    jacobian: Callable[[Sequence[float]], Array]


Law: TypeAlias = DynamicFeedback | SpringDamper
Facts: TypeAlias = Arm | DynamicFeedback | SpringDamper | Hand | Servo | ServoCommand | TipContact


def facts_function(model: str) -> Callable[[Values], Facts | None] | None:
    """The function that gives the facts of a model from its values; None for an FMU file, a scene
    of MuJoCo, or a model without one. Raises what importing the model raises.
    """
    if model.endswith(".fmu") or model.startswith(PREFIX):
        return None
    name = model.partition(":")[0]
    own = vars(importlib.import_module(name)).get("facts")
    if callable(own):
        return own  # type: ignore[no-any-return]
    package, _, last = name.rpartition(".")
    if not package or find_spec(f"{package}.facts") is None:
        return None
    table = vars(importlib.import_module(f"{package}.facts")).get("FACTS", {})
    function: Callable[[Values], Facts | None] | None = table.get(last)
    return function
