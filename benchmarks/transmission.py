"""The automatic transmission of the ARCH competition, many runs at once.

Engine with a torque map, torque converter, four gears with a shift logic, and vehicle. Source: the
Simulink model ``Autotrans_shift.mdl`` of B. Hoxha, H. Abbas and G. Fainekos, "Benchmarks for
Temporal Logic Requirements for Automotive Systems", ARCH 2014, after the example "Modeling an
Automatic Transmission Controller" of The MathWorks. The equations are::

    Iei dN/dt = Te(throttle, N) - Ti,    600 rpm <= N <= 6000 rpm
    Ti = (N / K(r))²,  Tout = Ti Tr(r) R(gear),  r = R(gear) Rfd w / N
    Iv dw/dt = Rfd Tout - sign(v) (40 + 0.02 v² + brake),  v = 2 pi w 60/5280 (radius 1 ft)

with the engine's speed N and the wheels' speed w (rpm), the torques of impeller Ti and gearbox
Tout (ft lb) and the vehicle's speed v (mph). The tables Te, K, Tr and the thresholds of the shift
logic are interpolated, and beyond their ends extrapolated, linearly. The shift logic runs every
0.04 s: a shift comes two ticks after v has passed the threshold of its gear, if v still is beyond.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from cosim.links.laws import FloatArray, IntArray

#: The step of the integration, and of the recorded rows, s; steps between two of the shift logic.
STEP, CHART = 0.02, 2
#: Ticks of the shift logic that a shift waits.
WAIT = 2

_THROTTLE = np.array([0.0, 20, 30, 40, 50, 60, 70, 80, 90, 100])
_FIRST_RPM, _RPM, _RPMS = 800.0, 400.0, 11
#: Torque of the engine, ft lb, at each throttle (%) from 800 rpm to 4800 rpm.
_TORQUE = np.array([
    [-40.0, -44, -49, -53, -57, -61, -65, -70, -74, -78, -82],
    [215, 117, 85, 66, 44, 29, 10, -2, -13, -22, -32],
    [245, 208, 178, 148, 122, 104, 85, 66, 48, 33, 18],
    [264, 260, 241, 219, 193, 167, 152, 133, 119, 96, 85],
    [264, 279, 282, 275, 260, 238, 223, 208, 189, 171, 152],
    [267, 290, 293, 297, 290, 275, 260, 256, 234, 212, 193],
    [267, 297, 305, 305, 305, 301, 293, 282, 267, 249, 226],
    [267, 301, 308, 312, 319, 323, 319, 316, 297, 279, 253],
    [267, 301, 312, 319, 327, 327, 327, 327, 312, 293, 267],
    [267, 301, 312, 319, 327, 334, 334, 334, 319, 305, 275],
])  # fmt: skip
#: The torque converter: ratio of speeds, capacity factor K (rpm/sqrt(ft lb)), ratio of torques.
_RATIO = np.array([
    0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.81, 0.82, 0.83, 0.84, 0.85, 0.86, 0.87, 0.88,
    0.89, 0.9, 0.92, 0.94,
])  # fmt: skip
_FACTOR = np.array([
    137.4652089938063, 137.06501915685197, 135.86444964598905, 135.6643547275119,
    137.56525645304487, 140.3665853117251, 145.2689108144154, 152.87251771654735,
    162.97731109964374, 164.2779280697452, 166.17882979527823, 167.97968406157264,
    170.08068070558275, 172.78196210502438, 175.3831960452274, 179.58518933324765,
    183.58708770279083, 189.8900776348212, 197.69377945543027, 215.90241703685155,
    244.51599037908485,
])  # fmt: skip
_TORQUES = np.array([
    2.232, 2.075, 1.975, 1.846, 1.72, 1.564, 1.409, 1.254, 1.096, 1.08, 1.061, 1.043, 1.028, 1.012,
    1.002, 1.002, 1.001, 0.998, 0.999, 1.001, 1.002,
])  # fmt: skip
_GEARS = np.array([2.393, 1.450, 1.000, 0.677])
#: Speeds (mph) by throttle (%) and gear at which the gear changes.
_UP_AT = np.array([0.0, 25, 35, 50, 90, 100])
_UP = np.array([
    [10.0, 30, 50, 1e6], [10, 30, 50, 1e6], [15, 30, 50, 1e6], [23, 41, 60, 1e6],
    [40, 70, 100, 1e6], [40, 70, 100, 1e6],
])  # fmt: skip
_DOWN_AT = np.array([0.0, 5, 40, 50, 90, 100])
_DOWN = np.array([
    [0.0, 5, 20, 35], [0, 5, 20, 35], [0, 5, 25, 40], [0, 5, 30, 50], [0, 30, 50, 80],
    [0, 30, 50, 80],
])  # fmt: skip
#: Inertias of engine and impeller, and of the vehicle; final drive; mph of a wheel of 1 rpm.
_IEI, _IV, _RFD, _MPH = 0.021991488283555904, 12.094147857312473, 3.23, 2 * pi * 60 / 5280
_SLOWEST, _FASTEST, _IDLE = 600.0, 6000.0, 1000.0
_STEADY, _RISING, _FALLING = 0, 1, -1


def _share(x: FloatArray, at: FloatArray) -> tuple[IntArray, FloatArray]:
    """The interval of `at` (m,) for each of `x` (n,), and the place in it, 0 to 1 or beyond."""
    i = np.clip(np.searchsorted(at, x, side="right") - 1, 0, len(at) - 2)
    return i, (x - at[i]) / (at[i + 1] - at[i])


def _rows(table: FloatArray, x: FloatArray, at: FloatArray) -> FloatArray:
    """The rows of a table (m, k) at `x` (n,), (n, k), in its unit."""
    i, u = _share(x, at)
    found: FloatArray = table[i] + u[:, None] * (table[i + 1] - table[i])
    return found


def _derivatives(
    N: FloatArray, w: FloatArray, torque: FloatArray, ratio: FloatArray, brake: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(dN/dt, dw/dt), rpm/s; `torque` (n, 11): of the engine by speed, ft lb."""
    n = np.arange(len(N))
    N = np.clip(N, _SLOWEST, _FASTEST)
    i, u = _share(ratio * _RFD * w / N, _RATIO)
    Ti = (N / (_FACTOR[i] + u * (_FACTOR[i + 1] - _FACTOR[i]))) ** 2
    out = Ti * (_TORQUES[i] + u * (_TORQUES[i + 1] - _TORQUES[i])) * ratio
    place = (N - _FIRST_RPM) / _RPM
    k = np.clip(place.astype(np.int64), 0, _RPMS - 2)
    low = torque[n, k]
    dN = (low + (place - k) * (torque[n, k + 1] - low) - Ti) / _IEI
    dN = np.where((N <= _SLOWEST) & (dN < 0) | (N >= _FASTEST) & (dN > 0), 0.0, dN)
    v = _MPH * w
    return dN, (_RFD * out - np.sign(v) * (40.0 + 0.02 * v * v + brake)) / _IV


