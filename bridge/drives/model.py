"""Motor drives as a plant meets them: C (``bridge/c/drive.c``), seen from Python."""

from __future__ import annotations

import ctypes as c
from dataclasses import dataclass
from math import inf
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bridge.native import safety as native
from bridge.native.safety import DriveRequest, DriveState
from bridge.safety.limits import PerJoint, Value, WatchdogSpec, in_si, limits
from cosim.base.errors import ScenarioError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DriveSpec:
    """A torque-controlled drive; SI or with a unit.

    `tau_max`: N.m, one for all joints or one a joint, None: not limited. `lag`: s, of the current
    loop. `damping`: N.m.s/rad in FAULT (a shorted winding), 0: freewheeling; keep damping·h well
    below the inertia it acts on, or the plant's step makes it unstable. `q_lsb`, `dq_lsb`,
    `tau_lsb`: resolutions, 0: none. `watchdog`: s without a valid command until FAULT, 0: off.
    """

    tau_max: PerJoint = None
    lag: Value = 0.0
    damping: Value = 0.0
    q_lsb: Value = 0.0
    dq_lsb: Value = 0.0
    tau_lsb: Value = 0.0
    watchdog: Value = "20 ms"
    accept_simulated: bool = True

    def build(self, joints: int, h: float, place: str = "drive") -> Drive:
        """The drive of so many joints, off, stepped every `h` s. Raises ScenarioError."""
        return Drive(self, joints, h, place)


_UNITS = {
    "lag": "s",
    "damping": "N.m.s/rad",
    "q_lsb": "rad",
    "dq_lsb": "rad/s",
    "tau_lsb": "N.m",
}


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
            watchdog=WatchdogSpec(spec.watchdog).build(0, f"{place}.watchdog"),
            accept_simulated=spec.accept_simulated,
            tau=_address(self.tau),
        )
        if self.tau_max is not None:
            self.struct.tau_max = _address(self.tau_max)
        for name, unit in _UNITS.items():
            value = in_si(getattr(spec, name), unit, f"{place}.{name}")
            if not 0 <= value < inf:
                raise ScenarioError(
                    f"is {value:g} {unit}, expected 0 or more, finite", f"{place}.{name}"
                )
            setattr(self.struct, name, value)

    @property
    def state(self) -> DriveState:
        """Where the drive is."""
        return DriveState(self.struct.state)

    def request(self, request: DriveRequest, now_ns: int) -> DriveState:
        """Ask for a change of state; one that does not fit changes nothing. Returns the state."""
        call = native.functions().drive_request
        return DriveState(call(c.byref(self.struct), request, now_ns))

    def accepts(self, status: int) -> bool:
        """Whether a frame with this status byte may move this drive."""
        return bool(native.functions().drive_accepts(c.byref(self.struct), status))

    def step(self, command: ArrayLike, valid: bool, dq: ArrayLike, now_ns: int) -> Array:
        """Torque (joints,), N.m, that acts until the next tick.

        `command` (joints,), N.m, as received last; `valid`: one has arrived since the last tick;
        dq (joints,), rad/s. Raises ScenarioError where a shape does not fit.
        """
        torque = np.empty(self.joints)
        given = self._vector(command), self._vector(dq)
        call = native.functions().drive_step
        call(
            c.byref(self.struct), _address(given[0]), valid, _address(given[1]), now_ns,
            _address(torque),
        )  # fmt: skip
        return torque

    def measure(self, q: ArrayLike, dq: ArrayLike) -> tuple[Array, Array]:
        """Position (rad) and velocity (rad/s), (joints,) each, as its encoders resolve them."""
        given = self._vector(q), self._vector(dq)
        seen = np.empty(self.joints), np.empty(self.joints)
        call = native.functions().drive_measure
        call(c.byref(self.struct), *(_address(x) for x in (*given, *seen)))
        return seen

    def _vector(self, values: ArrayLike) -> Array:
        vector = np.ascontiguousarray(values, dtype=np.float64)
        if vector.shape != (self.joints,):
            raise ScenarioError(f"shape is {vector.shape}, expected ({self.joints},)", "drive")
        return vector


def _address(values: Array) -> object:
    return values.ctypes.data_as(native.Doubles)
