"""The text of DBC files for arms: commands, heartbeats, and messages of joints for each node.

docs/can.md says what the bytes mean; ``configs/can/generate.py`` writes the shipped files.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import Decimal
from itertools import chain

from cosim.bus.timing import padded

#: Numbers of nodes of the files that are shipped, and joints that a frame of CAN FD has room for.
NODES, MOST_JOINTS = range(1, 9), 7
STATES = ("UNCONFIGURED", "INACTIVE", "ACTIVE", "STOPPING", "FAULT", "FINISHED")
LIFE = dict(enumerate(STATES))
NIBBLE = ("ESTOP", "SATURATED", "STALE", "SIMULATED")
NMT = {1: "START", 2: "STOP", 128: "ARM", 129: "RESET"}
# Data ID lists of Profile 2: entry c of the message numbered i (1 to 255) is i ^ (the sum of STEPS
# over the bits of c), so two messages of a file differ in every entry. The steps are chosen so that
# counter, data ID and CRC together still are a code of distance 4 (docs/can.md): in an 8-byte frame
# any three wrong bits are seen, those of the counter too. With entries at random they are not.
STEPS = (0xF5, 0xC5, 0xA5, 0x65)
EPOCH_INDEX = 128  # heartbeats and the messages of joints have lower ones

HEAD = """VERSION ""

NS_ :

BS_:

BU_: {nodes}

"""
ATTRIBUTES = """
CM_ "{comment} Bytes: docs/can.md. Written by {by}.";
BA_DEF_ "BusType" STRING ;
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "GenMsgSendType" ENUM "Cyclic","NoMsgSendType";
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG","reserved","reserved","reserved","reserved","reserved","reserved","reserved","reserved","reserved","reserved","StandardCAN_FD","ExtendedCAN_FD";
BA_DEF_ BO_ "CANFD_BRS" ENUM "0","1";
BA_DEF_ BO_ "E2EProfile" ENUM "None","P02","P05";
BA_DEF_ BO_ "E2EDataId" STRING ;
BA_DEF_ SG_ "GenSigStartValue" FLOAT -2147483648 2147483647;
BA_DEF_ SG_ "InvalidRaw" INT -2147483648 2147483647;
BA_DEF_DEF_ "BusType" "CAN";
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "GenMsgSendType" "NoMsgSendType";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_DEF_DEF_ "CANFD_BRS" "0";
BA_DEF_DEF_ "E2EProfile" "None";
BA_DEF_DEF_ "E2EDataId" "";
BA_DEF_DEF_ "GenSigStartValue" 0;
BA_DEF_DEF_ "InvalidRaw" 0;
BA_ "BusType" "{bus}";
"""  # noqa: E501


class DbcMessage:
    """One message: its lines in the file, and those of its attributes and value tables."""

    def __init__(
        self, name: str, identifier: int, length: int, sender: str, period: int = 0
    ) -> None:
        self.identifier, self.length = identifier, length
        self.lines = [f"BO_ {identifier} {name}: {length} {sender}"]
        self.extra: list[str] = []
        if period:
            self.attribute("GenMsgCycleTime", period)
            self.attribute("GenMsgSendType", 0)

    def attribute(self, name: str, value: int | str) -> None:
        """Set an attribute of the message; an entry of an enumeration is its number."""
        shown = f'"{value}"' if isinstance(value, str) else value
        self.extra.append(f'BA_ "{name}" BO_ {self.identifier} {shown};')

    def unsigned(
        self,
        name: str,
        start: int,
        length: int,
        unit: str = "",
        *,
        scale: int = 1,
        high: int | None = None,
        table: Mapping[int, str] | None = None,
    ) -> None:
        """An unsigned number of `length` bits from bit `start` on; `table`: names of its values."""
        top = scale * (2**length - 1) if high is None else high
        self.lines.append(
            f' SG_ {name} : {start}|{length}@1+ ({scale},0) [0|{top}] "{unit}" Vector__XXX'
        )
        if table:
            self.table(name, table)

    def number(self, name: str, start: int, bits: int, exponent: int, unit: str) -> None:
        """A two's complement number with LSB 2^exponent; the most negative one is `invalid`."""
        lsb, top = Decimal(2) ** exponent, 2 ** (bits - 1) - 1
        limit = f"{lsb * top:f}"
        self.lines.append(
            f' SG_ {name} : {start}|{bits}@1- ({lsb:f},0) [-{limit}|{limit}] "{unit}" Vector__XXX'
        )
        self.table(name, {-top - 1: "INVALID"})
        signal = f"SG_ {self.identifier} {name}"
        self.extra.append(f'BA_ "GenSigStartValue" {signal} 0;')
        self.extra.append(f'BA_ "InvalidRaw" {signal} {-top - 1};')

    def table(self, name: str, table: Mapping[int, str]) -> None:
        """Names of raw values."""
        entries = " ".join(f'{raw} "{text}"' for raw, text in table.items())
        self.extra.append(f"VAL_ {self.identifier} {name} {entries} ;")

    def p02(self, index: int) -> None:
        """Byte 0 CRC8, byte 1 counter and the upper four bits of the status byte."""
        self.unsigned("crc", 0, 8)
        self.unsigned("counter", 8, 4)
        names = {
            raw: "_".join(n for i, n in enumerate(NIBBLE) if raw >> i & 1) or "NONE"
            for raw in range(16)
        }
        self.unsigned("status", 12, 4, scale=16, table=names)
        self.attribute("E2EProfile", 1)
        ids = []
        for c in range(16):
            ids.append(index)
            for bit, step in enumerate(STEPS):
                ids[c] ^= step * (c >> bit & 1)
        self.attribute("E2EDataId", "".join(f"{i:02X}" for i in ids))

    def p05(self) -> None:
        """Bytes 0-1 CRC16, 2 counter, 3 status, 4-7 time stamp in us."""
        self.unsigned("crc", 0, 16)
        self.unsigned("counter", 16, 8)
        names = {
            state + 8 * armed + 128 * simulated: "_".join(
                [LIFE[state]] + ["ARMED"] * armed + ["SIMULATED"] * simulated
            )
            for simulated in (0, 1)
            for armed in (0, 1)
            for state in LIFE
        }
        self.unsigned("status", 24, 8, table=names)
        self.unsigned("t_us", 32, 32, "us")
        self.attribute("E2EProfile", 2)
        self.attribute("E2EDataId", f"{0x1000 + self.identifier:04X}")
        self.attribute("VFrameFormat", 14)
        self.attribute("CANFD_BRS", 1)


