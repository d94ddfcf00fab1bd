"""Inertial parameters of a serial arm from its motion and torques: base parameters with intervals.

The torque of the joints is linear in the parameters, also with rotors and friction::

    tau = Y(q, dq, ddq) theta,   theta = (10 of each link, armature, damping, friction)

Some columns of Y are zero, or combinations of others, in every motion: only the *base parameters*
can be found, each a combination of parameters. Which ones, is found numerically: in random motions,
column by column, a column that is a combination of those before is left out and its parameter goes
into theirs. They are then estimated by :mod:`fmus.arms.estimation`. Positions are filtered
without a phase lag and differentiated; torques and the columns of Y go through the same low-pass
filter, and one value is kept in 0.4 / cutoff s.

Source: M. Gautier, "Numerical calculation of the base inertial parameters of robots", Journal of
Robotic Systems 8(4), 1991; J. Swevers, W. Verdonck, J. De Schutter, "Dynamic model identification
for industrial robots", IEEE Control Systems Magazine 27(5), 2007.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

from cosim.base.errors import RunError
from fmus.arms import chain_law
from fmus.arms.chain import Table
from fmus.arms.estimation import MeasuredTorques, Trace, estimate
from fmus.model.numeric import Array, np

#: The ten parameters of a link as they are stored, and their units.
LINK = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
LINK_UNITS = ("kg", *("kg.m",) * 3, *("kg.m2",) * 6)
#: Their order in the search for combinations: what comes first stays.
FIRST = (9, 4, 5, 7, 8, 1, 2, 6, 3, 0)
#: Norm, relative to that of the column, below which a column is a combination of others.
DEPENDENT = 1e-8
#: The same in measured data: what they do not excite.
_UNEXCITED = 1e-4
#: Random states of each joint for the base parameters.
_STATES = 20
#: Speeds, relative to v_f, below which friction may be another one.
NEAR = np.geomspace(0.5, 6.0, 6)
#: Cutoff of the positions, and rate of Y, relative to that of torques and Y.
_POSITIONS, _RATE = 5.0, 20.0


@final
@dataclass(frozen=True, slots=True)
class BaseParameter:
    """One base parameter: `factors` of the parameters in it, by name; the first is 1.

    `value` ± `interval` (95 %) in `unit`; `before`: what the scenario says.
    """

    factors: dict[str, float]
    unit: str
    value: float
    interval: float
    before: float


@final
@dataclass(frozen=True, slots=True)
class Identified:
    """The base parameters, and how well the motion shows them.

    `condition`: of the columns, each divided by its norm; `residuals` and `torques` (n,): RMS of
    what is left, and of the torques, N.m or N; `rows`: values of each joint that were used.
    `without_effect`: parameters that move nothing, in any motion; `unexcited`: base parameters that
    this motion does not show. `traces`: errors of the recording that were estimated, too;
    `memory` (n,): how long the errors of a joint are correlated, s, 0 if hardly.
    """

    parameters: tuple[BaseParameter, ...]
    condition: float
    residuals: Array
    torques: Array
    rows: int
    without_effect: tuple[str, ...]
    unexcited: tuple[str, ...]
    traces: tuple[Trace, ...]
    memory: Array


def names(joints: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units of all parameters, in the order of the columns of :func:`columns`."""
    links = [f"{name}[{i}]" for i in range(joints) for name in LINK]
    kinds = {"armature": "kg.m2", "damping": "N.m.s/rad", "friction": "N.m"}
    rest = [f"{kind}[{i}]" for kind in kinds for i in range(joints)]
    units = [*LINK_UNITS * joints, *(u for u in kinds.values() for _ in range(joints))]
    return (*links, *rest), tuple(units)


def columns(table: Table, v_f: Array, q: Array, dq: Array, ddq: Array) -> Array:
    """Y (n, 13 n) of a motion, (n,) each in rad, rad/s, rad/s2; `v_f` (n,) rad/s of friction."""
    n = table.joints
    links = chain_law.regressor(table, q, dq, dq, ddq, table.g).reshape(n, -1)
    return np.hstack([links, np.diag(ddq), np.diag(dq), np.diag(np.tanh(dq / v_f))])


def base(table: Table, v_f: Array) -> tuple[list[int], list[int], Array]:
    """(base, others, K): columns of `others` are those of `base` times K (base, others).

    Columns that are zero are in neither.
    """
    n = table.joints
    random = np.random.default_rng(0)
    states = random.uniform(-1.0, 1.0, (_STATES * n, 3, n)) * np.array([[np.pi], [2.0], [5.0]])
    W = np.vstack([columns(table, v_f, *state) for state in states])
    norms = np.linalg.norm(W, axis=0)
    order = [10 * i + k for i in range(n) for k in FIRST] + list(range(11 * n, 13 * n))
    order += range(10 * n, 11 * n)
    effective = [i for i in order if norms[i] > DEPENDENT * norms.max()]
    kept = independent(W[:, effective] / norms[effective], DEPENDENT)
    chosen = [effective[i] for i in kept]
    others = [i for i in effective if i not in chosen]
    K = np.linalg.lstsq(W[:, chosen], W[:, others], rcond=None)[0]
    return chosen, others, np.where(np.abs(K) > 1e-7, K, 0.0)


