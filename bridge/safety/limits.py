"""Safety settings of a node from its deployment, their C structs, and texts of reasons.

The rules themselves are C (``bridge/c/guard.h``) and described in ``docs/safety.md``. Values are
SI floats or texts with a unit (``"5 ms"``). Errors are ScenarioError with the place.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import IntFlag
from math import ceil, inf, isnan, nan
from typing import TypeVar, final

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from bridge.native import safety as native
from bridge.native.safety import GuardBit, LifeState, LifeStruct, Peer, WatchdogStruct, Why
from cosim.base.convert import Number
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError, UnitError
from cosim.base.units import quantity

#: One number for all joints or one a joint, SI or with a unit; None: not limited.
PerJoint = Number | tuple[Number, ...] | None
Array = NDArray[np.float64]
Spec = TypeVar("Spec", bound=msgspec.Struct)

#: What a stop stands for, in the words of a report.
REASONS = {
    Why.COMMAND: "stopped by command",
    Why.ESTOP: "emergency stop",
    Why.PEER: "a required peer is silent, has stopped or has restarted",
    Why.STALE: "an input is older than it may be",
    Why.GUARD: "the guard met a torque or a state that stops the node",
    Why.WATCHDOG: "a watchdog has expired",
    Why.OVERRUN: "a slot was later than it may be",
    Why.COMPONENT: "a component failed",
    Why.BUS: "a bus is off or down",
    Why.SYNC: "SYNC is missing",
    Why.APART: "the arms are too far apart to start",
    Why.JUMP: "an encoder moved further in a tick than it can",
    Why.DRIVE: "a drive is not enabled",
}
#: What a bit of the guard stands for.
GUARDED = {
    GuardBit.FINITE: "not a finite number",
    GuardBit.TORQUE: "torque limit",
    GuardBit.RATE: "rate limit",
    GuardBit.POSITION: "beyond a soft limit of position",
    GuardBit.VELOCITY: "faster than the velocity limit",
    GuardBit.POWER: "power limit",
    GuardBit.JUMP: "encoder jump",
}
_UNITS = {
    "tau_max": "N.m",
    "rate_max": "N.m/s",
    "q_low": "rad",
    "q_high": "rad",
    "dq_max": "rad/s",
    "power_max": "W",
    "q_jump": "rad",
}
_SIGNED = ("q_low", "q_high")


def explain(reasons: int) -> str:
    """Latched reasons in words: ``"emergency stop; SYNC is missing"``; none: ``"nothing"``."""
    return _worded(Why(reasons), REASONS)


def explain_guard(bits: int) -> str:
    """Bits of a guard in words: ``"torque limit; rate limit"``; without any: ``"nothing"``."""
    return _worded(GuardBit(bits), GUARDED)


def names(flags: IntFlag) -> tuple[str, ...]:
    """Names of the bits that are set, in small letters, in the order of the bits."""
    return tuple((bit.name or "").lower() for bit in flags)


def _worded(flags: IntFlag, words: Mapping[Why, str] | Mapping[GuardBit, str]) -> str:
    known = [text for bit, text in words.items() if bit & flags]
    unknown = int(flags) & ~sum(int(bit) for bit in words)
    return "; ".join([*known, *([f"unknown bits {unknown:#x}"] if unknown else [])]) or "nothing"


def to_si(value: Number, unit: str, place: str) -> float:
    """A number as it is, a text (``"5 ms"``) in `unit`. Raises ScenarioError, also for NaN."""
    try:
        number = quantity(value, unit) if isinstance(value, str) else float(value)
    except (UnitError, TypeError, ValueError) as error:
        raise ScenarioError(str(error), place) from None
    if isnan(number):
        raise ScenarioError(f"is NaN, expected a number in {unit}", place)
    return number


@dataclass(frozen=True, slots=True)
class LifeSpec:
    """`ramp`: time in which the torque decreases to 0 when a node stops, s; 0: immediately."""

    ramp: Number = 0.1

    def build(self, h: float, place: str = "life") -> LifeStruct:
        """The life cycle of a node with slots of `h` s, unconfigured. Raises ScenarioError."""
        ramp = to_si(self.ramp, "s", f"{place}.ramp")
        if not 0 <= ramp <= 60:
            raise ScenarioError(f"is {ramp:g} s, expected 0 to 60 s", f"{place}.ramp")
        return LifeStruct(state=LifeState.UNCONFIGURED, ramp_ticks=ceil(ramp / h * (1 - 1e-12)))


@dataclass(frozen=True, slots=True)
class WatchdogSpec:
    """`timeout`: s without being fed after which it expires; 0: off."""

    timeout: Number = 0.0

    def build(self, now_ns: int, place: str = "watchdog") -> WatchdogStruct:
        """A watchdog that counts from `now_ns`. Raises ScenarioError."""
        timeout = to_si(self.timeout, "s", f"{place}.timeout")
        if not 0 <= timeout <= 1e6:
            raise ScenarioError(f"is {timeout:g} s, expected 0 (off) or more", f"{place}.timeout")
        if 0 < timeout < 1e-6:
            raise ScenarioError(f"is {timeout:g} s, expected at least 1 us", f"{place}.timeout")
        return WatchdogStruct(timeout_ns=round(timeout * 1e9), last_ns=now_ns)


@dataclass(frozen=True, slots=True)
class PeerSpec:
    """Another node: its number, the silence (s) after which it is lost, whether that stops us."""

    number: int
    timeout: Number = 0.2
    required: bool = True

    def build(self, now_ns: int, place: str = "peer") -> Peer:
        """A peer not heard yet, its time-out counting from `now_ns`. Raises ScenarioError."""
        watchdog = WatchdogSpec(self.timeout).build(now_ns, place)
        if self.required and not watchdog.timeout_ns:
            raise ScenarioError("is 0, expected more for a required peer", f"{place}.timeout")
        return Peer(heartbeat=watchdog, state=-1, required=self.required, number=self.number)


class GuardSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Limits of the torque of an arm between its controller and the codec; see ``guard.h``.

    `port`: the component's torque output, by name; `q`, `dq`: its inputs of position and velocity.
    Limits are SI or with a unit, one for all joints or one a joint; None: not limited. `brake`:
    N.m.s/rad beyond a soft limit. `stops`: names of guards that do not only limit but stop the
    node (`finite`, `torque`, `rate`, `position`, `velocity`, `power`, `jump`).
    """

    port: str = "tau"
    q: str = "q"
    dq: str = "dq"
    tau_max: PerJoint = None
    rate_max: PerJoint = None
    q_low: PerJoint = None
    q_high: PerJoint = None
    dq_max: PerJoint = None
    power_max: PerJoint = None
    q_jump: PerJoint = None
    brake: Number = 0.0
    stops: tuple[str, ...] = ("finite", "jump")

    def part(self, first: int, joints: int) -> GuardSpec:
        """The limits of `joints` joints from number `first` of the arm on."""
        return part(self, _UNITS, first, joints)

    def build(self, joints: int, h: float, place: str = "guard") -> TorqueGuard:
        """The guard of so many joints, stepped every `h` s. Raises ScenarioError."""
        return TorqueGuard(self, joints, h, place)


