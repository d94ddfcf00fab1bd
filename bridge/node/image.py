"""A node whose slots an image computes: its emulator, greeted, with the faults that it suffers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from bridge.faults.script import FaultEvent, FaultScript
from bridge.firmware.emulator import Emulator
from bridge.firmware.image_faults import ImageFaults
from bridge.firmware.records import SLOTS
from bridge.firmware.slots import ImageSlots, expected, greet
from bridge.node.control import Say
from bridge.node.handle import SlotImage
from bridge.wiring.wiring import WiredNode


@contextmanager
def image_slots(
    wired: WiredNode, image: SlotImage | None, script: FaultScript | None, say: Say
) -> Iterator[Callable[[], int] | None]:
    """The function that lets an image compute the next slot, while its emulator runs; None: there
    is no image.

    `say` receives each fault of its emulator. Raises ScenarioError if it is the image of another
    node or deployment, FirmwareError if it does not answer.
    """
    if image is None:
        yield None
        return
    name = wired.name
    events = script.process_events(list(wired.system.nodes)) if script is not None else ()

    def note(event: FaultEvent) -> None:
        facts = {"action": event.action, "target": name, "t": event.t, "index": event.index}
        say({"event": "fault", **facts})

    with Emulator(Path(image.path), name) as emulator:
        greet(emulator, SLOTS, expected(wired.system, name, bytes.fromhex(image.token)))
        faults = ImageFaults(emulator, [e for e in events if e.target == name], note)
        yield ImageSlots(wired, emulator, faults).step
