"""Layouts that several tests use, and a simple reference packer."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from bridge.can import dbc
from bridge.can.layout import MessageLayout, Signal, find

CONFIGS = Path(__file__).parents[3] / "configs" / "can"
LINKS = ("link.dbc", "link2.dbc", "link_fd.dbc", "link_fd2.dbc")


@cache
def layouts(name: str) -> tuple[MessageLayout, ...]:
    return dbc.load(CONFIGS / name)


def layout(file: str, message: str) -> MessageLayout:
    return find(layouts(file), message)


def placed(signal: Signal, raw: int, data: bytes) -> bytes:
    """`data` with the bits of a raw value written over, one at a time."""
    out = bytearray(data)
    for k, bit in enumerate(signal.bits()):
        out[bit // 8] = out[bit // 8] & ~(1 << bit % 8) | (raw >> k & 1) << bit % 8
    return bytes(out)