@final
class TorqueGuard:
    """A guard in C with all it points to; `struct` is what a node's outlet is given."""

    def __init__(self, spec: GuardSpec, joints: int, h: float, place: str = "guard") -> None:
        if joints < 1 or not 0 < h < inf:
            raise ScenarioError(
                f"{joints} joints, h = {h:g} s, expected at least 1 and h > 0", place
            )
        self.joints = joints
        self.limits = {
            name: (per_joint if name in _SIGNED else limits)(
                getattr(spec, name), joints, unit, f"{place}.{name}"
            )
            for name, unit in _UNITS.items()
        }  # (joints,) each, or None
        self._check_order(place)
        self.last_tau, self.last_q = np.zeros(joints), np.full(joints, nan)
        brake = to_si(spec.brake, "N.m.s/rad", f"{place}.brake")
        if not 0 <= brake < inf:
            raise ScenarioError(f"is {brake:g}, expected 0 or more, finite", f"{place}.brake")
        self.struct = native.Guard(joints=joints, stops=_stops(spec.stops, place), brake=brake, h=h)
        for name, values in self.limits.items():
            setattr(self.struct, name, None if values is None else address(values))
        self.struct.last_tau, self.struct.last_q = address(self.last_tau), address(self.last_q)

    def _check_order(self, place: str) -> None:
        low, high = self.limits["q_low"], self.limits["q_high"]
        if low is not None and high is not None and not (low < high).all():
            raise ScenarioError(
                f"q_low is {low.tolist()} rad, q_high {high.tolist()} rad, expected low < high",
                place,
            )

    def apply(
        self, tau: ArrayLike, q: ArrayLike | None, dq: ArrayLike | None, scale: float = 1.0
    ) -> tuple[Array, GuardBit]:
        """The part of `tau` (joints,), N.m, that may act at q, dq (joints,); and what was done to
        it.

        Raises ScenarioError where a shape does not fit.
        """
        out = np.empty(self.joints)
        given = [None if x is None else vector(x, self.joints, "guard") for x in (tau, q, dq)]
        pointers = [None if x is None else address(x) for x in given]
        call = native.functions().guard_apply
        bits = call(c.byref(self.struct), *pointers, float(scale), address(out))
        return out, GuardBit(bits)

    def why(self) -> Why:
        """The reason that the last tick's bits raise in the life cycle."""
        return Why(native.functions().guard_why(c.byref(self.struct)))

    def trips(self) -> dict[str, int]:
        """Ticks in which each guard did something, by name."""
        return {name: self.struct.trips[n] for n, name in enumerate(names(GuardBit(127)))}