def common(nodes: Sequence[int] = NODES) -> list[DbcMessage]:
    """Commands, SYNC, EPOCH, and emergency and heartbeat of `nodes`: the same in every file."""
    nmt = DbcMessage("NMT", 0x000, 2, "Vector__XXX")
    nmt.unsigned("command", 0, 8, table=NMT)
    nmt.unsigned("node", 8, 8, high=127)
    estop = DbcMessage("ESTOP", 0x001, 5, "Vector__XXX", 10)
    estop.unsigned("node", 0, 8, high=127)
    estop.unsigned("reasons", 8, 32)
    epoch = DbcMessage("EPOCH", 0x002, 8, "Vector__XXX")
    epoch.p02(EPOCH_INDEX)
    epoch.unsigned("run", 16, 6)
    epoch.unsigned("host", 22, 8)
    epoch.unsigned("kept", 30, 1)
    epoch.unsigned("origin", 31, 33, "us", scale=10)
    sync = DbcMessage("SYNC", 0x080, 1, "Vector__XXX", 5)
    sync.unsigned("counter", 0, 8, high=240)
    return [nmt, estop, epoch, sync, *chain.from_iterable((emcy(n), heartbeat(n)) for n in nodes)]


def emcy(n: int) -> DbcMessage:
    """The emergency message of CiA 301: code, register, five bytes of the manufacturer."""
    found = DbcMessage(f"EMCY_{n}", 0x080 + n, 8, f"N{n}")
    found.unsigned("code", 0, 16)
    found.unsigned("register", 16, 8)
    found.unsigned("reasons", 24, 32)
    found.unsigned("state", 56, 8, high=5, table=LIFE)
    return found


def heartbeat(n: int) -> DbcMessage:
    """The message on where the node is in its life, and why it stopped."""
    found = DbcMessage(f"HEARTBEAT_{n}", 0x700 + n, 8, f"N{n}", 50)
    found.p02(n)
    found.unsigned("state", 16, 3, high=5, table=LIFE)
    found.unsigned("armed", 19, 1)
    found.unsigned("boots", 20, 12)
    found.unsigned("reasons", 32, 32)
    return found


