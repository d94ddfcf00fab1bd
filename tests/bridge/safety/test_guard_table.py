"""The guard against its table in docs/safety.md, joint by joint, at limits and beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf, isfinite, nan, nextafter

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.native.safety import GuardBit
from bridge.safety.limits import GuardSpec

H = 0.25  # s; like all numbers here without rounding in a product or sum
LIMITS = {
    "tau_max": 4.0, "rate_max": 8.0, "q_low": -1.0, "q_high": 1.0, "dq_max": 3.0,
    "power_max": 6.0, "q_jump": 0.5, "brake": 2.0,
}  # fmt: skip
Bits = set[str]


def beside(*values: float) -> list[float]:
    """Each of them, the numbers next to it, and all of that with the other sign."""
    near = {x for v in values for x in (nextafter(v, -inf), v, nextafter(v, inf))}
    return sorted(near | {-x for x in near})


torques = st.sampled_from([*beside(0.0, 1.5, 2.0, 4.0), 3.0, -3.0, 9.0, -9.0, nan, inf, -inf])
positions = st.sampled_from([*beside(0.0, 0.5, 1.0, 1.5), nan, inf])
velocities = st.sampled_from([*beside(0.0, 1.5, 3.0), 2.0, -2.0, 8.0, -8.0, nan, -inf])
scales = st.sampled_from([1.0, 1.0, 1.0, 0.5, 0.0, -1.0, 2.0, nan])


def within(x: float, most: float) -> float:
    return max(-most, min(most, x))


@dataclass
class Oracle:
    """One joint; `limits`: those that there are."""

    limits: dict[str, float]
    last_tau: float = 0.0
    last_q: float = nan
    tripped: Bits = field(default_factory=set)

    def trip(self, name: str) -> None:
        self.tripped.add(name)

    def jumps(self, q: float) -> bool:
        before, self.last_q = self.last_q, q
        if "q_jump" not in self.limits or not isfinite(before):
            return False
        return abs(q - before) > self.limits["q_jump"]

    def limited(self, tau: float, q: float, dq: float) -> float:
        """Rows 3 to 8 of the table, without the scale."""
        some = self.limits.get
        if abs(tau) > some("tau_max", inf):
            self.trip("TORQUE")
            tau = within(tau, some("tau_max", inf))
        step = within(tau - self.last_tau, some("rate_max", inf) * H)
        if step != tau - self.last_tau:
            self.trip("RATE")
            tau = self.last_tau + step
        side = 1 if q > some("q_high", inf) else -1 if q < some("q_low", -inf) else 0
        if side:
            self.trip("POSITION")
            tau = min(tau, 0.0) if side > 0 else max(tau, 0.0)
        if abs(dq) > some("dq_max", inf):
            self.trip("VELOCITY")
            tau = min(tau, 0.0) if dq > 0 else max(tau, 0.0)
        if tau * dq > some("power_max", inf):
            self.trip("POWER")
            tau = within(tau, some("power_max", inf) / abs(dq))
        self.last_tau = tau
        outwards = side * dq > 0
        return within(tau - (some("brake", 0.0) * dq if outwards else 0.0), some("tau_max", inf))

    def step(self, tau: float, q: float, dq: float, scale: float) -> float:
        """The torque that may act, N.m; what tripped is in `tripped`."""
        self.tripped = set()
        if not (isfinite(tau) and isfinite(q) and isfinite(dq)):
            self.trip("FINITE")
        if isfinite(q) and self.jumps(q):
            self.trip("JUMP")
        if self.tripped:
            found = self.last_tau = 0.0
        else:
            found = self.limited(tau, q, dq)
        if not scale > 0:  # nothing is given, and torque starts from 0 again
            self.last_tau = 0.0
            self.tripped.discard("RATE")
            return 0.0
        return min(scale, 1.0) * found


def bits(oracles: Sequence[Oracle]) -> GuardBit:
    return GuardBit(sum({GuardBit[name] for o in oracles for name in o.tripped}))


@settings(max_examples=150)
@given(
    names=st.sets(st.sampled_from(sorted(LIMITS))),
    ticks=st.lists(
        st.tuples(*(st.tuples(x, x) for x in (torques, positions, velocities)), scales),
        min_size=1,
        max_size=8,
    ),
)
def test_the_guard_is_its_table(names: set[str], ticks: list[tuple]) -> None:  # type: ignore[type-arg]
    """Two joints, with any of the limits, for some ticks."""
    limits = {name: LIMITS[name] for name in names}
    guard = GuardSpec(**limits).build(2, H)  # type: ignore[arg-type]
    oracles, trips = [Oracle(limits), Oracle(limits)], dict.fromkeys(guard.trips(), 0)
    for tau, q, dq, scale in ticks:
        given_ = zip(oracles, tau, q, dq, strict=True)
        expected = [o.step(*joint, scale) for o, *joint in given_]
        found, tripped = guard.apply(tau, q, dq, scale)
        assert found.tolist() == expected and tripped == bits(oracles)
        assert not np.signbit(found[found == 0]).any()
        for name in trips:
            trips[name] += bool(tripped & GuardBit[name.upper()])
        assert guard.trips() == trips
        assert guard.last_tau.tolist() == [o.last_tau for o in oracles]
