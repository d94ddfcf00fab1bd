"""A rehearsal on the wall clock in which an image is master_control; run in a network namespace.

``rehearsal_with_image.py FOLDER STOP ESTOP COMMAND...``: frames are copied between the groups of
udp_multicast that are the buses of configs/deploy/can.toml and the serial line of the image that
COMMAND starts (a path alone: a native one). ESTOP: the time after ACTIVE, s, of an emergency
stop from outside; 0: never. Prints, as JSON, the heartbeats of the image (state, armed,
reasons), how many frames it has sent by identifier, and its lines.
"""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import can

from bridge.can.multicast import open_group
from bridge.can.threaded import to_frame, to_message
from bridge.deployment.system import load_system
from bridge.native.frame import Frame
from tests.bridge.export.records import WALL, Host, Pipes, Serial, frame_record, image
from tests.bridge.rehearsing import CALM, COSIM, SCENARIO

GROUPS = ("239.74.163.2", "239.74.163.3")
NODE = "master_control"
#: Few frames: QEMU takes some 10 kB/s over the serial line of a Cortex-M beside a busy machine.
PERIODS = (
    *(f'components.{node}.period="20 ms"' for node in (NODE, "slave_control")),
    *(f'deploy.messages.STATE_{n}.period="20 ms"' for n in (1, 3)),
)
SLOW = (*CALM, 'deploy.sync=""', *PERIODS)
HEARTBEAT, ESTOP, EPOCH, ACTIVE = 0x702, 0x001, 0x002, 2
START = can.Message(arbitration_id=0, data=bytes([1, 2]), is_extended_id=False)


def rehearse(folder: Path, stop: str) -> subprocess.Popen[bytes]:
    """The other nodes."""
    words = ["rehearse", str(SCENARIO), "-i", "udp_multicast", "--no-twin", "--no-plot"]
    words += ["--nodes", "master,slave,slave_control", "--out", str(folder / "run")]
    words += [word for setting in (*SLOW, f"run.stop={stop}") for word in ("--set", setting)]
    return subprocess.Popen([*COSIM, *words], stdout=(folder / "said.txt").open("wb"))


class Copies:
    """Frames between the buses and the image."""

    def __init__(self, host: Host, buses: list[Any], estop: float) -> None:
        self.host, self.buses, self.estop = host, buses, estop
        system = load_system(SCENARIO, "can", SLOW)
        self.accepts = [system.accepts(NODE, bus) for bus in system.buses_of(NODE)]
        self.beats: list[tuple[int, int, int]] = []
        self.sent: Counter[int] = Counter()
        self.lines: list[str] = []
        self._writing = threading.Lock()

    def to_image(self, number: int) -> None:
        """All that comes on a bus."""
        while True:
            message = self.buses[number].recv(1.0)
            if message is not None:
                self._give(number, message)
                if message.arbitration_id == EPOCH and message.data[2] >> 6 | message.data[3] & 63:
                    self._give(number, START)  # the others are started by their supervisor

    def _give(self, number: int, message: can.Message) -> None:
        f = to_frame(message, 0)
        if not any(accept.takes(f) for accept in self.accepts[number]):
            return
        with self._writing:
            self.host.say(frame_record(number, f.flags, f.id, 0, f.payload))

    def from_image(self) -> None:
        """All that it sends, to its end."""
        while True:
            kind, payload = self.host.next()
            if kind == "l":
                self.lines.append(payload.decode())
                if self.lines[-1].startswith("ended"):
                    return
            if kind == "f":
                self._send(payload)

    def _send(self, payload: bytes) -> None:
        bus, flags, _, _, identifier, _ = struct.unpack_from("<BBBBIq", payload)
        frame = Frame.of(identifier, payload[16:], flags)
        self.buses[bus].send(to_message(frame))
        self.sent[identifier] += 1
        if identifier != HEARTBEAT:
            return
        state, reasons = payload[16 + 2] & 7, int.from_bytes(payload[16 + 4 : 16 + 8], "little")
        self.beats.append((state, payload[16 + 2] >> 3 & 1, reasons))
        if self.estop and state == ACTIVE:
            stopping = can.Message(arbitration_id=ESTOP, data=bytes(5), is_extended_id=False)
            threading.Timer(self.estop, self._stop, (stopping,)).start()
            self.estop = 0.0

    def _stop(self, message: can.Message) -> None:
        """To the others and to the image, which does not hear what this process sends."""
        for bus in self.buses:
            bus.send(message)
        self._give(0, message)


def main(folder: Path, stop: str, estop: float, command: list[str]) -> None:
    buses = [open_group(group) for group in GROUPS]
    line = Pipes(Path(command[0])) if len(command) == 1 else Serial(command, folder)
    with image(line) as host:
        copies = Copies(host, buses, estop)
        host.hello(WALL)
        for number in range(len(buses)):
            threading.Thread(target=copies.to_image, args=(number,), daemon=True).start()
        others = rehearse(folder, stop)
        copies.from_image()
        others.wait()
        time.sleep(0.1)
    print(json.dumps({"beats": copies.beats, "sent": copies.sent, "lines": copies.lines}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], float(sys.argv[3]), sys.argv[4:])
