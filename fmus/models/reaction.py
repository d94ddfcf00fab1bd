"""Intent of a person who reacts late: moves the target of the hand towards a goal.

The grip of the arm is the passive impedance of hand and arm about the position q_h. This model is
the person who moves q_h, based on the position one reaction time τ ago, at no more than v_max::

    dp/dt = ω_c (q_g - q(t - τ)), each joint limited to ±v_max        p(0) = q(0)
    q_h   = p + a sin(2π f t)

If the grip is stiff enough, q follows q_h, and the loop is ω_c exp(-jωτ)/(jω), the crossover model.
It is stable for ω_c τ < π/2. a is the amplitude of a tremor, which has f = 8 to 10 Hz in people.

The output is wired to the input q_h of ``planar2r``; the torque on the robot remains the tau_h of
the grip. τ is rounded to whole steps, at most 63. Until τ has passed, q(0) is the observed
position.

Source: D. T. McRuer, H. R. Jex, "A review of quasi-linear pilot models", IEEE Trans. Human Factors
in Electronics 8(3), 1967; the limit, the tremor and the values are our own construction.

Sampled: q_h of t_k and dp/dt are held to the next step.
"""

from __future__ import annotations

from cosim.base.errors import RunError
from fmus.arms.joints import RATE, Joints
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import Array, np

#: Samples of q that are kept.
KEPT = 64

#: Reaction times to what is felt, and to what is seen (about 0.15 s and 0.2 s).
PRESETS: dict[str, dict[str, float]] = {
    "at once": {"reaction": 0.0},
    "felt": {"reaction": 0.15},
    "seen": {"reaction": 0.2},
}


def model(joints: int = 2) -> Model:
    """Declare the intent for an arm of `joints`; the defaults are ``felt``.

    The goal is Sec. VII's q_h by default, and 0 for another number of joints than two.
    """
    arm = Joints(joints)
    return Model(
        identifier="reaction",
        description="Intent of a person who reacts late: where the hand wants to be",
        kind="sampled",
        variables=(
            arm.q,
            arm.vector("q_h", "output", "rad", "Position the hand wants", start_depends=("q",)),
            arm.vector("q_g", "parameter", "rad", "Goal", (3.5, 3.0)),
            Variable("omega_c", "parameter", (), "1/s", 2.0, "Crossover frequency", minimum=0.0),
            Variable("reaction", "parameter", (), "s", 0.15, "Reaction time τ", minimum=0.0),
            Variable("v_max", "parameter", (), RATE, 1.0, "Largest speed of q_h", minimum=0.0),
            Variable("tremor", "parameter", (), "rad", 0.0, "Amplitude a of the tremor"),
            Variable("f", "parameter", (), "1/s", 9.0, "Frequency of the tremor", minimum=0.0),
            arm.local("p", "rad", "Position wanted without tremor"),
            Variable("past", "local", (joints * KEPT,), "rad", description="Positions seen"),
            Variable("k", "local", (), "1", description="Steps taken"),
        ),
        sources=("reaction.c", "trig.c"),
        step=5e-3,
        terminals=(Terminal("intent", ("q", "q_h"), "Position in, position wanted out"),),
        documentation=__doc__ or "",
    )


def law(x: Values, t: float, h: float, q: Array) -> Values:
    """q_h (m,) rad at `t` (s), and the state a step `h` (s) later; `q` (m,) rad.

    Raises RunError where the reaction time is too many steps.
    """
    k, late = int(x["k"]), _steps(x, h, t)
    past = x["past"].reshape(KEPT, q.size).copy()
    past[k % KEPT] = q
    wanted = x["omega_c"] * (x["q_g"] - past[max(k - late, 0) % KEPT])
    p = x["p"] + h * np.clip(wanted, -x["v_max"], x["v_max"])
    shake = x["tremor"] * np.sin(2 * np.pi * x["f"] * t)
    return {"q_h": x["p"] + shake, "p": p, "past": past.ravel(), "k": np.array(k + 1.0)}


def _steps(x: Values, h: float, t: float) -> int:
    steps = float(x["reaction"]) / h + 0.5
    if not steps < KEPT:
        raise RunError(f"the reaction time is more than {KEPT - 1} steps", time=t)
    return int(steps)


def start(x: Values, q: Array) -> Values:
    """The hand starts where the arm is: `q` (m,) rad, which is all that was seen before."""
    return {"q_h": q, "p": q, "past": np.tile(q, KEPT), "k": np.array(0.0)}


fmu, kernel, Reaction = derive(model, law, start)