@dataclass(slots=True)
class _Shift:
    """The shift logic of each run: its gear, from 0; what it waits for, and for how many ticks."""

    gear: IntArray
    waits: IntArray
    ticks: IntArray

    def tick(self, v: FloatArray, throttle: FloatArray) -> None:
        """The next tick, at a speed (mph) and a throttle (%)."""
        n = np.arange(len(v))
        up = _rows(_UP, throttle, _UP_AT)[n, self.gear]
        down = _rows(_DOWN, throttle, _DOWN_AT)[n, self.gear]
        self.ticks += 1
        due = self.ticks >= WAIT
        rising, falling = self.waits == _RISING, self.waits == _FALLING
        steady = self.waits == _STEADY
        shifts_up, shifts_down = rising & due & (v >= up), falling & due & (v <= down)
        ends = shifts_up | shifts_down | rising & (v < up) | falling & (v > down)
        begins = np.where(v > up, _RISING, np.where(v < down, _FALLING, _STEADY))
        self.gear = np.clip(self.gear + shifts_up - shifts_down, 0, len(_GEARS) - 1)
        self.waits = np.where(steady, begins, np.where(ends, _STEADY, self.waits))
        self.ticks[steady & (begins != _STEADY)] = 0


def simulate(throttle: FloatArray, brake: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Speed (mph), engine's speed (rpm) and gear, (ticks + 1, runs), a row every :data:`STEP`.

    `throttle` (%), `brake` (ft lb): (ticks, runs), each held for a step; the vehicle is at rest
    first. Steps of Runge-Kutta 4.
    """
    ticks, runs = throttle.shape
    N, w = np.full(runs, _IDLE), np.zeros(runs)
    found = np.empty((3, ticks + 1, runs))
    shift = _Shift(*(np.zeros(runs, np.int64) for _ in range(3)))
    torque, before = np.empty((runs, _RPMS)), np.full(runs, np.nan)
    h = STEP
    for k in range(ticks + 1):
        a, b = throttle[min(k, ticks - 1)], brake[min(k, ticks - 1)]
        if k and k % CHART == 0:
            shift.tick(_MPH * w, a)
        found[:, k] = _MPH * w, N, shift.gear + 1
        if not np.array_equal(a, before):
            torque, before = _rows(_TORQUE, a, _THROTTLE), a
        ratio = _GEARS[shift.gear]
        dN1, dw1 = _derivatives(N, w, torque, ratio, b)
        dN2, dw2 = _derivatives(N + h / 2 * dN1, w + h / 2 * dw1, torque, ratio, b)
        dN3, dw3 = _derivatives(N + h / 2 * dN2, w + h / 2 * dw2, torque, ratio, b)
        dN4, dw4 = _derivatives(N + h * dN3, w + h * dw3, torque, ratio, b)
        N = np.clip(N + h / 6 * (dN1 + 2 * dN2 + 2 * dN3 + dN4), _SLOWEST, _FASTEST)
        w = w + h / 6 * (dw1 + 2 * dw2 + 2 * dw3 + dw4)
    return found[0], found[1], found[2]
