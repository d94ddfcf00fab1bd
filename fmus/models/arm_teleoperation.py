"""The paper's adaptive controller for a serial arm of n joints: one arm, a pair, or a network.

The law of ``teleoperation`` with the regressor of any serial chain instead of the planar arm's, for
one arm and its neighbours j::

    xi         = dq + alpha q                                                  sent, (47)
    dz         = -alpha dq + lambda_M (dq - z) - lambda Σ_j w_j (xi - xi_in_j)
    s          = dq - z
    tau        = -K s + Y(q, dq, z, dz) theta_hat + J dz
    dtheta_hat = -Gamma Y'(q, dq, z, dz) s

    neighbours = 0                  (29)-(32), Theorem 2, without the coupling
    lambda = 1, w_ij in w           (42)-(45), Theorem 3; with delayed xi_in (61), Theorem 4
    neighbours = 1, w = 1           (76)-(81), Theorem 5

theta_hat has the ten inertial parameters of each link, in the order of ``chain``; M, C and the
regressor are those of ``chain_law``. The theorems hold for it, since they need of an arm its
linearity in the parameters and dM/dt - 2 C skew-symmetric (Properties 1 to 3); the parameters need
not be identifiable one by one. J is the inertia of the rotors (`armature`), which is known. The
inertia in the table is used only for gravity that is compensated.

Gamma has an entry for each parameter; 0 keeps a parameter at its start. Its units are those of the
parameter squared per J.s (kg2 for a mass, (kg.m)2, (kg.m2)2): a gain that suits the masses is too
high for the moments of light links by orders of magnitude, so that the default is 1 for m, 0.1 for
m c and 0.01 for I. The start of theta_hat is 0, or a part of what a URDF file says with
`options.urdf` and `options.estimate` (0.8, for example). With `natural` > 0 in place of Gamma,
theta_hat remains the inertia of bodies (``natural``), and must start as such.

gravity selects the treatment of g(q):

    0  none         gravity is ignored, as for an arm in a horizontal plane
    1  compensated  tau += g(q) of the table's inertia; theta_hat concerns M and C only
    2  adapted      Y contains gravity, so that theta_hat adapts it. The estimate then absorbs a
                    constant push: the arm stops, and reflected torques decay (``teleoperation``)

Options, off by default, as of ``teleoperation``: `tau_max` limits each joint's torque, and while
any joint is at its limit z and theta_hat are not updated. `theta_min` and `theta_max` clip
theta_hat after each step, for example to masses that are not negative. `age_max` and `age_fade`
treat edges that bring old signals. `lambda_c` > 0 (Remark 3) replaces K s by lambda_c M_hat s.

Sampled: outputs as of t_k; z and theta_hat advance by one step of the explicit Euler method to
t_k + h. K_i h must be small against the inertia of joint i: light wrists need short steps or
small gains.

Source: the paper, eqs (29)-(32), (42)-(45), (47), (61), (76)-(81), Remark 3, Theorems 2 to 5.
"""

from __future__ import annotations

from typing import NamedTuple

from cosim.base.errors import ScenarioError
from fmus.arms import chain, serial_arm
from fmus.arms.adaptive_variables import UNLIMITED, coupling_gains, network_inputs
from fmus.arms.joints import DAMPING, RATE, TORQUE, Joints, rate
from fmus.arms.natural import adapted
from fmus.arms.robot import of_robot
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import Array, np
from fmus.models.teleoperation import coupling

_NATURAL = "Rate of natural adaptation in place of Gamma, 0 = off"


def model(joints: int = 7, neighbours: int = 1) -> Model:
    """Declare the controller of an arm of `joints` that receives xi from `neighbours` >= 0.

    Raises FmuError for a number of joints that is not a whole number from 1 to 16, and
    ScenarioError for less than no neighbour.
    """
    if neighbours < 0:
        raise ScenarioError(
            f"neighbours is {neighbours}, expected at least 0", "fmus.models.arm_teleoperation"
        )
    arm = Joints(joints)
    whom = f"{neighbours} neighbour(s)" if neighbours else "one arm alone"
    network = Terminal("network", ("xi", "xi_in", "w", "age"), "Signals of the neighbours")
    stem = "arm_teleoperation" if neighbours else "arm_adaptive"
    return Model(
        identifier=f"{stem}_n{neighbours}" if neighbours > 1 else stem,
        description=f"Adaptive controller of a serial arm with dynamic feedback, {whom}",
        kind="sampled",
        variables=(
            arm.q,
            arm.dq,
            *network_inputs(joints, neighbours),
            *_outputs(arm, neighbours),
            *gains(arm),
            *(coupling_gains() if neighbours else ()),
            *chain.variables(arm),
        ),
        sources=("arm_teleoperation.c", "natural.h", "neighbours.h", *serial_arm.SOURCES),
        defines=(("NETWORKED", int(neighbours > 0)), ("TASK", 0)),
        step=1e-3,
        terminals=(
            Terminal("joints", ("q", "dq", "tau"), "Position and velocity in, torque out"),
            *((network,) if neighbours else ()),
        ),
        documentation=__doc__ or "",
        lanes=True,
    )


def _outputs(arm: Joints, neighbours: int) -> tuple[Variable, ...]:
    received = ("xi_in", "w", "age") if neighbours else ()
    gains = ("K", "alpha", "lambda_M", "lambda_c", "tau_max", "gravity")
    network = ("lambda", "age_max", "age_fade") if neighbours else ()
    table = tuple(v.name for v in chain.variables(arm))
    starts = ("z", "theta_hat", *gains, *network, *table)
    theta_hat, theta_hat_next = serial_arm.estimate(arm)
    return (
        arm.torque(("q", "dq", *received), starts, elementwise=False),
        arm.signal("xi", RATE, "Signal sent: dq + alpha q", ("q", "dq"), ("alpha",)),
        arm.signal("s", RATE, "Sliding vector: dq - z", ("dq",), ("z",)),
        arm.vector("z", "output", RATE, "State of the dynamic feedback", settable=True),
        theta_hat,
        arm.local("z_next", RATE, "z of the next step"),
        theta_hat_next,
    )


