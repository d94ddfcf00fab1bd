"""The files that are shipped, other readers of them, and what is wrong with others."""

from __future__ import annotations

import importlib.util
import io
import logging
import re

import cantools
import numpy as np
import pytest

from bridge.can import dbc, link_dbc
from bridge.can.codec import Codec
from bridge.can.layout import LayoutError
from bridge.native.frame import Flags
from bridge.native.message import Decoded, E2EProfile
from cosim.base.copies import replace
from tests.bridge.can.layouts import CONFIGS, LINKS, layout, layouts

NODES = range(1, 9)


def test_files_are_as_generated():
    spec = importlib.util.spec_from_file_location("generate", CONFIGS / "generate.py")
    assert spec is not None and spec.loader is not None
    generate = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generate)
    for name, text in generate.files().items():
        assert (CONFIGS / name).read_text() == text, f"{name}: run configs/can/generate.py"


@pytest.mark.parametrize("file", LINKS)
def test_identifiers_stay_out_of_what_canopen_takes(file):
    """CiA 301 predefined set of nodes 1 to 31: PDOs, SDOs, heartbeats keep their places."""
    taken = {base + n for base in range(0x180, 0x680, 0x80) for n in range(1, 32)}
    for found in layouts(file):
        assert found.identifier < 0x780 and found.identifier not in taken
        assert not found.flags & Flags.EXTENDED
    names = {found.name: found.identifier for found in layouts(file)}
    assert (names["NMT"], names["ESTOP"], names["SYNC"]) == (0, 1, 0x80)
    assert [names[f"HEARTBEAT_{n}"] - 0x700 for n in NODES] == list(NODES)
    assert [names[f"EMCY_{n}"] - 0x80 for n in NODES] == list(NODES)


@pytest.mark.parametrize(("file", "joints"), [("link_fd.dbc", 7), ("link_fd2.dbc", 2)])
def test_fd_frames(file, joints):
    link, state = layout(file, "LINK_3"), layout(file, "STATE_3")
    assert link.length == state.length == 8 + 8 * joints
    names = [f"{port}{i + 1}" for port in ("tau", "xi") for i in range(joints)]
    assert [s.name for s in link.signals] == names
    assert link.flags == Flags.FD | Flags.BRS and link.profile is E2EProfile.P05
    assert {s.unit for s in state.signals} == {"rad", "rad/s"}
    assert {s.scale for s in link.signals} == {2.0**-20}
    assert link.period == 0.001 and layout(file, "HEARTBEAT_1").flags == 0


@pytest.mark.parametrize(("file", "joints"), [("link.dbc", 7), ("link2.dbc", 2)])
def test_classic_frames(file, joints):
    for port in ("tau", "xi", "q", "dq"):
        own = [x for x in layouts(file) if x.name.endswith("_5") and x.period == 0.005]
        signals = [s for x in own for s in x.signals if s.name.rstrip("1234567") == port]
        assert [s.name for s in signals] == [f"{port}{i + 1}" for i in range(joints)]
        assert all(x.length == 8 and x.profile is E2EProfile.P02 for x in own)
        assert all(np.log2(s.scale) % 1 == 0 and s.invalid == -(2**15) for s in signals)


@pytest.mark.parametrize("file", LINKS)
def test_data_ids_tell_messages_apart(file):
    lists = [list(x.data_ids) for x in layouts(file) if x.profile is E2EProfile.P02]
    assert all(len(set(column)) == len(lists) for column in zip(*lists, strict=True))
    assert all(len(set(ids)) == 16 for ids in lists)
    numbers = [x.data_ids[:2] for x in layouts(file) if x.profile is E2EProfile.P05]
    assert len(set(numbers)) == len(numbers)


@pytest.mark.parametrize("file", [*LINKS, "drives.dbc"])
def test_canmatrix_reads_the_same(file):
    formats = pytest.importorskip("canmatrix.formats")
    logging.getLogger("canmatrix").setLevel(logging.ERROR)
    matrix = formats.loadp_flat(str(CONFIGS / file))
    frames = {frame.name: frame for frame in matrix.frames}
    assert not matrix.load_errors
    for found in layouts(file):
        frame = frames[found.name]
        assert (frame.arbitration_id.id, frame.size) == (found.identifier, found.length)
        assert frame.is_fd == bool(found.flags & Flags.FD)
        for signal in found.signals:
            other = frame.signal_by_name(signal.name)
            assert float(other.factor) == signal.scale and other.size == signal.length
            assert other.is_float == (signal.kind == 2) and other.unit == signal.unit


def candump(found, data: bytes) -> str:
    """A line of candump (can-utils), as it was seen on a vcan."""
    if not found.flags & Flags.FD:
        return f"  vcan0  {found.identifier:03X}   [{len(data)}]  {data.hex(' ').upper()}"
    return f"  vcan0  {found.identifier:03X}  [{len(data):02d}]  {data.hex(' ').upper()}"


