"""Encoder of each joint: the quantised position, and a velocity made from its differences.

The velocity is the difference of two quantised positions over the sample time h, through a filter
of first order with the time constant T::

    q_m  = resolution round(q / resolution)             q where resolution = 0
    dq_m = dq_m' + h / (h + T) ((q_m - q_m') / h - dq_m')

A prime marks the value of the step before. At the start, q_m' = q_m and dq_m = 0. One count changes
the unfiltered velocity by resolution / h, so that a fast loop with a coarse encoder needs T > 0; in
return, the velocity is late by about T.

Source: the simplest of the estimators in R. H. Brown, S. C. Schneider, M. G. Mulligan, "Analysis of
algorithms for velocity estimation from discrete position versus time data", IEEE Trans. Industrial
Electronics 39(1), 1992.

Sampled: the input is read at t_k, outputs are held to the next step. The component stands between
an arm and its controller, which then read q_m and dq_m instead of q and dq.
"""

from __future__ import annotations

from math import pi

from fmus.arms.joints import RATE, Joints
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import Array, np

#: Encoders with one count of a turn: magnetic ones with 14 bits, optical ones with 20 bits.
PRESETS: dict[str, dict[str, float]] = {
    "14-bit": {"resolution": 2 * pi / 2**14},
    "20-bit": {"resolution": 2 * pi / 2**20},
}


def model(joints: int = 2) -> Model:
    """Declare the encoders of `joints`; by default ideal positions, and differences unfiltered."""
    arm = Joints(joints)
    return Model(
        identifier="encoder",
        description="Encoders: quantised positions, and velocities by differences and a filter",
        kind="sampled",
        variables=(
            arm.q,
            arm.signal("q_m", "rad", "Measured position", ("q",), ("resolution",)),
            arm.signal("dq_m", RATE, "Velocity of the measured position", ("q",)),
            arm.gain("resolution", "rad", 0.0, "Position of one count, 0 = ideal"),
            Variable("T", "parameter", (), "s", 0.0, "Time constant of the filter", minimum=0.0),
            arm.local("q_last", "rad", "q_m of the step before"),
        ),
        sources=("encoder.c",),
        step=1e-3,
        terminals=(Terminal("joints", ("q", "q_m", "dq_m"), "Motion in, measurement out"),),
        documentation=__doc__ or "",
    )


def start(x: Values, q: Array) -> Values:
    """The state and the outputs at the start; `q` (m,) rad."""
    q_m = _quantised(x, q)
    return {"q_m": q_m, "dq_m": np.zeros_like(q), "q_last": q_m}


def law(x: Values, t: float, h: float, q: Array) -> Values:
    """The equations above: q_m (m,) rad, dq_m (m,) rad/s of `q` (m,) rad."""
    q_m = _quantised(x, q)
    raw = (q_m - x["q_last"]) / h
    return {"q_m": q_m, "dq_m": x["dq_m"] + h / (h + x["T"]) * (raw - x["dq_m"]), "q_last": q_m}


def _quantised(x: Values, q: Array) -> Array:
    """q_m, rad."""
    step = np.where(x["resolution"] > 0.0, x["resolution"], 1.0)
    return np.where(x["resolution"] > 0.0, step * np.round(q / step), q)


fmu, kernel, Encoder = derive(model, law, start)