def part(spec: Spec, names: Iterable[str], first: int, joints: int) -> Spec:
    """A spec of which only `joints` joints from number `first` on remain, in the fields `names`."""
    listed = {name: getattr(spec, name) for name in names}
    cut = {n: v[first : first + joints] for n, v in listed.items() if isinstance(v, tuple)}
    return replace(spec, **cut)  # type: ignore[type-var]  # of any struct


def per_joint(value: PerJoint, joints: int, unit: str, place: str) -> Array | None:
    """One value a joint in `unit`, (joints,); None: not limited. Raises ScenarioError."""
    if value is None:
        return None
    listed = [value] * joints if isinstance(value, str | float | int) else list(value)
    if len(listed) != joints:
        raise ScenarioError(f"has {len(listed)} values, expected 1 or {joints}", place)
    return np.array([to_si(v, unit, f"{place}[{n}]") for n, v in enumerate(listed)])


def limits(value: PerJoint, joints: int, unit: str, place: str) -> Array | None:
    """Return one limit per joint, (joints,), 0 or more, in `unit`; None: not limited.

    Raises ScenarioError for invalid values.
    """
    values = per_joint(value, joints, unit, place)
    if values is not None and not (values >= 0).all():
        raise ScenarioError(f"is {values.tolist()} {unit}, expected 0 or more", place)
    return values


def _stops(stops: Iterable[str], place: str) -> int:
    known = {(bit.name or "").lower(): bit for bit in GuardBit}
    bits = GuardBit(0)
    for name in stops:
        if name not in known:
            raise ScenarioError(f"is {name!r}, expected {', '.join(known)}", f"{place}.stops")
        bits |= known[name]
    return int(bits)


def vector(values: ArrayLike, joints: int, place: str) -> Array:
    """Return values (joints,) for C, in their own unit. Raises ScenarioError for another shape."""
    found = np.ascontiguousarray(values, dtype=np.float64)
    if found.shape != (joints,):
        raise ScenarioError(f"shape is {found.shape}, expected ({joints},)", place)
    return found


def address(values: Array) -> int:
    """The address of values (n,), of any unit, for C: the caller keeps them."""
    return values.ctypes.data


def step(life: LifeStruct) -> LifeState:
    """One tick of a life cycle."""
    return LifeState(native.functions().life_step(c.byref(life)))
