"""can-utils, python-can and cantools as peers: they and we see the same frames."""

from __future__ import annotations

import re
import socket
import struct
import subprocess
import sys
from pathlib import Path

import can
import numpy as np
import pytest

from bridge.can.codec import Codec
from bridge.can.dbc import load
from tests.vcan.peers import (
    SO_RXQ_OVFL,
    Frame,
    call,
    dumped,
    listening,
    open_socket,
    pending,
    receive,
    send,
)

FILES = sorted((Path(__file__).parents[2] / "configs" / "can").glob("*.dbc"))
# The command `cantools`, without the seconds that the import of asammdf takes.
CANTOOLS = "import sys; sys.modules['asammdf'] = None; import cantools; cantools._main()"
FRAMES = [
    Frame(0x123, b""),
    Frame(0x7FF, bytes(range(8))),
    Frame(0x12345678, b"\xff" * 8, extended=True),
    Frame(0x3A1, bytes(range(64)), fd=True),
]


def test_candump_sees_a_plain_socket(vcan: tuple[str, str]) -> None:
    with listening(vcan[0], "candump", "-L", vcan[0]) as dump, open_socket(vcan[0], fd=True) as s:
        send(s, FRAMES)
        assert dumped(dump, 4) == FRAMES


def test_candump_sees_python_can(vcan: tuple[str, str]) -> None:
    with listening(vcan[0], "candump", "-L", vcan[0]) as dump:
        with can.Bus(interface="socketcan", channel=vcan[0], fd=True) as bus:
            for frame in FRAMES:
                bus.send(
                    can.Message(
                        arbitration_id=frame.identifier,
                        data=frame.data,
                        is_extended_id=frame.extended,
                        is_fd=frame.fd,
                    )
                )
        assert dumped(dump, 4) == FRAMES


def test_cansend(vcan: tuple[str, str]) -> None:
    with open_socket(vcan[0], fd=True) as sock:
        call("cansend", vcan[0], "12345678#DEADBEEF")
        call("cansend", vcan[0], "3A1##1" + "11" * 12)
        assert receive(sock, 2) == [
            Frame(0x12345678, b"\xde\xad\xbe\xef", extended=True),
            Frame(0x3A1, b"\x11" * 12, fd=True),
        ]


def test_a_flood_arrives_whole_where_there_is_room(vcan: tuple[str, str]) -> None:
    n = 5000
    with open_socket(vcan[0]) as sock:
        call("cangen", vcan[0], "-g", "0", "-I", "123", "-L", "8", "-D", "i", "-n", str(n))
        counted = [int.from_bytes(frame.data, "little") for frame in pending(sock)]
    assert len(counted) == n
    assert counted == list(range(counted[0], counted[0] + n))


def test_a_flood_is_cut_silently_where_there_is_not_but_counted(vcan: tuple[str, str]) -> None:
    n = 5000
    with open_socket(vcan[0], receive_buffer=4096) as sock, open_socket(vcan[0]) as other:
        sock.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        call("cangen", vcan[0], "-g", "0", "-I", "123", "-L", "8", "-D", "i", "-n", str(n))
        got = len(pending(sock))
        assert 0 < got < n
        send(other, FRAMES[:1])
        _, extra, _, _ = sock.recvmsg(16, 64)
        assert struct.unpack("I", extra[0][2]) == (n - got,)


def _numbers(line: str) -> dict[str, float]:
    """``name: value unit`` of a line that cantools decoded."""
    inside = line.partition("::")[2].partition("(")[2]
    found = re.findall(r"(\w+): (-?[\d.]+(?:e[+-]?\d+)?)", inside)
    return {name: float(value) for name, value in found}


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_candump_and_cantools_read_what_we_encode(vcan: tuple[str, str], file: Path) -> None:
    codecs = [Codec(layout) for layout in load(file)]
    random = np.random.default_rng(1)
    values = []
    for codec in codecs:
        ends = [sorted(s.scale * r + s.offset for r in s.raw_range) for s in codec.signals]
        values.append([random.uniform(max(low, -1e6), min(high, 1e6)) for low, high in ends])
    with listening(vcan[0], "candump", "-n", str(len(codecs)), vcan[0]) as dump:
        with open_socket(vcan[0], fd=True) as sock:
            for codec, vector in zip(codecs, values, strict=True):
                data = codec.encode(vector, status=1, t_us=77, counter=5)
                layout = codec.layout
                fd, extended = bool(layout.flags & 1), bool(layout.flags & 16)
                send(sock, [Frame(layout.identifier, data, extended, fd)])
        text = dump.communicate(timeout=20)[0]
    decode = [sys.executable, "-c", CANTOOLS, "decode", "-s", "-c", str(file)]
    lines = subprocess.run(decode, input=text, capture_output=True, text=True).stdout.splitlines()
    assert len(lines) == len(codecs)
    for codec, vector, line in zip(codecs, values, lines, strict=True):
        read = _numbers(line)
        for signal, value in zip(codec.signals, vector, strict=True):
            assert abs(read[signal.name] - value) <= 0.500001 * signal.scale + 1e-6 * abs(value)


def _crc_table(polynomial: int) -> str:
    table = []
    for value in range(256):
        for _ in range(8):
            value = (value << 1 ^ (polynomial if value & 0x80 else 0)) & 0xFF
        table.append(f"{value:02X}")
    return "".join(table)


def test_the_gateway_of_the_kernel_computes_our_checksum(vcan: tuple[str, str]) -> None:
    """E2E profile 2 is what ``cangw -p 2`` does: CRC of bytes 1 to 7 and the counter's data ID."""
    codec = next(
        c for c in map(Codec, load(FILES[0].with_name("link.dbc"))) if c.layout.profile == 2
    )
    ids = bytes(codec.layout.data_ids).hex().upper()
    number = f"{codec.layout.identifier:X}"
    call(
        *("cangw", "-A", "-s", vcan[0], "-d", vcan[1], "-e", "-f", f"{number}:7FF"),
        *("-m", "OR:D:0.0.0000000000000000"),  # checksums are for frames that were changed
        *("-c", f"1:7:0:FF:FF:{_crc_table(0x2F)}", "-p", f"2:{ids}"),
    )
    with open_socket(vcan[0]) as sock, open_socket(vcan[1]) as far:
        for counter in range(16):
            ours = codec.encode([0.5 * counter] * len(codec.signals), status=2, counter=counter)
            send(sock, [Frame(codec.layout.identifier, b"\0" + ours[1:])])
            assert receive(far, 1)[0].data == ours, f"counter {counter}"
