"""A node whose image lives by its own clock, on the buses of the deployment."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from bridge.can import interface
from bridge.can.interface import Attachment
from bridge.deployment.system import System
from bridge.firmware.emulator import Emulator
from bridge.firmware.on_buses import FrameCopy
from bridge.firmware.records import WALL
from bridge.firmware.slots import expected, greet
from bridge.native.safety import Command
from bridge.node.buses import can_spec, give_bell
from bridge.node.handle import SlotImage
from cosim.base.clock import monotonic_ns
from cosim.base.errors import ScenarioError
from cosim.base.interrupts import act_on_signal, until_signal


def run_image(
    system: System, name: str, image: SlotImage, note: Callable[[str], None], *, now: bool
) -> FrameCopy:
    """Run an image until Ctrl-C, which lets it ramp down; return the numbers of its frames.

    `note` receives what is to be said; `now`: ARM and START at once. Raises ScenarioError for an
    image of another node or deployment, and for a bus that is not CAN, FirmwareError if the image
    ends.
    """
    ramp = system.deployment.seconds(system.deployment.nodes[name].ramp, "nodes", name, "ramp")
    with _opened(system, name) as ends, Emulator(Path(image.path), name) as emulator:
        lives = (monotonic_ns() // 1_000_000 % 2**32).to_bytes(4, "little")
        greet(emulator, WALL + lives, expected(system, name, bytes.fromhex(image.token)))
        on = True  # until a signal leaves the block
        copy = FrameCopy(emulator, [end.bus for end in ends], note)
        with until_signal():
            waiting = "starting" if now else "waiting for NMT start on its bus (Ctrl-C ends)"
            note(f"ready on {emulator.machine.name}, {waiting}")
            for command in (Command.ARM, Command.START) if now else ():
                copy.tell(command)
            while on:
                act_on_signal()
                copy.turn()
        copy.tell(Command.STOP)
        until = monotonic_ns() + round(2e9 * ramp)
        while monotonic_ns() < until:
            copy.turn()
    return copy


@contextmanager
def _opened(system: System, name: str) -> Iterator[list[Attachment]]:
    """The buses of a node, in their order, with its filters. Raises BusError, ScenarioError."""
    d = system.deployment
    with ExitStack() as stack:
        ends = []
        for number, bus in enumerate(system.buses_of(name)):
            if d.buses[bus].kind != "can":
                text = f"found {d.buses[bus].kind} for a node with --firmware, expected CAN"
                raise ScenarioError(text, d.place("buses", bus))
            accepts = [accept.any_format() for accept in system.accepts(name, bus)]
            end = interface.attach(can_spec(d, bus), number=number, accepts=accepts)
            stack.callback(give_bell(end))
            stack.callback(end.close)
            ends.append(end)
        yield ends
