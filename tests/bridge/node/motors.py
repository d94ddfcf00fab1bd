"""Motors on the buses of a live node: drives in C as their vendors describe them, no plant."""

from __future__ import annotations

import ctypes as c
import threading
import time

from bridge.native import vendor
from bridge.native.frame import Frame
from bridge.native.vendor import VendorFault, VendorKind, VendorStruct
from cosim.base.clock import monotonic_ns

MS = 1_000_000
KINDS = {
    "damiao": VendorKind.DAMIAO,
    "odrive": VendorKind.ODRIVE,
    "cia402": VendorKind.CIA402,
}


class Motors:
    """The drives that a node (`gate`, of tests.bridge.gates) commands; `sent`: its frames, by bus.

    They stand still at `q` rad. Use as a context manager inside of the gate's.
    """

    def __init__(self, gate, host=0, q=0.3, timeout=0.05):
        self.gate, self.q, self.ended = gate, q, threading.Event()
        self.sent = {bus: [] for bus in gate.rings}
        self.motors = [
            (drive, self._made(drive, host, timeout)) for drive in gate.wired.commanded.drives
        ]
        self._lock = threading.Lock()

    def _made(self, drive, host, timeout):
        name = drive.profile.protocol.rpartition("/")[2].removesuffix(".toml")
        own = VendorStruct(
            kind=KINDS[name], node=drive.node, host=host, timeout_ns=round(timeout * 1e9),
            cycle_ns=MS, boot_ns=20 * MS, answer_ns=MS // 10, jitter_ns=MS // 10, beat_ns=100 * MS,
            p_max=12.5, v_max=30.0, t_max=10.0, rated=1.0, seed=drive.node,
        )  # fmt: skip
        vendor.functions().vendor_init(c.byref(own), monotonic_ns())
        return own

    def __getitem__(self, index):
        return self.motors[index][1]

    def fault(self, index, kind: VendorFault, code=0):
        """A fault of a drive, now."""
        with self._lock:
            own = self.motors[index][1]
            vendor.functions().vendor_fault(c.byref(own), kind, code, monotonic_ns())

    def __enter__(self):
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self.ended.set()
        self._thread.join()

    def _serve(self):
        while not self.ended.is_set():
            with self._lock:
                self._turn()
            time.sleep(0.0005)

    def _turn(self):
        frame, call = Frame(), vendor.functions()
        for bus, (_, tx) in self.gate.rings.items():
            while tx.get(frame):
                kept = Frame.from_buffer_copy(frame)
                self.sent[bus].append(kept)
                for drive, own in self.motors:
                    if drive.bus == bus:
                        call.vendor_take(c.byref(own), c.byref(kept), kept.t_ns)
        for drive, own in self.motors:
            now = monotonic_ns()
            call.vendor_step(c.byref(own), now)
            for part, told in enumerate(drive.profile.feedback[: vendor.PARTS]):
                values = {"q": self.q, "dq": 0.0, "tau": 0.0}
                codec = drive.profile.codec(told, drive.node)
                ports = [p for p in ("tau", "q", "dq") for _ in getattr(told, p)]
                data = codec.encode([values[p] for p in ports])
                said = Frame.of(codec.layout.identifier, data, drive.profile.format)
                call.vendor_say(c.byref(own), part, c.byref(said), now)
            while call.vendor_next(c.byref(own), now, c.byref(frame)):
                answer = Frame.from_buffer_copy(frame)
                answer.t_ns = monotonic_ns()
                self.gate.rings[drive.bus][0].put(answer)
