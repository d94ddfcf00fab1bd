"""Guards, drives and stale inputs of a deployment, located in a node's plan.

An entry that refers to nothing is an error, before a node is built: a guard without a message, or a
drive that receives no torque, would silently have no effect.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from bridge.deployment.cut import Inlet, NodePlan, Outlet
from bridge.deployment.spec import Deployment, NodeSpec
from bridge.drives.model import DEFAULTS, DriveSpec
from bridge.drives.profile_files import load_profile
from bridge.safety.limits import GuardSpec, to_si
from cosim.base.errors import ScenarioError
from cosim.schedule.parts import Slot


@dataclass(frozen=True, slots=True)
class Span:
    """Values `first` ... `first + size` of a message are entries `entry` ... of a port."""

    first: int
    entry: int
    size: int


def span(outlet: Outlet, port: Slot | None, place: str) -> Span | None:
    """The position of a port in a message; None: not in it. Raises ScenarioError for parts of a
    port.
    """
    if port is None:
        return None
    found: list[tuple[int, int]] = []
    first = 0
    for part in outlet.parts:
        if (part.component, part.port) == (port.component, port.port):
            found += [(first + i, part.start - port.start + i) for i in range(part.size)]
        first += part.size
    if not found:
        return None
    value, entry = found[0]
    if found != [(value + i, entry + i) for i in range(len(found))]:
        text = f"{outlet.message} carries {port.name} in pieces; expected entries in their order"
        raise ScenarioError(text, place)
    return Span(value, entry, len(found))


def emulated(spec: DriveSpec, deployment: Deployment) -> DriveSpec:
    """A drive with all its values: those given, else those of its profile, else the defaults."""
    if spec.profile:
        spec = spec.over(load_profile(deployment.file(spec.profile)).drive)
    return spec.over(DEFAULTS)


def torque_age(spec: DriveSpec, d: Deployment, place: str) -> int:
    """The greatest age of a torque that moves a drive, ns: the given value, else that of its
    watchdog.

    Raises ScenarioError for an age that is not positive.
    """
    if spec.max_age is None:
        return round(to_si(emulated(spec, d).watchdog or 0.0, "s", f"{place}.watchdog") * 1e9)
    said = to_si(spec.max_age, "s", f"{place}.max_age")
    if not 0 < said < 1e6:
        raise ScenarioError(f"is {said:g} s, expected more than 0", f"{place}.max_age")
    return round(said * 1e9)


def drives_by(plan: NodePlan, spec: NodeSpec, message: str) -> bool:
    """True if a message carries torques of the node's drive."""
    port = spec.drive.port if spec.drive else None
    return any(i.message == message and i.target.port == port for i in plan.inlets)


def age_slot(plan: NodePlan, inlet: Inlet, text: str, place: str) -> int:
    """The signal ``age[0]`` of an inlet's component. Raises ScenarioError."""
    whole = f"{inlet.component}.{text}" in plan.plan.slots()
    port = text if whole or not text.endswith("]") else text.rpartition("[")[0]
    slot = input_of(plan, inlet.component, port, place)
    entries = [name.partition(".")[2] for name in slot.scalars()]
    if text not in (*entries, slot.port) or not entries:
        raise ScenarioError(f"{text!r} is not one of the {slot.size} entries of {slot.name}", place)
    return slot.start + (entries.index(text) if text in entries else 0)


def input_of(plan: NodePlan, component: str, port: str, place: str) -> Slot:
    """A port of a component, input or output. Raises ScenarioError where there is none."""
    slots = plan.plan.slots()
    if f"{component}.{port}" not in slots:
        ports = [s.port for s in slots.values() if s.component == component]
        known = ", ".join(sorted(ports))
        raise ScenarioError(f"{component} has no {port!r}; it has {known}", place)
    return slots[f"{component}.{port}"]


# ---- before a node is made --------------------------------------------------------------------


def check(plans: Mapping[str, NodePlan], d: Deployment) -> None:
    """Guards, drives and stale inputs name what is there. Raises ScenarioError."""
    for name, plan in plans.items():
        spec = d.nodes[name]
        _check_guard(plan, spec, d.place("nodes", name, "guard"))
        _check_drive(plan, spec, d, d.place("nodes", name, "drive"))
        known = {f"{i.component}.{i.target.port}" for i in plan.inlets}
        for key, stale in spec.stale.items():
            place = d.place("nodes", name, "stale", key)
            if key not in known:
                there = ", ".join(sorted(known)) or "none"
                text = f"no input {key!r} from another node; there are: {there}"
                raise ScenarioError(text, place)
            if stale.age:
                inlet = next(i for i in plan.inlets if f"{i.component}.{i.target.port}" == key)
                age_slot(plan, inlet, stale.age, f"{place}.age")


def _check_guard(plan: NodePlan, spec: NodeSpec, place: str) -> None:
    if spec.guard is None:
        return
    slots, port = plan.plan.slots(), spec.guard.port
    sent = [o for o in plan.outlets if span(o, slots.get(f"{o.component}.{port}"), place)]
    found = {o.component for o in sent} | {s.component for s in plan.guarded}
    if not found:
        text = f"no component of the node has an output {port!r} that goes anywhere"
        raise ScenarioError(f"{text}; expected a torque to guard", place)
    for component in sorted(found):
        _check_measured(slots, component, spec.guard, place)


def _check_measured(
    slots: Mapping[str, Slot], component: str, guard: GuardSpec, place: str
) -> None:
    """Limits on position and velocity require both measurements, one value per joint."""
    joints = slots[f"{component}.{guard.port}"].size
    for port, limits_ in ((guard.q, _POSITION), (guard.dq, _VELOCITY)):
        slot = slots.get(f"{component}.{port}")
        for name in limits_:
            if getattr(guard, name) is not None and (slot is None or slot.size != joints):
                there = f"{slot.size} {port}" if slot else f"no {port!r}"
                text = f"{name} needs a position or velocity of {joints} joints"
                raise ScenarioError(f"{text}; {component} has {there}", place)


_POSITION = ("q_low", "q_high", "q_jump")
_VELOCITY = ("dq_max", "power_max")


def _check_drive(plan: NodePlan, spec: NodeSpec, d: Deployment, place: str) -> None:
    if spec.drive is None:
        return
    torque_age(spec.drive, d, place)  # its profile is there, too
    found = [i for i in plan.inlets if i.target.port == spec.drive.port]
    if not found:
        text = f"no torque {spec.drive.port!r} arrives from another node; expected one to drive"
        raise ScenarioError(text, place)
    for inlet in found:
        for port in (spec.drive.q, spec.drive.dq):
            input_of(plan, inlet.component, port, place)
