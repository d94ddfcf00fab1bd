"""The state of a node in lock-step between two slots, as bytes by name.

It is the state of its engine, the numbers of the structs of its gates with what they point to, and
the samples that it has received for later slots. All else follows from the deployment.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Iterator, Mapping

import numpy as np

from bridge.deployment.system import System
from bridge.native import lockstep as native
from bridge.native.bus import BusStruct
from bridge.native.delay import Delay, SampleStruct, WaitingStruct
from bridge.native.frame import Frame
from bridge.native.message import Receiver
from bridge.native.node import InletStruct, Inside, NodeStruct, OutletStruct, Reception
from bridge.native.safety import DriveStruct, Guard
from bridge.node.lockstep import Lockstep
from cosim.base.errors import RunError, ScenarioError
from cosim.checkpoint import memory, state
from cosim.checkpoint.memory import Piece, array, whole
from cosim.fmi.components import stepped_fmu

#: Fields of a node that come from outside at any time.
_OUTSIDE = ("asked_ns", "told", "quit", "alarm")
#: Fields of a bus to other nodes that are in the report of a node.
_COUNTED = ("received", "sent")


def refuse(system: System) -> None:
    """Raise ScenarioError, with the node, if its state cannot be saved."""
    for name, plan in system.nodes.items():
        try:
            state.refuse(plan.plan)
        except ScenarioError as error:
            raise ScenarioError(f"node {name}: {error}") from error
        for step in plan.plan.components:
            fmu = stepped_fmu(step.component)
            if fmu is not None and (fmu.options.isolate or fmu.options.wasm):
                raise ScenarioError(
                    f"node {name}: --checkpoint: found what a checkpoint cannot save: {step.name} "
                    "is isolated; expected isolate = false in lock-step"
                )
        if plan.forwards:
            raise ScenarioError(f"node {name} forwards messages; expected no gateway")


def save(node: Lockstep, before_ns: int) -> dict[str, bytes]:
    """The state, with the samples sent before a time. Raises RunError, ScenarioError, FmuError."""
    for bus in node.wired.buses:
        if (bus.rx and len(bus.rx)) or (bus.tx and len(bus.tx)):
            raise RunError(f"node {node.wired.name} has frames between two slots; expected none")
    found = {f"engine/{name}": data for name, data in state.save(node.wired.engine).items()}
    found |= {f"node/{piece[0]}": memory.save(piece) for piece in _pieces(node)}
    for i, stream in enumerate(node.streams):
        last = native.sent_before(stream, before_ns)
        if stream.received < last:
            raise RunError(f"node {node.wired.name} lacks samples of stream {i}")
        found[f"given/{i}"] = np.array([stream.given, last], np.int64).tobytes()
        size = (last - stream.given) * c.sizeof(Frame)
        found[f"samples/{i}"] = c.string_at(_frame(stream, stream.given), size)
    return found


def restore(node: Lockstep, saved: Mapping[str, bytes]) -> None:
    """Bring a node that has been started to this state. Raises ScenarioError, FmuError, RunError;
    then the node is of no use.
    """
    own = {name.removeprefix("engine/"): data for name, data in saved.items()}
    try:
        for piece in _pieces(node):
            memory.restore(piece, saved[f"node/{piece[0]}"])
        state.restore(node.wired.engine, int(node.wired.struct.slot), own)
        for i, stream in enumerate(node.streams):
            stream.given, stream.received = np.frombuffer(saved[f"given/{i}"], np.int64).tolist()
            data = saved[f"samples/{i}"]
            c.memmove(_frame(stream, stream.given), data, len(data))
    except (KeyError, ValueError) as error:
        raise ScenarioError(
            f"the checkpoint does not fit node {node.wired.name} ({error}); expected one of the "
            "same version"
        ) from error


def _frame(stream: native.StreamStruct, number: int) -> int:
    return c.addressof(stream.frames.contents) + number * c.sizeof(Frame)


def _pieces(node: Lockstep) -> Iterator[Piece]:
    """All pieces of a node, in an order that its plan determines."""
    wired = node.wired
    yield _but(array("node", NodeStruct, c.addressof(wired.struct), 1), _OUTSIDE)
    for name, bus in zip(wired.system.buses_of(wired.name), wired.buses, strict=True):
        piece = array(f"bus.{name}", BusStruct, c.addressof(bus.struct), 1)
        yield piece[0], piece[1], _COUNTED
    for name, bus in node.outside.items():
        piece = array(f"outside.{name}", BusStruct, c.addressof(bus.struct), 1)
        yield piece[0], piece[1], _COUNTED
    for name, reception in wired.inlet_bindings.receptions.items():
        yield array(f"reception.{name}", Reception, c.addressof(reception), 1)
        yield whole(f"received.{name}", reception.values, 8 * reception.width)
        receiver = wired.receivers[name]
        yield array(f"receiver.{name}", Receiver, c.addressof(receiver), 1)
    for name, line in wired.lines.items():
        yield from _line(name, line.struct)
    for i in range(wired.struct.n_inlets):
        yield from _inlet(i, wired.inlet_bindings.inlets[i])
    for i in range(wired.struct.n_outlets):
        outlet = wired.outlet_bindings.outlets[i]
        yield array(f"outlet.{i}", OutletStruct, c.addressof(outlet), 1)
        yield whole(f"sent.{i}", outlet.values, 8 * outlet.width)
    if wired.struct.n_insides:
        at = c.addressof(wired.struct.insides.contents)
        yield array("insides", Inside, at, wired.struct.n_insides)
    for name, guard in wired.guards.items():
        yield array(f"guard.{name}", Guard, c.addressof(guard.struct), 1)
        yield whole(f"guard.{name}.tau", guard.struct.last_tau, 8 * guard.struct.joints)
        yield whole(f"guard.{name}.q", guard.struct.last_q, 8 * guard.struct.joints)
    for i, drive in enumerate(wired.drives):
        yield array(f"drive.{i}", DriveStruct, c.addressof(drive.struct), 1)
        yield whole(f"drive.{i}.tau", drive.struct.tau, 8 * drive.struct.joints)


def _line(name: str, line: Delay) -> Iterator[Piece]:
    """A delay line."""
    yield array(f"line.{name}", Delay, c.addressof(line), 1)
    n = line.capacity
    yield array(f"line.{name}.samples", SampleStruct, c.addressof(line.samples.contents), n)
    yield array(f"line.{name}.queue", WaitingStruct, c.addressof(line.queue.contents), n)
    yield whole(f"line.{name}.values", line.values, 8 * (n + 1) * line.width)
    if line.depth:
        yield whole(f"line.{name}.waiting", line.line, 8 * line.depth)


def _inlet(number: int, inlet: InletStruct) -> Iterator[Piece]:
    yield array(f"inlet.{number}", InletStruct, c.addressof(inlet), 1)
    yield whole(f"inlet.{number}.initial", inlet.initial, 8 * inlet.count)
    if inlet.drive:
        yield whole(f"inlet.{number}.command", inlet.command, 8 * inlet.count)


def _but(piece: Piece, left_out: tuple[str, ...]) -> Piece:
    name, rows, fields = piece
    return name, rows, tuple(field for field in fields if field not in left_out)
