"""Numbers of one run: manipulability, effort, energy, felt impedance, rate of approach."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt

import numpy as np

from cosim.analysis.quantity import Quantity, absent, quantity
from cosim.base.units import time_text
from cosim.measure.energy import effort, observer
from cosim.measure.felt_impedance import fit_impedance, is_operator
from cosim.measure.manipulability import growth, manipulability, running_integral
from cosim.measure.metric_result import with_unit
from cosim.predict.closed_form import manipulability_bound, poles, quasi_static_poles
from cosim.predict.facts import Array, Hand
from cosim.predict.finite_gain import network_gain
from cosim.predict.network import Complex, RobotNetwork
from cosim.predict.port import PortSignals
from cosim.record.signals import Signals


@dataclass(frozen=True, slots=True)
class RecordedPort:
    """The recorded signals at a port: `t` (n,) s, the others (n, m) by their role.

    `far`: (torque, velocity) at the other end; `units` of force and response; `estimates`: final
    theta_hat of each robot, () if it was not recorded; `mean`: (n, m), the mean position of all
    robots of a network, None for a single robot.
    """

    t: Array
    force: Array
    response: Array
    rate: Array | None
    far: tuple[Array, Array] | None
    units: tuple[str, str]
    estimates: tuple[tuple[float, ...], ...] = ()
    mean: Array | None = None

    @property
    def unit(self) -> str:
        """Unit of response over force."""
        force, response = self.units
        return f"{response}/({force})" if "." in force else f"{response}/{force}"

    @property
    def M(self) -> Array:
        """M^t, (n,): of the response, and in a network of the mean of its robots, q_c."""
        moved = self.response if self.mean is None else self.mean
        return manipulability(self.t, self.force, moved)

    @property
    def E(self) -> Array | None:
        """The passivity observer, (n,), J; None where a velocity was not recorded."""
        if self.rate is None:
            return None
        ends = [(self.force, self.rate), *([self.far] if self.far else [])]
        return observer(self.t, ends)


def read(signals: Signals, port: PortSignals) -> RecordedPort:
    """The port's signals of a run. Raises ScenarioError where one was not recorded."""
    far = None
    if port.far_force and port.far_rate:
        far_force = _total(signals, port.far_force, port.far_external, -1.0)
        far = (far_force, signals.array(port.far_rate))
    return RecordedPort(
        t=np.asarray(signals.t, dtype=np.float64),
        force=_total(signals, port.force, port.external, 1.0),
        response=signals.array(port.response),
        rate=signals.array(port.rate) if port.rate else None,
        far=far,
        units=(signals.unit(port.force), signals.unit(port.response)),
        estimates=tuple(_last(signals, name) for name in port.estimates),
        mean=_mean(signals, port.members) if port.members else None,
    )


def _mean(signals: Signals, names: Sequence[str]) -> Array:
    """The mean of signals of one size, (n, m), without a copy of all of them."""
    total = np.array(signals.array(names[0]), dtype=np.float64)
    for name in names[1:]:
        total += signals.array(name)
    return np.asarray(total / len(names))


def _total(signals: Signals, inside: str, external: str, sign: float) -> Array:
    """The torque of a grip or wall inside an arm, (n, m), with what other components feed in."""
    found = signals.array(inside)
    return found + sign * signals.array(external) if external else found


def _last(signals: Signals, name: str) -> tuple[float, ...]:
    """The last values of a signal; () if nothing was recorded."""
    rows = signals.array(name)
    return tuple(float(x) for x in rows[-1]) if len(rows) else ()


