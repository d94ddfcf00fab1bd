"""Drives of three vendors in C against the state diagrams of their documents."""

from __future__ import annotations

import struct
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.native.vendor import VendorFault as Fault
from bridge.native.vendor import VendorKind as Kind
from tests.bridge.drives import vendor_oracle as oracle
from tests.bridge.drives.vendors import HALF, MS, Drive, N, mit, rpdo

SPECIAL = {"enable": 0xFC, "disable": 0xFD, "clear": 0xFB}
AXIS = {"enable": (7, b"\x08\0\0\0"), "disable": (7, b"\x01\0\0\0"), "clear": (0x18, b"\0")}
WORDS = (0x00, 0x02, 0x06, 0x07, 0x0F, 0x0B, 0x80, 0x86, 0x8F)


def acted(drive: Drive, model: Any, action: str) -> None:
    """The same to both."""
    if action == "trip":
        code = {Kind.DAMIAO: 0xA, Kind.ODRIVE: 0x400, Kind.CIA402: 0x2310}[drive.kind]
        drive.fault(Fault.TRIP, code)
        if not model.booting:
            model.fail("current")
        return
    if action == "reboot":
        drive.fault(Fault.REBOOT)
        model.reboot()
        return
    if drive.kind == Kind.DAMIAO:
        drive.hears(N, b"\xff" * 7 + bytes([SPECIAL[action]]) if action in SPECIAL else mit(1.0))
    elif drive.kind == Kind.ODRIVE:
        command, data = AXIS.get(action, (0x0E, struct.pack("<f", 1.0)))
        drive.hears(N << 5 | command, data)
    if not model.booting:
        getattr(model, action)()


ACTIONS = st.sampled_from(
    ["enable", "enable", "disable", "clear", "torque", "torque", "torque", "trip", "reboot"]
)
#: What happens, and how many ticks later the next does.
SCRIPTS = st.lists(st.tuples(ACTIONS, st.integers(1, 45)), max_size=15)


@settings(max_examples=50)
@given(script=SCRIPTS)
def test_a_damiao_drive_is_where_its_documents_say(script: list[tuple[str, int]]) -> None:
    drive, model = Drive(Kind.DAMIAO), oracle.Damiao()
    for action, ticks in script:
        acted(drive, model, action)
        assert len(drive.says()) == model.answers
        model.answers = 0
        for _ in range(ticks):
            model.tick()
            drive.at(model.now * HALF)
            assert bool(drive.v.network) == (not model.booting)
            assert (drive.v.state if drive.v.network else 0) == model.nibble()
            assert bool(drive.v.acts) == (model.state == "on")


@settings(max_examples=50)
@given(script=SCRIPTS)
def test_an_odrive_is_where_its_documents_say(script: list[tuple[str, int]]) -> None:
    drive, model = Drive(Kind.ODRIVE, beat_ns=HALF), oracle.ODrive()
    for action, ticks in script:
        acted(drive, model, action)
        for _ in range(ticks):
            model.tick()
            drive.at(model.now * HALF)
            beats = [struct.unpack("<IBBxx", s.data) for s in drive.sent()]
            assert not (beats and model.booting)
            if beats and model.boots == -1 and drive.t > drive.v.booted_ns:
                assert beats[-1] == model.words()


CIA_SCRIPTS = st.lists(
    st.tuples(
        st.one_of(
            st.sampled_from(WORDS),
            st.sampled_from(["beat", "beat", "sync", "start", "trip", "reboot", "climb", "climb"]),
        ),
        st.integers(1, 30),
    ),
    max_size=15,
)


@settings(max_examples=80)
@given(script=CIA_SCRIPTS)
def test_a_cia_402_drive_is_where_the_standard_says(script: list[tuple[Any, int]]) -> None:
    drive, model = Drive(Kind.CIA402), oracle.CiA402()
    model.begin()
    for action, ticks in [one for pair in script for one in climbing(*pair)]:
        cia_acted(drive, model, action)
        feedback = drive.says()
        for said in (s for s in feedback if s.id == 0x180 + N):
            mask, bits = oracle.STATUS[model.state]
            assert struct.unpack("<H", said.data[:2])[0] & mask == bits
            model.answers -= 1
        assert model.answers == 0
        for _ in range(ticks):
            model.tick()
            drive.at(model.now * HALF)
            if not model.booting:
                assert list(oracle.STATUS)[drive.v.state - 1] == model.state
                assert bool(drive.v.acts) == (
                    model.state == "on" and model.nmt == "operational"
                )  # fmt: skip


def climbing(action: Any, ticks: int) -> list[tuple[Any, int]]:
    """`climb`: all that enables a drive, so that scripts get there."""
    if action != "climb":
        return [(action, ticks)]
    return [("start", 1), ("beat", 1), *((word, 2) for word in (0x06, 0x07)), (0x0F, ticks)]


def cia_acted(drive: Drive, model: oracle.CiA402, action: Any) -> None:
    if action in ("trip", "reboot"):
        acted(drive, model, action)
        return
    frames = {"beat": (0x702, b"\x05"), "sync": (0x80, b""), "start": (0, bytes([1, N]))}
    if action in frames:
        drive.hears(*frames[action])
    else:
        drive.hears(0x200 + N, rpdo(action))
    if model.booting:
        return
    if action in frames:
        getattr(model, action)()
    else:
        model.control(action)


@settings(max_examples=25)
@given(script=SCRIPTS, kind=st.sampled_from([Kind.DAMIAO, Kind.ODRIVE]), often=st.integers(1, 7))
def test_it_does_not_depend_on_how_often_it_is_stepped(
    script: list[tuple[str, int]], kind: Kind, often: int
) -> None:
    """Nor what it says, with answers that take their time."""
    said = []
    for parts in (1, often):
        drive, model = Drive(kind, answer_ns=MS // 3, jitter_ns=MS, seed=4), oracle.ODrive()
        said.append([])
        for action, ticks in script:
            acted(drive, model, action)
            said[-1] += drive.says()
            begin = drive.t
            for k in range(parts):
                drive.at(begin + ticks * HALF * (k + 1) // parts)
            said[-1] += drive.sent()
        said[-1].append((drive.v.state, drive.v.error, drive.v.acts, drive.v.trips))
    assert said[0] == said[1]