def test_candump_and_cantools_decode(monkeypatch, capsys):
    """What `candump vcan0 | cantools decode link_fd.dbc` shows."""
    fd, heart = layout("link_fd.dbc", "LINK_2"), layout("link_fd.dbc", "HEARTBEAT_2")
    values = np.arange(14) * 2.0**-3
    values[3] = np.nan
    lines = [
        candump(fd, Codec(fd).encode(values, status=2 + 8 + 128, t_us=123456)),
        candump(heart, Codec(heart, ["state", "armed", "reasons"]).encode([4, 0, 0x12], status=64)),
    ]
    monkeypatch.setattr("sys.argv", ["cantools", "decode", str(CONFIGS / "link_fd.dbc")])
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(lines)))
    cantools._main()
    shown = capsys.readouterr().out
    for expected in ("LINK_2(", "status: ACTIVE_ARMED_SIMULATED", "t_us: 123456 us",
                     "tau2: 0.125 N.m", "tau4: INVALID", "xi7: 1.625 rad/s", "HEARTBEAT_2(",
                     "state: FAULT", "reasons: 18", "status: STALE"):  # fmt: skip
        assert expected in shown, shown


HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: A\n'
SIGNALS = ' SG_ crc : 0|8@1+ (1,0) [0|0] "" A\n SG_ counter : 8|4@1+ (1,0) [0|0] "" A\n'
ATTRIBUTES = """
BA_DEF_ BO_ "E2EProfile" ENUM "None","P02","P05","P11";
BA_DEF_ BO_ "E2EDataId" STRING ;
BA_DEF_DEF_ "E2EProfile" "None";
BA_DEF_DEF_ "E2EDataId" "";
"""


def bo(identifier: int, name: str, body: str = SIGNALS) -> str:
    return f"BO_ {identifier} {name}: 8 A\n{body}\n"


def ba(identifier: int, profile: int, ids: str | None) -> str:
    text = f'BA_ "E2EProfile" BO_ {identifier} {profile};\n'
    return text + (f'BA_ "E2EDataId" BO_ {identifier} "{ids}";\n' if ids is not None else "")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("nonsense", "not a DBC file that can be used"),
        (bo(5, "X") + bo(5, "Y"), "X and Y have the same identifier 0x5"),
        (bo(5, "X") + bo(6, "X"), "X and X have the same name"),
        (bo(5, "X") + ATTRIBUTES + ba(5, 1, None), "X is protected by P02: E2EDataId ''; exp"),
        (bo(5, "X") + ATTRIBUTES + ba(5, 1, "12G4" * 8), "E2EDataId '12G4.*expected 32 hexa"),
        (bo(5, "X") + ATTRIBUTES + ba(5, 2, "1234"), "no signal crc at bit 0 of 16 bits"),
        (bo(5, "X", "") + ATTRIBUTES + ba(5, 1, "00" * 16), "no signal crc at bit 0 of 8 bits"),
        (bo(5, "X") + ATTRIBUTES + ba(5, 3, "00"), "E2EProfile 'P11'; expected one of None, P02"),
        (bo(5, "X") + bo(6, "Y") + ATTRIBUTES + ba(5, 1, "01" * 16) + ba(6, 1, "01" * 16),
         "X and Y have the same E2EDataId"),
        (bo(5, "X", ' SG_ a : 60|8@1+ (1,0) [0|0] "" A\n'), "not a DBC file that can be used"),
    ],
)  # fmt: skip
def test_files_that_are_refused(text, complaint, tmp_path, caplog):
    path = tmp_path / "wrong.dbc"
    path.write_text(HEAD + text if text != "nonsense" else text)
    with pytest.raises(LayoutError, match=complaint) as error:
        dbc.load(path)
    assert str(path) in str(error.value)


def test_a_file_that_is_missing(tmp_path):
    with pytest.raises(LayoutError, match=r"none\.dbc"):
        dbc.load(tmp_path / "none.dbc")


def test_a_foreign_file_needs_no_attribute(tmp_path):
    path = tmp_path / "own.dbc"
    mux = ' SG_ m M : 0|8@1+ (1,0) [0|0] "" A\n SG_ a m0 : 8|8@1- (1,0) [0|0] "" A\n'
    path.write_text(HEAD + bo(5, "X") + bo(2147483654, "E") + bo(7, "M", mux))
    one, extended, multiplexed = dbc.load(path)
    assert one.profile is E2EProfile.NONE and [s.name for s in one.signals] == ["crc", "counter"]
    assert extended.flags == Flags.EXTENDED and extended.identifier == 6
    assert [s.name for s in multiplexed.signals] == ["m"]  # of multiplexed signals, the selector
    assert Codec(one).encode([7, 3]).hex() == "0703000000000000"


