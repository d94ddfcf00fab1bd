"""A node whose slots an image computes, one at a time: what it has received in, a row out.

The node of this process takes the frames and commands that the image takes, and computes the same
slots: the counters of its report are from there. Everything that counts is the image's: the rows of
the journals, and the frames that are sent. So a replay compares the image with this host.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Iterator
from typing import final

from bridge.deployment.system import System
from bridge.firmware.emulator import Emulator, Patience
from bridge.firmware.image_faults import ImageFaults
from bridge.firmware.records import (
    SLOTS,
    VERSION,
    FirmwareError,
    Hello,
    Kind,
    Reader,
    SlotDone,
    pack,
    pack_frame,
    pack_slot,
    unpack_done,
    unpack_frame,
)
from bridge.native import node as native
from bridge.native.frame import Frame
from bridge.native.journal import Journal, JournalStruct
from bridge.wiring.wiring import WiredNode, heard_dtype, row_dtype
from cosim.base.errors import ScenarioError

#: Result of a run of slots when the image has failed; a node itself never returns it.
FAILED = -20
#: Looks without an answer until an image is asked once more for its hello.
AGAIN = 20
#: The result of an image that was asked for another slot than its next one.
OTHER_SLOT = -1
_EXPORT = "export the node again: cosim export SCENARIO --deploy NAME --node {} --firmware"


def expected(system: System, node: str, token: bytes) -> Hello:
    """The hello of an image that was made from this deployment."""
    plan, d = system.nodes[node], system.deployment
    spec = d.nodes[node]
    return Hello(
        version=VERSION,
        number=spec.number,
        row=row_dtype(plan).itemsize,
        h_ns=round(plan.h * 1e9),
        phase_ns=round(d.seconds(spec.phase, "nodes", node, "phase") * 1e9),
        slots=plan.slots,
        token=token,
        name=node,
    )


def greet(emulator: Emulator, mode: bytes, wanted: Hello) -> None:
    """Set the mode of an image that has not started, and compare its hello with the one `wanted`.

    Raises ScenarioError if it is another image, FirmwareError if it does not answer.
    """
    image, reader = str(emulator.image), Reader()
    emulator.send(pack(Kind.MODE, mode))
    patience, silent = Patience(emulator), 0
    while True:
        data = emulator.receive()
        for kind, payload in reader.feed(data):
            if kind is Kind.HELLO:
                _compare(Hello.of(payload), wanted, image)
                return
        if data:
            continue
        if why := patience.look():
            raise FirmwareError(f"{emulator.name} {why}; expected a hello")
        silent += 1
        if silent % AGAIN == 0:  # a serial line that is being set up may lose bytes
            emulator.send(pack(Kind.MODE, mode))


def _compare(found: Hello, wanted: Hello, image: str) -> None:
    """Raise ScenarioError if an image is not the one that is wanted."""
    if found.version != wanted.version:
        text = f"found records of version {found.version}, expected {wanted.version}; "
    elif (found.name, found.number) != (wanted.name, wanted.number):
        text = f"found node {found.name} (number {found.number}), expected "
        text += f"{wanted.name} (number {wanted.number}); "
    elif differing := [
        f"{what} {getattr(found, field)} instead of {getattr(wanted, field)}"
        for field, what in (("row", "rows of"), ("h_ns", "a slot of"), ("phase_ns", "a phase of"))
        if getattr(found, field) != getattr(wanted, field)
    ]:
        text = f"found {', '.join(differing)} (bytes, ns) of another deployment; "
    elif found.slots != wanted.slots:
        text = f"found {found.slots} slots of another length of the run, expected {wanted.slots}; "
    elif found.token != wanted.token:
        text = f"found the tables {found.token.hex()} of another deployment or version, expected "
        text += f"{wanted.token.hex()}; "
    else:
        return
    raise ScenarioError(text + _EXPORT.format(wanted.name), image)


def check(system: System, node: str, emulator: Emulator, token: bytes) -> None:
    """Refuse an image that is not this node of this deployment: greet it, and let it end.

    Raises ScenarioError, FirmwareError.
    """
    with emulator:
        greet(emulator, SLOTS, expected(system, node, token))


@final
class ImageSlots:
    """The slots of a node, computed by the image in `emulator`, which has been greeted.

    `faults`: of the emulator. From now on the node in `wired` writes into memory of its own in
    place of the journals, which get what the image writes.
    """

    def __init__(
        self, wired: WiredNode, emulator: Emulator, faults: ImageFaults | None = None
    ) -> None:
        assert wired.heard is not None
        self._wired, self._emulator = wired, emulator
        self._journals = {Kind.ROW: wired.journal, Kind.SAMPLE: wired.heard}
        row, sample = row_dtype(wired.plan), heard_dtype(wired.system, wired.name)
        self._sizes = {Kind.ROW: row.itemsize, Kind.SAMPLE: sample.itemsize}
        self._begun = False  # it has computed a slot
        self._said = ""  # by the image, for people
        self._reader = Reader(max(*self._sizes.values(), 512))
        system, name = wired.system, wired.name
        self._accepts = [
            [accept.any_format() for accept in system.accepts(name, bus)]
            for bus in system.buses_of(name)
        ]
        self._faults = faults or ImageFaults(emulator)
        self._memory = (c.c_char * (c.sizeof(JournalStruct) + row.itemsize))()
        own = JournalStruct.from_buffer(self._memory)
        own.row_size, own.capacity, own.limit = row.itemsize, 1, 1
        self._own = own
        wired.struct.journal = c.pointer(own)
        wired.struct.heard = None

    def step(self) -> int:
        """The next slot: 0, or the result of the node in this process if that fails.

        Raises FirmwareError if the image does not compute it.
        """
        s = self._wired.struct
        frames = [list(self._received(bus)) for bus in range(s.n_buses)]
        request = b"".join(pack_frame(f, f.t_ns) for bus in frames for f in bus)
        request += b"".join(pack(Kind.TELL, bytes([command])) for command in self._told())
        self._faults.act(s.slot * s.h)
        self._emulator.send(request + pack_slot(s.slot, s.slot * s.h_ns + s.phase_ns))
        sent = self._answer(s.slot)
        result = self._follow()
        for frame in sent:
            if (tx := self._wired.buses[frame.bus].tx) is not None:
                tx.put(frame)
        return result

    def _received(self, bus: int) -> Iterator[Frame]:
        """The frames that wait at a bus, which stay there; those that its filters let pass."""
        rx, accepts = self._wired.buses[bus].rx, self._accepts[bus]
        assert rx is not None
        for _ in range(len(rx)):
            frame = Frame()
            rx.get(frame)
            frame.bus = bus
            rx.put(frame)
            if any(accept.takes(frame) for accept in accepts):
                yield frame

    def _told(self) -> Iterator[int]:
        """The commands of this slot, for the image and for the node of this process."""
        s = self._wired.struct
        told, s.told = int(s.told), 0
        while told:
            native.functions().node_tell(c.byref(s), told & 7)
            yield told & 7
            told >>= 3

    def _follow(self) -> int:
        """The same slot in this process; what it sends is dropped."""
        self._own.rows = 0
        result = int(native.functions().node_step(c.byref(self._wired.struct)))
        dropped = Frame()
        for bus in self._wired.buses:
            while bus.tx is not None and bus.tx.get(dropped):
                pass
        return result

    # ---- the answer --------------------------------------------------------------------------

    def _answer(self, slot: int) -> list[Frame]:
        """The frames that the image has sent in a slot; its rows are in the journals."""
        frames: list[Frame] = []
        rows = 0
        for kind, payload in self._records(slot):
            match kind:
                case Kind.FRAME:
                    frames.append(self._frame(payload, slot))
                case Kind.SAMPLE | Kind.ROW:
                    rows += kind is Kind.ROW
                    self._keep(kind, payload, slot)
                case Kind.LOG:
                    self._said = payload.decode(errors="replace")
                case Kind.HELLO if self._begun:  # before, it may have been asked several times
                    raise self._failure(slot, "has restarted")
                case Kind.DONE:
                    self._check_done(slot, unpack_done(payload), rows)
                    self._begun = True
                    return frames
        raise AssertionError

    def _check_done(self, slot: int, done: SlotDone, rows: int) -> None:
        """Raise FirmwareError for an answer that is not a whole one to the request of a slot."""
        if done.result == OTHER_SLOT:
            raise self._failure(slot, "has restarted")
        if done.slot != slot or rows != 1:
            text = f"has answered with slot {done.slot} and {rows} rows, expected one row"
            raise self._failure(slot, text)
        if done.dropped:
            text = f"had no room for {done.dropped} received samples"
            raise self._failure(slot, text)
        if done.result:
            said = f": {self._said}" if self._said else ""
            raise self._failure(slot, f"failed with result {done.result}{said}")

    def _records(self, slot: int) -> Iterator[tuple[Kind, bytes]]:
        """The records of the image as they come. Raises FirmwareError if no more can come."""
        patience, asked = Patience(self._emulator), False
        while True:
            try:
                data = self._faults.damage(self._emulator.receive())
            except FirmwareError as error:
                raise FirmwareError(f"{error} {self._at(slot)}") from None
            for record in self._reader.feed(data):
                self._check_damage(slot)
                yield record
            self._check_damage(slot)
            if data:
                continue
            if why := patience.look():
                raise self._failure(slot, why)
            if patience.doubtful and not asked:
                self._emulator.send(pack(Kind.MODE, SLOTS))
                asked = True

    def _check_damage(self, slot: int) -> None:
        if self._reader.damaged:
            text = f"has sent {self._reader.damaged} bytes that belong to no record"
            raise self._failure(slot, text)

    def _frame(self, payload: bytes, slot: int) -> Frame:
        frame = unpack_frame(payload)
        if frame.bus >= len(self._wired.buses):
            raise self._failure(slot, f"has sent a frame on bus {frame.bus}, which it has not")
        return frame

    def _keep(self, kind: Kind, payload: bytes, slot: int) -> None:
        if len(payload) != self._sizes[kind]:
            text = f"has sent a row of {len(payload)} bytes, expected {self._sizes[kind]}"
            raise self._failure(slot, text)
        journal: Journal = self._journals[kind]
        journal.append_bytes(payload)

    def _failure(self, slot: int, text: str) -> FirmwareError:
        return FirmwareError(f"{self._emulator.name} {text} {self._at(slot)}")

    def _at(self, slot: int) -> str:
        return f"in slot {slot} (t = {slot * self._wired.struct.h:.6g} s)"
