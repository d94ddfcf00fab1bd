"""A double of an image: a program that speaks records, and computes slots as the twin does.

``double.py JSON``: scenario, deploy, settings, node, folder, token (hexadecimal), and `lies`, what
it does wrong. Standard input and output are its serial line.
"""

from __future__ import annotations

import ctypes as c
import json
import os
import stat
import sys
from pathlib import Path

from bridge.deployment.system import load_system
from bridge.firmware import records
from bridge.firmware.records import SLOTS, Kind, Reader, SlotDone, pack, pack_done, pack_frame
from bridge.firmware.slots import expected
from bridge.native import node as native
from bridge.native.frame import Frame
from bridge.replay.twin import memory_buses
from bridge.wiring.beginning import begin_active
from bridge.wiring.wiring import WiredNode
from cosim.base.copies import replace

ROOT = Path(__file__).resolve().parents[3]


def written(folder, scenario, deploy, settings, node, token=bytes(16), **lies):
    """The double of a node as a program in `folder`."""
    said = {
        "scenario": str(scenario), "deploy": str(deploy), "settings": list(settings), "node": node,
        "folder": str(folder), "token": token.hex(), "lies": lies,
    }  # fmt: skip
    path = folder / f"{node}.image"
    start = (
        f"#!/bin/sh\nexec env PYTHONPATH={ROOT} {sys.executable} -m tests.bridge.firmware.double"
    )
    path.write_text(f"{start} '{json.dumps(said)}'\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


class Double:
    """The image: `lies` may have `at` (a slot), and there `does` of :meth:`slot`."""

    def __init__(self, said):
        system = load_system(Path(said["scenario"]), said["deploy"], said["settings"])
        node, folder = said["node"], Path(said["folder"])
        hello = said["lies"].get("hello", {})
        if "token" in hello:
            hello["token"] = bytes.fromhex(hello["token"])
        self.hello = replace(expected(system, node, bytes.fromhex(said["token"])), **hello)
        journal = folder / f"double-{os.getpid()}.journal"
        self.wired = WiredNode(system, node, memory_buses(system, node), journal, native.SIMULATED)
        self.lies, self.asked, self.begun = said["lies"], False, False

    def answer(self, kind, payload):
        if kind is Kind.MODE and not self.begun:
            assert payload == SLOTS
            self.say(pack(Kind.HELLO, self.hello.payload()))
            self.asked = True
        elif not self.asked:
            return
        elif kind is Kind.FRAME:
            frame = records.unpack_frame(payload)
            self.wired.buses[frame.bus].rx.put(frame)
        elif kind is Kind.TELL:
            native.functions().node_tell(c.byref(self.wired.struct), payload[0])
        elif kind is Kind.SLOT:
            self.begun = True
            self.slot(*records.unpack_slot(payload))

    def slot(self, slot, limit_ns):
        wired, s = self.wired, self.wired.struct
        assert (slot, limit_ns) == (s.slot, slot * s.h_ns + s.phase_ns)
        heard = len(wired.heard)
        result = int(native.functions().node_step(c.byref(s)))
        frame = Frame()
        for number, bus in enumerate(wired.buses):
            while bus.tx.get(frame):
                frame.bus = number
                self.say(pack_frame(frame))
        for row in wired.heard.rows[heard:]:
            self.say(pack(Kind.SAMPLE, row.tobytes()))
        row = wired.journal.rows[-1].copy()
        lie = self.lies.get("does", "") if self.lies.get("at") == slot else ""
        if lie == "other":
            row["signals"][0] += 1e-12
        if lie == "short":
            self.say(pack(Kind.ROW, row.tobytes()[8:]))
        elif lie != "missing":
            self.say(pack(Kind.ROW, row.tobytes()))
        if lie == "text":
            self.say(b"printf")
        if lie == "fails":
            self.say(pack(Kind.LOG, b"no solution"))
        if lie == "exit":
            sys.exit("assertion failed")
        if lie != "mute":
            self.say(pack_done(SlotDone(slot + (lie == "ahead"), result or 7 * (lie == "fails"))))

    def say(self, record):
        os.write(1, record)


def main():
    double, reader = Double(json.loads(sys.argv[1])), Reader()
    with double.wired:
        begin_active(double.wired)
        while data := os.read(0, 1 << 16):
            for record in reader.feed(data):
                double.answer(*record)


if __name__ == "__main__":
    main()