@pytest.mark.parametrize("behind", [False, True])
def test_a_multiplexed_signal_is_refused_by_its_name(behind, tmp_path):
    """Also where the selector stands behind its signals, or is one of several (extended)."""
    path = tmp_path / "mux.dbc"
    lines = [' SG_ m M : 0|8@1+ (1,0) [0|0] "" A\n', ' SG_ a m0 : 8|8@1- (1,0) [0|0] "" A\n']
    path.write_text(HEAD + bo(7, "M", "".join(lines[::-1] if behind else lines)))
    (layout,) = dbc.load(path)
    with pytest.raises(LayoutError, match=r"mux\.dbc: message M: signal a is multiplexed"):
        Codec(layout, ["a"])
    with pytest.raises(LayoutError, match="b"):
        Codec(layout, ["b"])


def test_what_drives_make_of_zero():
    """An MIT drive's own code of 0 N.m is 2047: it truncates. We round: 2048, half an LSB up."""
    codec = Codec(layout("drives.dbc", "MIT_COMMAND_1"), ["tau1"])
    data = codec.encode([0.0])
    assert data.hex() == "8000800000000800"
    assert int((0.0 + 54.0) / 108.0 * 4095) == 2047
    assert codec.decode(data)[1][0] == pytest.approx(54 / 4095)
    torque = Codec(layout("drives.dbc", "ODRIVE_SET_INPUT_TORQUE_1"))
    assert torque.encode([-1.5]).hex() == "0000c0bf00000000"


@pytest.mark.parametrize("joints", range(1, 8))
def test_frames_for_any_number_of_joints_have_a_length_of_can_fd(joints, tmp_path):
    path = tmp_path / "arm.dbc"
    messages = link_dbc.common((1, 2)) + link_dbc.fd(joints, (1, 2))
    path.write_text(link_dbc.text(messages, "CAN FD", "An arm.", (1, 2)), encoding="ascii")
    found = {layout.name: layout for layout in dbc.load(path)}
    values = np.arange(2 * joints) / 8
    assert set(found) >= {"LINK_1", "LINK_2", "STATE_1", "STATE_2"} and "LINK_3" not in found
    codec = Codec(found["LINK_2"])
    data = codec.encode(values, counter=1)
    assert len(data) in (16, 24, 32, 48, 64)
    result, again, _ = codec.decode(data)
    assert result is Decoded.OK and again.tolist() == values.tolist()


def test_a_length_that_no_frame_of_can_fd_has_is_refused():
    """Such a frame grows on its way, and its receiver would count it as too long."""
    found = replace(layout("link_fd2.dbc", "LINK_1"), length=25)
    with pytest.raises(LayoutError, match=r"LINK_1 has 25 bytes; expected 0 to 8, 12, .* or 64"):
        Codec(found)


@pytest.mark.parametrize(
    ("sizes", "found"),
    [
        (("2147483648", "0|8"), "BO_ 1 A: 2147483648"),
        (("8", "0|2147483648"), "SG_ x : 0|2147483648"),
        (("8", "99999999999999999999|8"), "99999999999999999999"),
        (("-8", "0|8"), "BO_ 1 A: -8"),
        (("8", "-1|8"), "SG_ x : -1|8"),
    ],
)
def test_sizes_that_fill_the_memory_are_refused_at_once(sizes, found, tmp_path):
    """The reader behind makes a mask of as many bits."""
    path = tmp_path / "large.dbc"
    text = f'VERSION ""\nBU_: N\nBO_ 1 A: {sizes[0]} N\n SG_ x : {sizes[1]}@1+ (1,0) [0|0] "" N\n'
    path.write_text(text)
    with pytest.raises(LayoutError, match=re.escape(found)) as error:
        dbc.load(path)
    assert "expected 0 to" in str(error.value)


@pytest.mark.parametrize("time", ["-5", "1" + 400 * "0", '"soon"'])
def test_a_cycle_time_that_is_none_is_refused(time, tmp_path):
    path = tmp_path / "cycle.dbc"
    kind = "STRING " if time.startswith('"') else "INT 0 0"
    text = f'BA_DEF_ BO_ "GenMsgCycleTime" {kind};\nBA_DEF_DEF_ "GenMsgCycleTime" '
    text += '"";\n' if kind == "STRING " else "0;\n"
    path.write_text(HEAD + bo(5, "X") + text + f'BA_ "GenMsgCycleTime" BO_ 5 {time};\n')
    with pytest.raises(LayoutError, match=r"found the cycle time .*; expected ms above 0"):
        dbc.load(path)