#: Ports of the classic files: name of the frame, signal, first identifier, exponent, unit.
CLASSIC = (
    ("TAU", "tau", 0x1A0, -8, "N.m"),
    ("XI", "xi", 0x2A0, -10, "rad/s"),
    ("POS", "q", 0x3A0, -12, "rad"),
    ("VEL", "dq", 0x4A0, -10, "rad/s"),
)


def classic(frames: Mapping[str, tuple[int, ...]], stamp: bool) -> list[DbcMessage]:
    """`frames`: suffix of the name -> the joints in it, at most three, or two and a time stamp."""
    found = []
    for port, (name, signal, base, exponent, unit) in enumerate(CLASSIC):
        for part, (suffix, joints) in enumerate(frames.items()):
            for n in NODES:
                new = DbcMessage(f"{name}{suffix}_{n}", base + 0x20 * part + n, 8, f"N{n}", 5)
                new.p02(len(NODES) * (1 + 3 * port + part) + n)
                for place, joint in enumerate(joints):
                    new.number(f"{signal}{joint}", 16 + 16 * place, 16, exponent, unit)
                if stamp:
                    new.unsigned("t_us", 48, 16, "us")
                found.append(new)
    return found


def fd(joints: int, nodes: Sequence[int] = NODES, slides: Sequence[bool] = ()) -> list[DbcMessage]:
    """LINK (tau, xi) and STATE (q, dq): 8 bytes of header and 8 a joint, at most MOST_JOINTS.

    `slides`: of each joint; () if all turn. What is left of a length that CAN FD has is not used.
    """
    found = []
    ports = (
        ("LINK", 0x3A0, ("tau", "N.m", "N"), ("xi", "rad/s", "m/s")),
        ("STATE", 0x4A0, ("q", "rad", "m"), ("dq", "rad/s", "m/s")),
    )
    for name, base, *halves in ports:
        for n in nodes:
            length = padded(8 + 8 * joints, fd=True)
            new = DbcMessage(f"{name}_{n}", base + n, length, f"N{n}", 1)
            new.p05()
            for half, (signal, turning, sliding) in enumerate(halves):
                for i in range(joints):
                    start = 64 + 32 * (half * joints + i)
                    unit = sliding if slides and slides[i] else turning
                    exponent = -16 if unit == "N" else -20
                    new.number(f"{signal}{i + 1}", start, 32, exponent, unit)
            found.append(new)
    return found


def servo(joints: int, nodes: Sequence[int] = NODES) -> list[DbcMessage]:
    """COMMAND (q_c, dq_c) to a robot that takes positions or velocities, and its STATUS (clamped).

    CAN FD, as :func:`fd`; a number of STATUS has 8 bits.
    """
    found = []
    for n in nodes:
        command = DbcMessage(f"COMMAND_{n}", 0x2A0 + n, padded(8 + 8 * joints, fd=True), f"N{n}", 4)
        status = DbcMessage(f"STATUS_{n}", 0x520 + n, padded(8 + joints, fd=True), f"N{n}", 4)
        for new in (command, status):
            new.p05()
        for half, (signal, unit) in enumerate((("q_c", "rad"), ("dq_c", "rad/s"))):
            for i in range(joints):
                command.number(f"{signal}{i + 1}", 64 + 32 * (half * joints + i), 32, -20, unit)
        for i in range(joints):
            status.number(f"clamped{i + 1}", 64 + 8 * i, 8, 0, "")
        found += [command, status]
    return found


def text(
    messages: Sequence[DbcMessage],
    bus: str,
    comment: str,
    nodes: Sequence[int] = NODES,
    by: str = "configs/can/generate.py",
) -> str:
    """The text of a DBC file for a `bus` ("CAN" or "CAN FD"); `by`: what writes it."""
    messages = sorted(messages, key=lambda m: m.identifier)
    parts = [HEAD.format(nodes=" ".join(f"N{n}" for n in nodes))]
    parts += ["\n".join(m.lines) + "\n\n" for m in messages]
    parts.append(ATTRIBUTES.format(bus=bus, comment=comment, by=by).lstrip("\n"))
    extra = [line for m in messages for line in m.extra]
    parts += [f"{line}\n" for line in extra if line.startswith("BA_")]
    parts += [f"{line}\n" for line in extra if line.startswith("VAL_")]
    return "".join(parts)
