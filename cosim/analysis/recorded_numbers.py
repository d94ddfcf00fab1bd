"""Numbers of one run: manipulability, effort, energy, felt impedance, rate of approach."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import inf, nan, sqrt

import numpy as np

from cosim.analysis.quantity import Quantity, absent, quantity
from cosim.analysis.recorded_port import PortRows, RecordedPort
from cosim.base.units import time_text
from cosim.measure.energy import effort
from cosim.measure.felt_impedance import fit_impedance, is_operator
from cosim.measure.least_squares import Blocks, RunningLine
from cosim.measure.manipulability import Curve, growth
from cosim.measure.metric_result import with_unit
from cosim.predict.closed_form import manipulability_bound, poles, quasi_static_poles
from cosim.predict.facts import Array, Hand
from cosim.predict.finite_gain import network_gain
from cosim.predict.network import Complex, RobotNetwork
from cosim.record.piecewise import Repeated, RunningIntegral

#: Rows of which the greatest error is kept.
ROWS = 1 << 16


def numbers(
    found: RecordedPort,
    net: RobotNetwork | None,
    hand: Hand | None,
    broken: Sequence[str] = (),
) -> Iterator[Quantity]:
    """The numbers of a run; closed forms where `net` and the `hand` at the port are known.

    `broken`: conditions of O6 that do not hold, so that it is no bound of this run.
    """
    acts = any(rows.force.any() for rows in found)
    why = "nothing recorded" if found.rows < 4 else "" if acts else "no force acted"
    if why:
        yield absent("manipulability", "M^t of this run", found.unit, "run", why)
        yield absent("effort", "effort ‖f‖₂", f"{found.units[0]}.√s", "run", why)
        return
    yield from _manipulability(found, net, broken)
    yield from _effort(found)
    yield from _energy(found)
    if found.moving:
        yield from _felt(found)
    if net is not None and hand is not None:
        yield _approach(found, net, hand)


def least_feedback(net: RobotNetwork) -> float:
    """lambda_min(K) at the port, N.m.s/rad; lambda_c lambda_min(M) with Remark 3."""
    law, arm = net.law, net.arms[net.port]
    return law.lambda_c * arm.inertia_range[0] if law.lambda_c else min(law.K)


def _manipulability(
    found: RecordedPort, net: RobotNetwork | None, broken: Sequence[str]
) -> Iterator[Quantity]:
    end = found.last
    limit, why, M_end = np.empty(0), "", nan
    if net is not None:
        limit = manipulability_bound(net, np.array([end]), least_feedback(net))
    for _, M in found.M:
        M_end = float(M[-1])
    bound = limit
    if broken:
        bounds = ", ".join(with_unit(x, found.unit, 4) for x in limit)
        why = f"no bound: O6 ({bounds}) needs {'; '.join(broken)}"
        limit = np.empty(0)
    what = ", y the mean of all robots" if found.mean else ""
    how = f"‖y‖₂/‖f‖₂ from 0 s to {time_text(end)}{what}"
    yield quantity(
        "manipulability", "M^t of this run", M_end, found.unit, how,
        expected=limit, formula="O6, at most" if len(limit) else "", note=why,
    )  # fmt: skip
    if net is not None:
        yield _gain(net, found.final()[-1], end, bound)
    yield quantity(
        "growth", "growth of M^t", growth(Repeated(lambda: found.M), end / 2, end), "1",
        f"d log M/d log t, from {time_text(end / 2)} to {time_text(end)}",
        note="constant push 1, hand at rest 1/2, finite 0",
    )  # fmt: skip


def _gain(net: RobotNetwork, q: Array, t: float, limit: Array) -> Quantity:
    """M^t as the paper means it: the most that any force does, which one run cannot show.

    `limit` (1,): O6.
    """
    label = "M^t, gain"
    how = (
        f"sup ‖y‖₂/‖f‖₂ over all f from 0 s to {time_text(t)}, linear about the end of the run, "
        "from rest, theta known, mean of graphs and delays"
    )
    if not np.isfinite(q).all():
        return absent("gain", label, "rad/(N.m)", how, "the run did not end at rest")
    return quantity(
        "gain", label, network_gain(net, q, t), "rad/(N.m)", how, expected=limit,
        formula="O6, at most" if np.isfinite(limit).all() else "alpha = 0: no bound O6",
    )  # fmt: skip


def _effort(found: RecordedPort) -> Iterator[Quantity]:
    unit = found.units[0]
    forces = Repeated(lambda: ((rows.t, rows.force) for rows in found))
    e = effort(forces, (found.first, found.last), min(1.0, found.last / 10))
    yield quantity("effort", "effort ‖f‖₂", e.norm, f"{unit}.√s", "sqrt(∫ |f|² dt)")
    yield quantity("impulse", "effort ∫|f|", e.integral, f"{unit}.s", "∫ |f| dt")
    yield quantity("peak_force", "peak |f_i|", e.peak, unit, "largest entry")
    how = f"mean of |f| over the last {time_text(e.window, 3)}"
    yield quantity("holding", "holding torque", e.holding, unit, how)


def _energy(found: RecordedPort) -> Iterator[Quantity]:
    if not found.moving:
        why = "no velocity at the port was recorded"
        yield absent("observer_min", "passivity observer", "J", "min E(t)", why)
        return
    work, least, at, end = RunningIntegral(), inf, nan, nan
    for rows in found:
        work.add(np.einsum("ij,ij->i", rows.force, _rate(rows)), rows.t)
    yield quantity("work", "work of the operator", work.value, "J", "∫ fᵀ dq dt")
    for t, E in found.E:
        row, end = int(np.argmin(E)), float(E[-1])
        if E[row] < least:
            least, at = float(E[row]), float(t[row])
    how = "min of E(t) = ∫ (τ1ᵀ dq1 - τ2ᵀ dq2)" if found.far else "min of E(t) = ∫ τᵀ dq"
    yield quantity(
        "observer_min", "passivity observer", least, "J", how,
        note=f"at {time_text(at)}; E ends at {end:.4g} J",
    )  # fmt: skip


def _rate(rows: PortRows) -> Array:
    assert rows.rate is not None
    return rows.rate


def _felt(found: RecordedPort) -> Iterator[Quantity]:
    window = max(found.last / 12, 2.0)
    moved = Repeated(lambda: ((x.t, x.force, x.response, _rate(x)) for x in found))
    windows = fit_impedance(moved, (found.first, found.last), window)
    label, how = (
        "felt in windows",
        f"f = I ddq + D dq + S q by least squares, {time_text(window, 3)} each",
    )
    if not windows:
        yield absent("felt", label, "", how, "nothing moves in enough ways to tell")
        return
    if all(is_operator(w) for w in windows):
        D, S = (np.median([getattr(w, x) for w in windows]) for x in ("damping", "stiffness"))
        force, length = found.units
        k_d, k_p = f"{-D:.4g} {force}.s/{length}", f"{-S:.4g} {force}/{length}"
        why = (
            f"what is found is the hand's own spring and damper (k_d = {k_d}, k_p = {k_p});"
            " see the tests"
        )
        yield absent("felt", label, "", how, why)
        return
    windows = tuple(w for w in windows if not is_operator(w))
    rest = max(w.residual for w in windows)
    force, length = found.units
    for name, part, unit in (
        ("felt_inertia", "inertia", "kg" if (force, length) == ("N", "m") else "kg.m2"),
        ("felt_damping", "damping", f"{force}.s/{length}"),
        ("felt_stiffness", "stiffness", f"{force}/{length}"),
    ):
        joints = sorted({w.joint for w in windows})
        medians = [np.median([getattr(w, part) for w in windows if w.joint == j]) for j in joints]
        note = f"median of {len(windows)} windows, up to {rest * 100:.2g} % unexplained"
        yield quantity(name, f"felt {part}, in windows", medians, unit, how, note=note)


def _approach(found: RecordedPort, net: RobotNetwork, hand: Hand) -> Quantity:
    """Decay rate of the error to the target of the hand, compared with the slowest pole."""
    place = np.asarray(hand.place)
    error = Repeated(lambda: ((x.t, np.abs(x.response - place).max(axis=1)) for x in found))
    rate, uncertain, seconds = approach(error, found.rows)
    label, how = "rate of approach", "slope of log |q - q_h|, from 1 % of the start down"
    if np.isnan(rate):
        return absent("approach", label, "1/s", how, "the error does not decay so far")
    ended = bool(found.estimates) and all(found.estimates)
    estimates = found.estimates if ended else net.initial_estimates()
    roots = poles(net, found.final()[-1], estimates, hand.stiffness, hand.damping)
    close, names = _not_told_apart(roots, seconds)
    simple = quasi_static_poles(net.law, least_feedback(net), *_softest(hand))[0].real
    o3 = f"; O3 without inertia {simple:.4g} 1/s" if len(net.laws) == 1 else ""
    return quantity(
        "approach", label, rate, "1/s", how, error=uncertain + close,
        expected=roots[0].real if len(roots) else (),
        formula=f"slowest pole, theta_hat as it {'ended' if ended else 'starts'}{o3}",
        note=names if ended else "theta_hat was not recorded: the closed form is that of the start",
    )  # fmt: skip


def _not_told_apart(roots: Complex, seconds: float) -> tuple[float, str]:
    """A bound on the slowest decay rate's excess that a run cannot resolve, 1/s, and a note.

    A mode whose rate is larger by d (1/s) becomes smaller by exp(d `seconds`) than the slowest mode
    (`seconds` in s). If that is less than e², both are seen, and the rate found lies between them.
    """
    faster = [p for p in roots[1:] if (roots[0].real - p.real) * seconds < 2.0]
    faster = [p for p in faster if roots[0].real - p.real > 1e-9]
    if not faster:
        return 0.0, ""
    last = min(p.real for p in faster)
    return (
        float(roots[0].real - last),
        f"modes down to {last:.4g} 1/s are not told from the slowest in {time_text(seconds, 3)}",
    )


def _softest(hand: Hand) -> tuple[float, float]:
    return min(hand.stiffness), min(hand.damping)


def approach(error: Curve, rows: int) -> tuple[float, float, float]:
    """Rate (1/s) of the exponential that the envelope of an error follows as it decays.

    From where it is last above 1e-2 of its start to where it is last above 1e-5 of it, and its
    uncertainty (1/s): two standard deviations of the mean rate of its three thirds, as the envelope
    of an error that swings has steps; last, how long that is (s). NaN if the error is not smaller
    than that at the end, or there are fewer than ten rows in between. `rows`: how many there are.
    """
    start, first, last, at = nan, 0, 0, 0
    for _, e in error:
        start = float(e[0]) if at == 0 else start
        beyond = [np.flatnonzero(e > share * start) for share in (1e-2, 1e-5)]
        first, last = (
            at + int(found[-1]) + 1 if len(found) else so_far
            for found, so_far in zip(beyond, (first, last), strict=True)
        )
        at += len(e)
    if not start > 0 or last >= rows or last - first < 10:
        return nan, nan, nan
    ends = np.linspace(first, last, 4).astype(int).tolist()
    parts = [(RunningLine(), a, b) for a, b in ((first, last), *pairwise(ends))]
    began, ended = inf, -inf
    for row, t, envelope in _envelope(error):
        for line, a, b in parts:
            inside = slice(max(a - row, 0), max(b - row, 0))
            line.add(t[inside], np.log(envelope[inside]))
        fitted = t[max(first - row, 0) : max(last - row, 0)]
        began, ended = float(fitted.min(initial=began)), float(fitted.max(initial=ended))
    whole, *thirds = (line.slope for line, _, _ in parts)
    uncertain = 2 * float(np.std(thirds, ddof=1)) / sqrt(len(thirds))
    return whole, uncertain, ended - began


def _envelope(error: Curve) -> Iterator[tuple[int, Array, Array]]:
    """Rows in blocks: the number of the first, times, s, and the greatest error from then on, (n,).

    The greatest error of each block is kept.
    """
    greatest = np.array([e.max() for _, e in _in_blocks(error)] + [0.0])
    later = np.maximum.accumulate(greatest[::-1])[::-1]
    for k, (t, e) in enumerate(_in_blocks(error)):
        envelope = np.maximum.accumulate(np.append(e, later[k + 1])[::-1])[::-1]
        yield k * ROWS, t, envelope[:-1]


def _in_blocks(curve: Curve) -> Iterator[tuple[Array, ...]]:
    """Rows in blocks of ROWS."""
    blocks = Blocks(ROWS)
    for piece in curve:
        yield from blocks.add(*piece)
    yield from blocks.rest()
