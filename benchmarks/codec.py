"""What a frame costs: our C, the same through ctypes, struct, cantools.

``python -m benchmarks.codec`` prints microseconds a frame (the least of several runs): a classic
frame of two int16 and a time stamp with Profile 2, and an FD frame of 14 int32 with Profile 5.
"""

from __future__ import annotations

import binascii
import ctypes as c
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bridge.can import dbc
from bridge.can.codec import Codec
from bridge.can.codec_check import verify
from bridge.can.layout import find
from bridge.native import library
from bridge.native.frame import Frame
from bridge.native.message import E2EProfile, Header
from cosim.base.clock import stopwatch
from fmus.build.toolchain import compile_shared, shared_suffix

ROOT = Path(__file__).parents[1]
CASES = (("8 B, P02", "link2.dbc", "TAU_1"), ("64 B, P05", "link_fd.dbc", "LINK_1"))
ONCE_C, ONCE_PYTHON, RUNS = 200_000, 2_000, 9


def least(run: Callable[[], object], count: int) -> float:
    """Microseconds for one of `count`, the least of several runs."""
    found = []
    for _ in range(RUNS):
        elapsed = stopwatch()
        run()
        found.append(elapsed())
    return 1e6 * min(found) / count


def in_c(codec: Codec, values: np.ndarray) -> tuple[float, float]:
    """Encode and decode, in a loop in C."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"codec{shared_suffix()}")
        include = [ROOT / "bridge" / "c"]
        loop = c.CDLL(
            str(compile_shared([Path(__file__).with_suffix(".c")], path, include=include))
        )
    lib, frame = library(), Frame()
    out = np.empty_like(values)
    encode, decode = (c.cast(f, c.c_void_p) for f in (lib.message_encode, lib.message_decode))
    message, n = c.byref(codec.message), c.c_int64(ONCE_C)
    given, taken = c.c_void_p(values.ctypes.data), c.c_void_p(out.ctypes.data)
    one = least(lambda: loop.codec_encode(encode, message, given, c.byref(frame), n), ONCE_C)
    other = least(lambda: loop.codec_decode(decode, message, taken, c.byref(frame), n), ONCE_C)
    assert abs(out - values).max() < 2**-8
    return one, other


def through_ctypes(codec: Codec, values: np.ndarray) -> tuple[float, float]:
    """``Codec.frame`` and ``Codec.decode``: for tools, not for the tick."""
    header, data = Header(), codec.encode(values)
    one = least(lambda: [codec.frame(values, header) for _ in range(ONCE_PYTHON)], ONCE_PYTHON)
    return one, least(lambda: [codec.decode(data) for _ in range(ONCE_PYTHON)], ONCE_PYTHON)


def with_struct(codec: Codec, values: np.ndarray) -> tuple[float, float]:
    """The fastest Python without a compiler: one struct, P05 by binascii (P02: no CRC at all)."""
    fd = codec.layout.profile is E2EProfile.P05
    code = struct.Struct("<HBBI14i" if fd else "<BBhhH")
    lsb, ids, numbers = codec.signals[0].scale, codec.layout.data_ids[:2], values.tolist()

    def encode() -> bytes:
        raw = [round(v / lsb) for v in numbers]
        data = code.pack(0, 0, 0, 0, *raw) if fd else code.pack(0, 0, *raw, 0)
        if not fd:
            return data
        crc = binascii.crc_hqx(ids, binascii.crc_hqx(data[2:], 0xFFFF))
        return crc.to_bytes(2, "little") + data[2:]

    def decode(data: bytes) -> list[float]:
        if fd:
            binascii.crc_hqx(ids, binascii.crc_hqx(data[2:], 0xFFFF))
        return [lsb * raw for raw in code.unpack(data)[4 if fd else 2 :]]

    data = encode()
    one = least(lambda: [encode() for _ in range(ONCE_PYTHON)], ONCE_PYTHON)
    return one, least(lambda: [decode(data) for _ in range(ONCE_PYTHON)], ONCE_PYTHON)


def with_cantools(codec: Codec, values: np.ndarray) -> tuple[float, float]:
    """cantools, with the CRC by its own functions."""
    layout, count = codec.layout, ONCE_PYTHON // 20
    message = dbc.read(layout.source).get_message_by_name(layout.name)
    reference = dbc.CantoolsMessage(layout)
    given = {s.name: v for s, v in zip(codec.signals, values.tolist(), strict=True)}
    given |= {"crc": 0, "counter": 0, "status": 0, "t_us": 0}
    data = message.encode(given)

    def encode() -> None:
        reference.crc(message.encode(given))

    def decode() -> None:
        reference.crc(data)
        message.decode(data, decode_choices=False)

    one = least(lambda: [encode() for _ in range(count)], count)
    return one, least(lambda: [decode() for _ in range(count)], count)


def main() -> None:
    print(f"{'us a frame':28}{'encode':>9}{'decode':>9}")
    for title, file, name in CASES:
        codec = Codec(find(dbc.load(ROOT / "configs" / "can" / file), name))
        values = np.linspace(-3.0, 3.0, len(codec.signals))
        ways = (("C", in_c), ("C from Python", through_ctypes))
        for way, measure in (*ways, ("struct", with_struct), ("cantools", with_cantools)):
            one, other = measure(codec, values)
            print(f"{title + ', ' + way:28}{one:9.3f}{other:9.3f}")
        elapsed = stopwatch()
        verify(codec)
        print(f"{title + ', verify once':28}{1e6 * elapsed():9.0f}")


if __name__ == "__main__":
    main()