def numbers(
    found: RecordedPort,
    net: RobotNetwork | None,
    hand: Hand | None,
    broken: Sequence[str] = (),
) -> Iterator[Quantity]:
    """The numbers of a run; closed forms where `net` and the `hand` at the port are known.

    `broken`: conditions of O6 that do not hold, so that it is no bound of this run.
    """
    why = "nothing recorded" if len(found.t) < 4 else "" if found.force.any() else "no force acted"
    if why:
        yield absent("manipulability", "M^t of this run", found.unit, "run", why)
        yield absent("effort", "effort ‖f‖₂", f"{found.units[0]}.√s", "run", why)
        return
    yield from _manipulability(found, net, broken)
    yield from _effort(found)
    yield from _energy(found)
    if found.rate is not None:
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
    t, M = found.t, found.M
    limit, why = np.empty(0), ""
    if net is not None:
        limit = manipulability_bound(net, t[-1:], least_feedback(net))
    bound = limit
    if broken:
        bounds = ", ".join(with_unit(x, found.unit, 4) for x in limit)
        why = f"no bound: O6 ({bounds}) needs {'; '.join(broken)}"
        limit = np.empty(0)
    what = "" if found.mean is None else ", y the mean of all robots"
    end, half = time_text(float(t[-1])), time_text(float(t[-1]) / 2)
    how = f"‖y‖₂/‖f‖₂ from 0 s to {end}{what}"
    yield quantity(
        "manipulability", "M^t of this run", M[-1], found.unit, how,
        expected=limit, formula="O6, at most" if len(limit) else "", note=why,
    )  # fmt: skip
    if net is not None:
        yield _gain(net, found.response[-1], float(t[-1]), bound)
    yield quantity(
        "growth", "growth of M^t", growth(t, M, t[-1] / 2, t[-1]), "1",
        f"d log M/d log t, from {half} to {end}",
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
    e = effort(found.t, found.force, min(1.0, float(found.t[-1]) / 10))
    yield quantity("effort", "effort ‖f‖₂", e.norm, f"{unit}.√s", "sqrt(∫ |f|² dt)")
    yield quantity("impulse", "effort ∫|f|", e.integral, f"{unit}.s", "∫ |f| dt")
    yield quantity("peak_force", "peak |f_i|", e.peak, unit, "largest entry")
    how = f"mean of |f| over the last {time_text(e.window, 3)}"
    yield quantity("holding", "holding torque", e.holding, unit, how)


def _energy(found: RecordedPort) -> Iterator[Quantity]:
    if found.rate is None or found.E is None:
        why = "no velocity at the port was recorded"
        yield absent("observer_min", "passivity observer", "J", "min E(t)", why)
        return
    work = running_integral(np.einsum("ij,ij->i", found.force, found.rate), found.t)[-1]
    yield quantity("work", "work of the operator", work, "J", "∫ fᵀ dq dt")
    E = found.E
    at = int(np.argmin(E))
    how = "min of E(t) = ∫ (τ1ᵀ dq1 - τ2ᵀ dq2)" if found.far else "min of E(t) = ∫ τᵀ dq"
    yield quantity(
        "observer_min", "passivity observer", E[at], "J", how,
        note=f"at {time_text(float(found.t[at]))}; E ends at {E[-1]:.4g} J",
    )  # fmt: skip


def _felt(found: RecordedPort) -> Iterator[Quantity]:
    assert found.rate is not None
    window = max(float(found.t[-1]) / 12, 2.0)
    windows = fit_impedance(found.t, found.force, found.response, found.rate, window)
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
    error = np.abs(found.response - np.asarray(hand.place)).max(axis=1)
    rate, uncertain, seconds = approach(found.t, error)
    label, how = "rate of approach", "slope of log |q - q_h|, from 1 % of the start down"
    if np.isnan(rate):
        return absent("approach", label, "1/s", how, "the error does not decay so far")
    ended = bool(found.estimates) and all(found.estimates)
    estimates = found.estimates if ended else net.initial_estimates()
    roots = poles(net, found.response[-1], estimates, hand.stiffness, hand.damping)
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


def approach(t: Array, error: Array) -> tuple[float, float, float]:
    """Rate (1/s) of the exponential that the envelope of `error` (n,) follows as it decays.

    From where it is last above 1e-2 of its start to where it is last above 1e-5 of it, and its
    uncertainty (1/s): two standard deviations of the mean rate of its three thirds, as the envelope
    of an error that swings has steps; last, how long that is (s). NaN if the error is not smaller
    than that at the end, or there are fewer than ten rows in between.
    """
    envelope = np.maximum.accumulate(error[::-1])[::-1]
    first, last = (int((envelope > share * error[0]).sum()) for share in (1e-2, 1e-5))
    if error[0] <= 0 or last >= len(t) or last - first < 10:
        return float("nan"), float("nan"), float("nan")
    ends = np.linspace(first, last, 4).astype(int)
    whole, *parts = (
        float(np.polyfit(t[a:b], np.log(envelope[a:b]), 1)[0])
        for a, b in ((first, last), *pairwise(ends))
    )
    uncertain = 2 * float(np.std(parts, ddof=1)) / sqrt(len(parts))
    return whole, uncertain, float(t[last - 1] - t[first])
