"""A CAN frame as the bits on the wire, one after the other: slow, and only for comparing."""

from __future__ import annotations

from itertools import groupby

DLC = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64]
GRAY = ["000", "001", "011", "010", "110", "111", "101", "100"]


def stuffed(bits: str, *, at_end: bool) -> str:
    """With a bit of the other value after five equal ones; behind the last bit if `at_end`."""
    out = ""
    for i, bit in enumerate(bits):
        out += bit
        if len(out) >= 5 and out[-5:] == bit * 5 and (at_end or i < len(bits) - 1):
            out += "10"[int(bit)]
    return out


def remainder(bits: str, polynomial: int, width: int, first: str = "") -> str:
    """The CRC as a division of polynomials, by hand; `first`: added to the first bits."""
    value = int(bits + "0" * width, 2)
    if first:
        value ^= int(first, 2) << (len(bits) + width - len(first))
    for i in range(len(bits) - 1, -1, -1):
        if value >> (i + width) & 1:
            value ^= (polynomial | 1 << width) << i
    return f"{value:0{width}b}"


def header(identifier: int, *, extended: bool, rtr: str) -> str:
    if not extended:
        return "0" + f"{identifier:011b}" + rtr + "0"
    name = f"{identifier:029b}"
    return "0" + name[:11] + "11" + name[11:] + rtr


def classic(identifier: int, data: bytes, *, extended: bool, remote: bool, dlc: int = 0) -> str:
    """Start of frame to intermission."""
    bits = header(identifier, extended=extended, rtr="01"[remote])
    bits += ("00" if extended else "0") + f"{dlc if remote else len(data):04b}"
    bits += "" if remote else "".join(f"{byte:08b}" for byte in data)
    bits += remainder(bits, 0x4599, 15)
    sent = stuffed(bits, at_end=True)
    assert max(len(list(run)) for _, run in groupby(sent)) <= 5
    return sent + "1" + "01" + "1" * 7 + "111"


def flexible(
    identifier: int, data: bytes, *, extended: bool, brs: bool, esi: bool
) -> tuple[str, str, str]:
    """Start of frame to BRS; ESI to CRC delimiter; the rest."""
    length = next(n for n in DLC if n >= len(data))
    before = header(identifier, extended=extended, rtr="0") + "10" + "01"[brs]
    within = "01"[esi] + f"{DLC.index(length):04b}"
    within += "".join(f"{byte:08b}" for byte in data.ljust(length, b"\0"))
    whole = stuffed(before + within, at_end=False)
    early = len(stuffed(before + within[:1], at_end=False)) - 1
    count = len(whole) - len(before) - len(within)
    tally = GRAY[count % 8]
    tally += str(tally.count("1") % 2)
    width, polynomial = (17, 0x1685B) if length <= 16 else (21, 0x102899)
    crc = remainder(whole + tally, polynomial, width, first="1")
    field, last = "", whole[-1]
    for i, bit in enumerate(tally + crc):
        if i % 4 == 0:
            field += "10"[int(last)]
        field += bit
        last = bit
    return whole[:early], whole[early:] + field + "1", "01" + "1" * 7 + "111"
