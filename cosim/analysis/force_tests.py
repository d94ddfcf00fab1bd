"""Numbers of the port by test forces, each with its closed form."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import inf, log, nan

import numpy as np

from cosim.analysis.conditions import constant
from cosim.analysis.experiments import FORCE, HIGHEST, LOWEST, RESOLVED, Bench
from cosim.analysis.quantity import Quantity, absent, quantity
from cosim.analysis.recorded_numbers import least_feedback
from cosim.base.copies import replace
from cosim.base.errors import CosimError, RunError
from cosim.measure.manipulability import manipulability
from cosim.predict import closed_form as closed
from cosim.predict.facts import Array
from cosim.predict.finite_gain import network_gain
from cosim.predict.frequency import PortGain, degree
from cosim.predict.network import RobotNetwork

#: Length of a run with a push, s, by whether there are more than two arms.
PUSH = {False: 80.0, True: 600.0}
#: Parts of the later three quarters of a push whose mean velocities tell how they scatter.
PARTS = 8
#: The greatest uncertainty of the mean velocity under a push, as a share of it.
VARIES = 0.25
#: What is said where everything tried is stable.
RESOLVES = (
    f"at least: stiffer is not tried, the arm's step would not resolve it (hω = {RESOLVED:g})"
)
#: Share of the motion at other frequencies: above the first links and graphs that switch disturb
#: what is measured, above the second nothing is measured.
DISTURBED, UNSTABLE = 0.02, 0.9


@dataclass(frozen=True, slots=True)
class PortSweep:
    """The port by frequency with the estimate of the `title`: measured, and in closed form.

    `closed` is at the frequencies that were measured, `drawn` at more of them.
    """

    title: str
    measured: PortGain
    closed: PortGain | None
    drawn: PortGain | None = None


def sweep(bench: Bench, lowest: float = LOWEST) -> PortSweep:
    """G(jω) of the bench from `lowest` (rad/s) to HIGHEST, with its closed form.

    Raises RunError if a run stops, or if almost nothing of the response is at the frequencies that
    were fed in; ScenarioError if the port has no input for a test force.
    """
    measured = bench.bands(lowest, HIGHEST)
    if measured.off_frequency_share > UNSTABLE:
        raise RunError(
            f"{measured.off_frequency_share * 100:.3g} % of the motion is at frequencies"
            " that were not fed in:"
            " let go of, it does not come to rest, or it does not answer linearly"
        )
    net = bench.network
    if net is None:
        return PortSweep(title_of(bench), measured, None)
    ends = measured.omega[0], measured.omega[-1]
    fine = closed_gain(bench, net, np.geomspace(*ends, 160))
    return PortSweep(title_of(bench), measured, closed_gain(bench, net, measured.omega), fine)


def title_of(bench: Bench) -> str:
    """The title of a test, with the kind of estimate."""
    return "M_hat = M" if bench.known else "as it starts"


def closed_gain(bench: Bench, net: RobotNetwork, omega: Array) -> PortGain:
    """The closed form at `omega` (k,), rad/s; continuous, so its step is as good as none."""
    estimates = net.true_estimates() if bench.known else net.initial_estimates()
    return PortGain(omega, net.at(bench.q, estimates).gain(1j * omega), 1e-9)


def with_known(bench: Bench) -> Bench | None:
    """The bench with M_hat = M in the posture of greatest inertia, where passivity is critical.

    None if there is no estimate to set.
    """
    if bench.network is None or bench.arm is None or not bench.network.law.estimate:
        return None
    return replace(bench, known=True, q=bench.arm.heaviest)


# ---- by frequency -------------------------------------------------------------------------------


def by_frequency(swept: PortSweep, bench: Bench) -> Iterator[Quantity]:
    """Degree, positive real part, and what is felt slowly and quickly, with uncertainties."""
    gain, form, tag = swept.measured, swept.closed, "known" if bench.known else "started"
    units = bench.units
    lowest, title = gain.omega[0], swept.title
    if not bench.known:
        k, whole = degree(gain)
        yield quantity(
            "degree", "degree of manipulability", k, "1",
            f"-slope of log |G| at {lowest:.3g} rad/s: {round(k)} pure integral(s)",
            expected=degree(form)[0] if form else (),
            formula="of the closed form at that frequency" if form else "",
            error=gain.slope_error(), note=_doubts(gain, whole),
        )  # fmt: skip
    if not bench.port.collocated:
        return
    least, at, share = gain.least()
    where = "least eigenvalue of (Y + Yᴴ)/2 relative to |Y|, over frequency"
    error = float(gain.error[int(np.argmin(gain.shares()))])
    said = f"Re Y = {least:.3g} {_admittance(units)} at {at:.3g} rad/s"
    yield quantity(
        f"real_part_{tag}", f"min Re Y/|Y|, {title}", share, "1", where,
        expected=form.least()[2] if form else (),
        formula=sampling_note(bench) if form else "",
        error=error,
        note=f"{_VERDICT[gain.passive()]} from {lowest:.3g} rad/s to {gain.omega[-1]:.3g} rad/s; "
        + said,
    )  # fmt: skip
    yield from _bands(gain, form, tag, bench)


#: What is said of passivity, see :meth:`PortGain.passive`.
_VERDICT = {
    True: "passive",
    False: "not passive",
    None: "no verdict: the uncertainty is too large",
}


def sampling_note(bench: Bench) -> str:
    """A note on the change of a continuous closed form by sampling: ωT_s/4; of inertia, K T_s/2."""
    system = bench.system
    period = system.period(system.controls.get(bench.port.arm, bench.port.arm))
    net = bench.network
    late = max(net.law.feedback) * period / 2 if net is not None else 0.0
    of_inertia = f", of inertia ± {late:.2g} {bench.units['inertia']}" if late else ""
    return f"closed form, ± {100 * HIGHEST * period / 4:.2g} %{of_inertia}: not sampled"


def _admittance(units: Mapping[str, str]) -> str:
    """Unit of an admittance, from that of a damping."""
    above, below = units["damping"].rsplit("/", 1)
    return f"{below}/({above})"


def _doubts(gain: PortGain, whole: bool) -> str:
    said = [] if whole else ["not whole: take a lower frequency (--lowest)"]
    if gain.off_frequency_share > DISTURBED:
        off = gain.off_frequency_share * 100
        said.append(f"{off:.2g} % of the motion is at frequencies not fed in")
    return "; ".join(said)


def _bands(gain: PortGain, form: PortGain | None, tag: str, bench: Bench) -> Iterator[Quantity]:
    title, units = title_of(bench), bench.units
    low, high = (gain.omega[0], 8 * gain.omega[0]), (10.0, HIGHEST)
    for part, index, band in (
        ("damping", 1, low),
        ("stiffness", 2, low),
        ("inertia", 0, high),
        ("damping", 1, high),
    ):
        how = f"Z = jωI + D + S/(jω) from {band[0]:.2g} rad/s to {band[1]:.2g} rad/s"
        speed = "slowly" if band is low else "quickly"
        found = gain.fitted_impedance(*band)
        value = found[index]
        least = np.maximum(0.05 * np.abs(found[1]) * band[0], 2 * gain.felt_error(*band)[2])
        little = part == "stiffness" and (np.abs(value) < least).all()
        if np.isnan(value).any() or little:
            continue  # with a pure integral there is no stiffness
        yield quantity(
            f"{part}_{speed}_{tag}", f"felt {part}, {speed}, {title}", value, units[part], how,
            error=gain.felt_error(*band)[index],
            expected=form.fitted_impedance(*band)[index] if form else (),
            formula=("closed form" if band is low else sampling_note(bench)) if form else "",
        )  # fmt: skip


# ---- a push -------------------------------------------------------------------------------------


def by_push(bench: Bench) -> Iterator[Quantity]:
    """O4: the response to a constant force from rest, and its ratio to the greatest one, M^t."""
    seconds = PUSH[len(bench.system.arms) > 2]
    kind = f", {title_of(bench)}" if bench.known else ""
    force = bench.units["damping"].split(".s/")[0]
    how = f"constant push of {FORCE:g} {force} on every joint for {seconds:g} s, from rest{kind}"
    try:
        run = bench.push(seconds)
    except CosimError as error:
        yield absent("push_damping", "felt damping, push", bench.units["damping"], how, str(error))
        return
    t, y = run.t, run.array(bench.port.response)
    y = y - y[0]
    net = bench.network
    yield _growth(t, y, net, how)
    if bench.port.response != bench.port.rate:
        yield from _pushed(t, y, net, how, bench)
    if net is not None and bench.known:
        members = bench.port.members or (bench.port.response,)
        moved = np.mean([run.array(name) for name in members], axis=0)
        yield _share(bench, net, t, moved, how)


def _share(bench: Bench, net: RobotNetwork, t: Array, moved: Array, how: str) -> Quantity:
    """M^t of the push over the gain M^t: below 1, as the push is one of the forces."""
    M = manipulability(t, np.full_like(moved, FORCE), moved)[-1]
    gain = network_gain(net, np.asarray(bench.q), float(t[-1]))
    holds = constant(bench.system, net)
    return quantity(
        "push_share", "M^t of a push over the gain", M / gain, "1",
        f"{how}, at {t[-1]:.3g} s: {M:.4g} of {gain:.4g} rad/(N.m)", expected=1.0,
        formula="at most, and π/√12 = 0.907 of a pure integral" if holds
        else "at most, on average: delays or weights vary",
    )  # fmt: skip


def _growth(t: Array, y: Array, net: RobotNetwork | None, how: str) -> Quantity:
    size = np.sqrt((y**2).sum(axis=1))
    half = len(t) // 2
    k = log(size[-1] / size[half]) / log(t[-1] / t[half]) if size[half] > 0 else nan
    expected: float | tuple[()] = ()
    if net is not None and not net.outside.any():
        expected = float(net.law.lambda_M > 0) + float(net.law.alpha == 0)
    return quantity(
        "push_degree", "degree, by a push", k, "1", f"y grows like t^k under a {how}",
        expected=expected, formula="lambda_M > 0, and alpha = 0: an integral each",
    )  # fmt: skip


def _pushed(
    t: Array, y: Array, net: RobotNetwork | None, how: str, bench: Bench
) -> Iterator[Quantity]:
    units = bench.units
    quarter = int(np.searchsorted(t, t[-1] / 4))
    ends = np.linspace(quarter, len(t) - 1, PARTS + 1).astype(int)
    velocities = np.diff(y[ends], axis=0) / np.diff(t[ends])[:, None]
    late, tail = velocities[-1], velocities[PARTS // 2 :]
    K = each_feedback(net, y.shape[1])
    if np.abs(late).max() * 10.0 <= 1e-3 * np.abs(y[-1]).max():
        yield quantity(
            "push_stiffness", "felt stiffness, push", FORCE / y[-1], units["stiffness"],
            f"{how}: comes to rest",
            expected=[closed.felt_stiffness(net, k) for k in K] if net else (),
            formula="αK: lambda_M = 0" if net else "",
        )  # fmt: skip
        return
    early, trend = velocities[: PARTS // 2].mean(axis=0), tail.mean(axis=0)
    steady = np.abs(np.diff(tail, axis=0)).max() <= 0.01 * np.abs(trend).max()
    used = velocities[-2:] if steady else velocities
    velocity = used.mean(axis=0)
    share = 2 * used.std(axis=0, ddof=1) / np.sqrt(len(used)) / np.abs(velocity)
    grows = ~np.array(steady) & (np.abs(trend - early) > 3 * share * np.abs(velocity))
    if grows.any() or share.max() > VARIES:
        why = f"the velocity still changes or scatters, by {share.max() * 100:.2g} % of its mean"
        yield absent("push_damping", "felt damping, push", units["damping"], how, why)
        return
    yield quantity(
        "push_damping", "felt damping, push", FORCE / velocity, units["damping"],
        f"{how}: force over mean velocity from {t[-1] * (0.8125 if steady else 0.25):.3g} s on",
        error=share * np.abs(FORCE / velocity),
        expected=closed.felt_when_pushed(net, bench.q, K) if net else (),
        formula=_damping_formula(net),
    )  # fmt: skip


def _damping_formula(net: RobotNetwork | None) -> str:
    if net is None:
        return ""
    few = {1: "O4, Kα/λ_M", 2: "O4, Kα(2 + λΣT)/λ_M"}
    arm, n = net.arms[net.port], len(net.laws)
    friction = {1: " + D", 2: " + 2 D"} if any(arm.damping) else {}
    late = ", and g' T_s/2" if arm.weight is not None and any(arm.gravity) else ""
    return few.get(n, "A(p)/p for p -> 0, mean graph") + friction.get(n, "") + late


def each_feedback(net: RobotNetwork | None, m: int) -> list[float]:
    """The feedback gain of each joint, N.m.s/rad; with Remark 3 the least."""
    if net is None:
        return []
    if net.law.lambda_c:
        return [least_feedback(net)] * m
    return [net.law.K[i % len(net.law.K)] for i in range(m)]


def felt_free(quantities: list[Quantity]) -> float:
    """The damping that a push felt, N.m.s/rad: the softest joint; inf if at rest or not known."""
    for q in quantities:
        if q.name == "push_damping" and not q.missing:
            return min(q.values)
    return inf
