"""Motor drives between bus and plant: the Python side of ``bridge/c/drive.c``."""

from __future__ import annotations

import ctypes as c
from math import inf
from typing import final

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from bridge.native import safety as native
from bridge.native.safety import DriveRequest, DriveState
from bridge.safety.limits import PerJoint, WatchdogSpec, address, limits, part, to_si, vector
from cosim.base.convert import Number
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError

Array = NDArray[np.float64]


class DriveSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An emulated torque-controlled drive between the bus and a plant's torque input `port`.

    `q`, `dq`: the plant's outputs that its encoders measure. `profile`: a file, relative to the
    deployment, with the values that are not given here; the others are in :data:`DEFAULTS`.
    `max_age`: a torque that is older when it arrives, or when it takes effect, is refused; default:
    the time of the watchdog. Values are in SI units or texts with a unit:

    `tau_max`: N.m, one for all joints or one per joint; None: not limited. `lag`: s, of the current
    loop. `watchdog`: time without a valid command until FAULT, s; 0: off. `damping`: N.m.s/rad in
    FAULT (a shorted winding), 0: freewheeling; damping times h must be well below the inertia on
    which it acts, or the plant's step becomes unstable. `q_lsb`, `dq_lsb`, `tau_lsb`: resolutions,
    0: exact.
    """

    port: str = "tau"
    q: str = "q"
    dq: str = "dq"
    profile: str = ""
    max_age: Number | None = None
    tau_max: PerJoint = None
    lag: Number | None = None
    watchdog: Number | None = None
    damping: Number | None = None
    q_lsb: Number | None = None
    dq_lsb: Number | None = None
    tau_lsb: Number | None = None

    def over(self, other: DriveSpec) -> DriveSpec:
        """This drive, completed with the values of `other`."""
        missing = [name for name in VALUES if getattr(self, name) is None]
        return replace(self, **{name: getattr(other, name) for name in missing})

    def part(self, first: int, joints: int) -> DriveSpec:
        """The drive of `joints` joints from number `first` of the arm on."""
        return part(self, VALUES, first, joints)

    def encoders(self) -> DriveSpec:
        """Its encoders alone: no limit of torque, which may be one of more joints."""
        return replace(self, tau_max=None)

    def build(self, joints: int, h: float, place: str = "drive") -> Drive:
        """The drive of so many joints, off, stepped every `h` s. Raises ScenarioError."""
        return Drive(self.over(DEFAULTS), joints, h, place)


_UNITS = {
    "lag": "s",
    "damping": "N.m.s/rad",
    "q_lsb": "rad",
    "dq_lsb": "rad/s",
    "tau_lsb": "N.m",
}
#: What the struct of C is made of; a profile may say these.
VALUES = ("tau_max", "watchdog", *_UNITS)
DEFAULTS = DriveSpec(lag=0.0, damping=0.0, q_lsb=0.0, dq_lsb=0.0, tau_lsb=0.0, watchdog="20 ms")


@final
class Drive:
    """A drive in C with all it points to; `struct` is what a plant's inlet is given."""

    def __init__(self, spec: DriveSpec, joints: int, h: float, place: str = "drive") -> None:
        if joints < 1 or not 0 < h < inf:
            raise ScenarioError(
                f"{joints} joints, h = {h:g} s, expected at least 1 and h > 0", place
            )
        self.joints, self.tau = joints, np.zeros(joints)
        self.tau_max = limits(spec.tau_max, joints, "N.m", f"{place}.tau_max")
        self.struct = native.DriveStruct(
            joints=joints,
            h=h,
            watchdog=WatchdogSpec(spec.watchdog or 0.0).build(0, f"{place}.watchdog"),
            tau=address(self.tau),
        )
        if self.tau_max is not None:
            self.struct.tau_max = address(self.tau_max)
        for name, unit in _UNITS.items():
            value = to_si(getattr(spec, name), unit, f"{place}.{name}")
            if not 0 <= value < inf:
                raise ScenarioError(
                    f"is {value:g} {unit}, expected 0 or more, finite", f"{place}.{name}"
                )
            setattr(self.struct, name, value)

    @property
    def state(self) -> DriveState:
        """The state of the drive."""
        return DriveState(self.struct.state)

    def request(self, request: DriveRequest, now_ns: int) -> DriveState:
        """Ask for a change of state; one that does not fit changes nothing. Returns the state."""
        call = native.functions().drive_request
        return DriveState(call(c.byref(self.struct), request, now_ns))

    def step(self, command: ArrayLike, valid: bool, dq: ArrayLike, now_ns: int) -> Array:
        """Torque (joints,), N.m, that acts until the next tick.

        `command` (joints,), N.m, as received last; `valid`: one has arrived since the last tick;
        dq (joints,), rad/s. Raises ScenarioError where a shape does not fit.
        """
        torque = np.empty(self.joints)
        given = vector(command, self.joints, "drive"), vector(dq, self.joints, "drive")
        call = native.functions().drive_step
        call(
            c.byref(self.struct), address(given[0]), valid, address(given[1]), now_ns,
            address(torque),
        )  # fmt: skip
        return torque

    def measure(self, q: ArrayLike, dq: ArrayLike) -> tuple[Array, Array]:
        """Position (rad) and velocity (rad/s), (joints,) each, as its encoders resolve them."""
        given = vector(q, self.joints, "drive"), vector(dq, self.joints, "drive")
        seen = np.empty(self.joints), np.empty(self.joints)
        call = native.functions().drive_measure
        call(c.byref(self.struct), *(address(x) for x in (*given, *seen)))
        return seen