def independent(W: Array, least: float) -> list[int]:
    """Columns of `W` (k, n), dimensionless, that are no combinations of those before.

    `least`: the norm of what is left of a column of norm 1 that counts as nothing.
    """
    basis = np.zeros((len(W), 0))
    kept = []
    for i, column in enumerate(W.T):
        rest = column - basis @ (basis.T @ column)
        rest = rest - basis @ (basis.T @ rest)
        size = float(np.linalg.norm(rest))
        if size > least:
            kept.append(i)
            basis = np.column_stack([basis, rest / size])
    return kept


def identified(
    table: Table,
    before: Array,
    v_f: Array,
    motion: tuple[Array, Array, Array],
    cutoff: float,
    progress: Callable[[str], None] = lambda text: None,
) -> Identified:
    """The base parameters that explain a motion: t (k,) s, q (k, n) rad, tau (k, n) N.m.

    tau are the torques of motors and surroundings at t. `before` (13 n,): parameters that the
    result is set beside; `v_f` (n,) rad/s. `cutoff` (Hz): what is faster is not used. Raises
    RunError for times that are not equally spaced, and for too short a motion.
    """
    n = table.joints
    data = _regression(table, v_f, motion, cutoff, progress)
    W, tau = data.W, data.torque
    chosen, others, K = base(table, v_f)
    Wb = W.reshape(-1, W.shape[2])[:, chosen]
    scale = np.linalg.norm(Wb, axis=0)
    shown = independent(Wb / np.where(scale > 0.0, scale, 1.0), _UNEXCITED)
    Wb = Wb[:, shown]
    if len(Wb) <= 2 * len(shown):
        raise RunError(f"{len(W)} values of each joint for {len(shown)} parameters; expected more")
    progress("searching errors that are no noise")
    result = estimate(data.only([chosen[i] for i in shown]))
    every, units = names(n)
    factors = [_factors(every, chosen[i], others, K[i]) for i in shown]
    found = tuple(
        BaseParameter(f, units[chosen[i]], float(x), float(dx), _before(before, every, f))
        for i, f, x, dx in zip(shown, factors, result.value, result.interval, strict=True)
    )
    known = {*chosen, *others}
    return Identified(
        found,
        float(np.linalg.cond(Wb / np.linalg.norm(Wb, axis=0))),
        np.sqrt(np.mean(result.rest**2, axis=0)),
        np.sqrt(np.mean(tau**2, axis=0)),
        len(W),
        tuple(name for i, name in enumerate(every) if i not in known),
        tuple(every[c] for i, c in enumerate(chosen) if i not in shown),
        result.traces,
        result.memory,
    )


def _factors(every: tuple[str, ...], first: int, others: list[int], K: Array) -> dict[str, float]:
    rest = {every[o]: float(k) for o, k in zip(others, K, strict=True) if k != 0.0}
    return {every[first]: 1.0, **rest}


def _before(before: Array, every: tuple[str, ...], factors: dict[str, float]) -> float:
    return float(sum(k * before[every.index(name)] for name, k in factors.items()))


def _regression(
    table: Table,
    v_f: Array,
    motion: tuple[Array, Array, Array],
    cutoff: float,
    progress: Callable[[str], None],
) -> MeasuredTorques:
    """Y (k, n, 13 n) and tau (k, n), filtered, one of several values kept."""
    t, q, tau = motion
    h = float(t[-1] - t[0]) / max(1, len(t) - 1)
    if len(t) < 3 or np.abs(np.diff(t) - h).max() > 1e-3 * h:
        raise RunError("the times of the recording are not equally spaced; expected each tick")
    fast = min(_POSITIONS * cutoff, 0.2 / h)
    if cutoff > 0.5 * fast:
        raise RunError(f"cutoff {cutoff:g} Hz at a row in {h:g} s; expected {0.1 / h:g} Hz or less")
    ends = round(1.5 / cutoff / h)  # where filters begin and end
    if len(t) < 4 * ends:
        raise RunError(f"{t[-1] - t[0]:g} s recorded; expected {6.0 / cutoff:g} s or more")
    smooth = _filtered(q, h, fast)
    dq = _derivative(smooth, h)
    ddq = _derivative(dq, h)
    every = max(1, round(1.0 / (_RATE * cutoff * h)))
    rows = range(0, len(t), every)
    progress(f"regressor of {len(rows)} states")
    Y = np.array([columns(table, v_f, smooth[k], dq[k], ddq[k]) for k in rows])
    torque = _filtered(_filtered(tau, h, fast)[::every], h * every, cutoff)
    sign, near = np.tanh(dq[::every] / v_f), (dq[::every] / v_f)[:, :, None] / NEAR
    slow = sign[:, :, None] * np.exp(-(near**2))
    Y, slow = (_filtered(x, h * every, cutoff) for x in (Y, slow))
    keep = slice(ends // every, len(Y) - ends // every, max(1, round(0.4 / cutoff / (h * every))))
    spacing = h * every * keep.step
    return MeasuredTorques(
        Y[keep], torque[keep], _derivative(Y, h * every)[keep], slow[keep], spacing
    )


def _filtered(x: Array, h: float, cutoff: float) -> Array:
    """Low-pass of order 4, forward and backward."""
    from scipy.signal import butter, sosfiltfilt

    return np.asarray(sosfiltfilt(butter(4, cutoff * 2.0 * h, output="sos"), x, axis=0))


def _derivative(x: Array, h: float) -> Array:
    """Central differences of order 4, (k, n) in the unit of `x` per s."""
    d = np.gradient(x, h, axis=0)
    d[2:-2] = (x[:-4] - 8.0 * x[1:-3] + 8.0 * x[3:-1] - x[4:]) / (12.0 * h)
    return d
