"""Valid range and rate of each received value: C refuses samples outside.

The range of a value is the intersection of:

* the range that its DBC signal can represent, and the range declared in the DBC file;
* the min and max that the components declare for the output and the input;
* the range of the signal in the deployment (``[signals]``); without it
* for a torque of a drive: twice the drive's `tau_max`, since the drive limits smaller torques;
* for position, velocity and torque in a drive's profile: `q_max`, twice `dq_max` and `tau_max`.

The limits of a guard define no range, because the guard must see values that exceed them.

The rate is that of the deployment; without it, the whole range in `CROSSING`, or for torques in
`TORQUE_CROSSING`. Torques may fall to 0 at any rate, because guards and ramps remove them at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, isfinite

from bridge.can.codec import Codec
from bridge.deployment.carried import Carried
from bridge.deployment.cut import Inlet
from bridge.deployment.protection import emulated
from bridge.deployment.signal_spec import SignalSpec
from bridge.deployment.spec import NodeSpec
from bridge.deployment.system import System
from bridge.drives.profile_files import load_profile
from bridge.native.message import Limit
from bridge.safety.limits import PerJoint, to_si
from cosim.base.component import Port
from cosim.base.errors import ScenarioError

#: s in which a signal may cross its whole range; a torque.
CROSSING, TORQUE_CROSSING = 0.1, 0.01
#: What is still believed of a limit that somebody else keeps: so many times the limit.
BEYOND = 2.0
#: Values beyond this are no limits (float32 and float64 fields).
HUGE = 1e30

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Value:
    """One value of a message: entry `entry` of a port of its first sender."""

    component: str
    port: str
    entry: int
    unit: str

    @property
    def name(self) -> str:
        """``component.port``."""
        return f"{self.component}.{self.port}"


def limits(system: System, node: str, carried: Carried) -> list[Limit]:
    """A limit a value of a message that `node` receives. Raises ScenarioError."""
    return [_limit(system, node, carried, i, v) for i, v in enumerate(values(carried))]


def unlimited(system: System, node: str, carried: Carried) -> list[str]:
    """Signals of a message that have no range on one side at least, each once."""
    found = zip(values(carried), limits(system, node, carried), strict=True)
    names = [v.name for v, x in found if not (isfinite(x.low) and isfinite(x.high))]
    return list(dict.fromkeys(names))


def values(carried: Carried) -> Iterator[Value]:
    """The values of a message, in their order."""
    for part in carried.outlet.parts:
        index = part.name.partition("[")[2].rstrip("]").rpartition(",")[2]
        first = int(index) - part.base if not part.shape and index.isdigit() else 0
        for i in range(part.size):
            yield Value(part.component, part.port, first + i, part.unit_of(i))


def _limit(system: System, node: str, carried: Carried, index: int, value: Value) -> Limit:
    said = _said(system, value)
    inlets = [
        x
        for x in system.nodes[node].inlets
        if x.message == carried.name and x.first <= index < x.first + x.target.size
    ]
    spec = system.deployment.nodes[node]
    torque = spec.drive is not None and any(x.target.port == spec.drive.port for x in inlets)
    ranges = [*_of_codec(carried, index), *_declared(system, value, inlets)]
    if said.range is not None:
        ranges.append(_range(system, value, said))
    else:
        ranges += _of_drives(system, spec, carried, value, torque=torque)
    low, high = max((r[0] for r in ranges), default=-inf), min((r[1] for r in ranges), default=inf)
    if not low <= high:
        text = f"{carried.name} carries {value.name}, whose ranges have nothing in common"
        raise ScenarioError(f"{text}: {ranges}", system.deployment.place("signals", value.name))
    rate = (high - low) / (TORQUE_CROSSING if torque else CROSSING)
    if said.rate is not None:
        place = system.deployment.place("signals", value.name, "rate")
        rate = _positive(said.rate, f"{value.unit}/s", place)
    return Limit(low, high, rate, torque)


def _said(system: System, value: Value) -> SignalSpec:
    signals = system.deployment.signals
    return signals.get(value.name) or signals.get(value.port) or SignalSpec()


def _range(system: System, value: Value, said: SignalSpec) -> Range:
    place = system.deployment.place("signals", value.name, "range")
    if not isinstance(said.range, tuple):
        most = _positive(said.range, value.unit, place)  # type: ignore[arg-type]
        return -most, most
    low, high = (to_si(x, value.unit, place) for x in said.range)
    if not low < high:
        raise ScenarioError(f"is {low:g} to {high:g}, expected the lower value first", place)
    return low, high


def _positive(number: float | str, unit: str, place: str) -> float:
    found = to_si(number, unit, place)
    if not found > 0:
        raise ScenarioError(f"is {found:g}, expected more than 0", place)
    return found


def _of_codec(carried: Carried, index: int) -> Iterator[Range]:
    assert isinstance(carried.encoding, Codec)
    signal = carried.encoding.signals[index]
    low, high = sorted(signal.scale * r + signal.offset for r in signal.raw_range)
    if low > -HUGE and high < HUGE:
        yield low, high


def _declared(system: System, value: Value, inlets: list[Inlet]) -> Iterator[Range]:
    outputs = system.plan.component(value.component).component.outputs
    yield from ((p.low, p.high) for p in outputs if p.name == value.port)
    for inlet in inlets:
        ports: tuple[Port, ...] = system.plan.component(inlet.component).component.inputs
        for port in ports:
            if port.name == inlet.target.port and inlet.gain:
                ends = ((x - inlet.offset) / inlet.gain for x in (port.low, port.high))
                low, high = sorted(ends)
                yield low, high


def _of_drives(
    system: System, spec: NodeSpec, carried: Carried, value: Value, *, torque: bool
) -> Iterator[Range]:
    d = system.deployment
    if torque and spec.drive is not None:
        yield from _twice_limit(emulated(spec.drive, d).tau_max, value, "N.m", "drive")
    profile = d.messages[carried.name].profile
    if profile:
        known = load_profile(d.file(profile)).limits
        m = d.messages[carried.name]
        name = {"q": "q_max", "dq": "dq_max", "tau": "tau_max"}.get(value.port, "")
        if name in known and m.gear == 1.0 and not m.zero:
            most = known[name] * (1.0 if name == "q_max" else BEYOND)
            yield -most, most


def _twice_limit(limit: PerJoint, value: Value, unit: str, place: str) -> Iterator[Range]:
    """Twice a limit, one for all joints or one a joint."""
    if limit is None:
        return
    one = limit[value.entry] if isinstance(limit, list | tuple) else limit
    most = BEYOND * to_si(one, unit, place)
    yield -most, most