def gains(arm: Joints) -> tuple[Variable, ...]:
    """Parameters of the law, without those of the coupling: gains, bounds and limits."""
    size = (arm.count, 10)
    text = "Feedback lambda_c M_hat s in place of K s (Remark 3), 0 = off"
    return (
        arm.gain("K", DAMPING, 10.0, "Feedback gain of s"),
        serial_arm.adaptation(arm),
        Variable("natural", "parameter", (), "1/J", 0.0, _NATURAL, minimum=0.0),
        Variable("theta_min", "parameter", size, "1", -UNLIMITED, "Lower bound of theta_hat"),
        Variable("theta_max", "parameter", size, "1", UNLIMITED, "Upper bound of theta_hat"),
        rate("alpha", 0.5, "Gain of q in xi"),
        rate("lambda_M", 10.0, "Manipulability gain"),
        rate("lambda_c", 0.0, text),
        arm.vector("tau_max", "parameter", TORQUE, "Limit of the torque", UNLIMITED, 0.0),
        serial_arm.gravity(),
    )


def law(x: Values, t: float, h: float, q: Array, dq: Array, *network: Array) -> Values:
    """The equations above; z and theta_hat advance to t + h, s.

    `q`, `dq` (n,) rad, rad/s. `network`: xi_in (k, n) rad/s, w (k,) without a unit and age (k,) s
    of k neighbours, or nothing.
    """
    z = x["z_next"]
    xi = dq + x["alpha"] * q
    pull, stale = coupling(x, xi, *network) if network else (np.zeros_like(q), False)
    dz = -x["alpha"] * dq + x["lambda_M"] * (dq - z) - pull
    wanted = Wanted(z, dz, dz, x["K"] * (dq - z), stale)
    return {"xi": xi} | controlled(x, h, q, dq, wanted)


class Wanted(NamedTuple):
    """The motion that the torque follows: `v`, `a` (n,) velocity and acceleration, rad/s, rad/s2.

    `dz`: rate of the state z; `feedback` (n,) of s, N.m, in whose place lambda_c M_hat s stands
    with `lambda_c` > 0; `stale`: whether a neighbour's signal is too old.
    """

    v: Array
    a: Array
    dz: Array
    feedback: Array
    stale: bool


def controlled(x: Values, h: float, q: Array, dq: Array, wanted: Wanted) -> Values:
    """Torque and s; z and theta_hat, and those a step h, s, later; `q`, `dq` (n,) rad, rad/s."""
    z, theta_hat, s = x["z_next"], x["theta_hat_next"], dq - wanted.v
    Y, known = serial_arm.linear(x, q, dq, wanted.v, wanted.a - x["lambda_c"] * s)
    free = Y @ theta_hat.ravel() + known - (0.0 if x["lambda_c"] > 0 else wanted.feedback)
    tau = np.clip(free, -x["tau_max"], x["tau_max"])
    now = {"tau": tau, "s": s, "z": z, "theta_hat": theta_hat}
    if (tau != free).any():
        return now | {"z_next": z, "theta_hat_next": theta_hat}
    if not wanted.stale:
        following = _adapted(x, theta_hat, (Y.T @ s).reshape(theta_hat.shape), h)
        theta_hat = np.clip(following, x["theta_min"], x["theta_max"])
    return now | {"z_next": z + h * wanted.dz, "theta_hat_next": theta_hat}


def start(x: Values, *inputs: Array) -> Values:
    """State at the start. Raises ScenarioError, also where theta_hat is outside of its bounds."""
    return checked(x, "arm_teleoperation")


def checked(x: Values, place: str) -> Values:
    """State at the start; `place` of the messages. Raises ScenarioError for values of `x`."""
    chain.check(chain.of_values(x), place)
    low, start, high = x["theta_min"], x["theta_hat"], x["theta_max"]
    for i in np.argwhere((start < low) | (start > high)):
        at = tuple(i)
        raise ScenarioError(
            f"starts at {start[at]:g}, expected from {low[at]:g} to {high[at]:g}",
            f"{place}.theta_hat[{at[0]},{at[1]}]",
        )
    for link, theta in enumerate(x["theta_hat"]):
        if x["natural"] > 0 and (theta[0] <= 0 or chain.unphysical(theta) is not None):
            raise ScenarioError(
                "no body has these parameters; natural adaptation starts from one (`estimate`)",
                f"{place}.theta_hat[{link}]",
            )
    if "lambda" in x and x["alpha"] <= 0:
        raise ScenarioError("alpha is 0, expected more than 0 with neighbours", place)
    return {"z_next": x["z"], "theta_hat_next": x["theta_hat"]}


def _adapted(x: Values, theta_hat: Array, Ys: Array, h: float) -> Array:
    """theta_hat (n, 10) a step h, s, later; `Ys` (n, 10) is Y' s."""
    if x["natural"] <= 0:
        return np.asarray(theta_hat - h * x["Gamma"] * Ys)
    steps = h * float(x["natural"])
    return np.array([adapted(theta, ell, steps) for theta, ell in zip(theta_hat, Ys, strict=True)])


fmu, kernel, ArmTeleoperation = derive(model, law, start)
prepare = of_robot(model)
