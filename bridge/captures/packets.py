"""Packets of pcap and pcapng files, by flow: UDP, TCP and frames of CAN.

The blocks and headers are dpkt's; stamps are read as integers, since a float of seconds since 1970
is exact to 0.24 us only. A packet is known at the other end by its payload, and by `marks` that no
router changes: the identification of IPv4 with UDP, the sequence number with TCP. A relay or a VPN
makes packets anew, with other marks.

Source: IETF draft-ietf-opsawg-pcapng for blocks and stamps; tcpdump.org's list of link types.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import IO, Any

from bridge.captures.samples import ReadingNotes, RecordedSample
from bridge.ping.exchanges import NONE
from cosim.base.errors import ScenarioError
from cosim.base.extras import require

#: First four bytes of a file, as text of hexadecimal digits: byte order, and units of 1 s.
_PCAP = {
    "d4c3b2a1": ("<", 1_000), "4d3cb2a1": ("<", 1), "a1b2c3d4": (">", 1_000), "a1b23c4d": (">", 1)
}  # fmt: skip
_PCAPNG = "0a0d0d0a"
#: Kinds of link: Ethernet, raw IP (three numbers), cooked (two), loopback (two), SocketCAN.
_ETHERNET, _RAW, _SLL, _SLL2, _NULL, _CAN = 1, (12, 14, 101), 113, 276, (0, 108), 227
_LARGEST = 1 << 26

Packet = tuple[int, int, bytes, bool]  # ns, kind of link, bytes, whole


def packet_samples(path: Path, notes: ReadingNotes, marks: bool = True) -> Iterator[RecordedSample]:
    """The packets of a file that carry data, each with its flow as the name of its stream.

    `marks`: contents are different if their marks are.
    Raises ScenarioError for a file that is none.
    """
    require("dpkt")
    with path.open("rb") as file:
        magic = file.read(4).hex()
        if magic in _PCAP:
            packets = _pcap(file, *_PCAP[magic], path, notes)
        elif magic == _PCAPNG:
            packets = _pcapng(file, path, notes)
        else:
            raise ScenarioError(
                f"the file begins with {magic or 'nothing'}; expected pcap or pcapng", str(path)
            )
        for t_ns, kind, data, whole in packets:
            if not whole:
                notes.counts["packets were captured in part (snaplen), and are left out"] += 1
                continue
            found = _sample(kind, data, t_ns, notes, marks)
            if found is not None:
                yield found


def _pcap(
    file: IO[bytes], order: str, unit: int, path: Path, notes: ReadingNotes
) -> Iterator[Packet]:
    head = file.read(20)
    if len(head) < 20:
        raise ScenarioError("the header is cut off; expected a pcap file", str(path))
    kind = struct.unpack(order + "HHiIII", head)[5] & 0xFFFF
    header = struct.Struct(order + "IIII")
    count = 0
    while head := file.read(16):
        if len(head) == 16:
            seconds, rest, length, whole = header.unpack(head)
            data = file.read(length) if length < _LARGEST else b""
        if len(head) < 16 or len(data) < length:
            notes.lines.append(_cut(path, count))
            return
        count += 1
        yield seconds * 1_000_000_000 + rest * unit, kind, data, length >= whole


def _pcapng(file: IO[bytes], path: Path, notes: ReadingNotes) -> Iterator[Packet]:
    from dpkt import pcapng

    order, count = "<", 0
    interfaces: list[tuple[int, int, int]] = []  # kind of link, units in 1 s, offset in s
    file.seek(0)
    while head := file.read(8):
        if head[:4].hex() == _PCAPNG:
            order = "<" if (magic := file.read(4)) == b"\x4d\x3c\x2b\x1a" else ">"
            interfaces, head = [], head + magic
        number, length = struct.unpack(order + "II", head[:8]) if len(head) >= 8 else (0, 0)
        rest = file.read(length - len(head)) if len(head) <= length < _LARGEST else b""
        if len(head) + len(rest) < max(length, 12):
            if not count:
                raise ScenarioError("the first block is cut off; expected pcapng", str(path))
            notes.lines.append(_cut(path, count))
            return
        block = head + rest
        if number == pcapng.PCAPNG_BT_IDB:
            interfaces.append(_interface(block, order))
        elif number == pcapng.PCAPNG_BT_EPB:
            which, high, low, here, whole = struct.unpack_from(order + "5I", block, 8)
            if which < len(interfaces):
                kind, units, offset = interfaces[which]
                t_ns = (high << 32 | low) * 1_000_000_000 // units + offset * 1_000_000_000
                count += 1
                yield t_ns, kind, block[28 : 28 + here], here >= whole
        elif number == pcapng.PCAPNG_BT_SPB:
            notes.counts["packets have no stamp (simple blocks), and are left out"] += 1


def _interface(block: bytes, order: str) -> tuple[int, int, int]:
    from dpkt import pcapng

    kind = pcapng.InterfaceDescriptionBlockLE if order == "<" else None
    described = (kind or pcapng.InterfaceDescriptionBlock)(block)
    units, offset = 1_000_000, 0
    for option in described.opts:
        if option.code == pcapng.PCAPNG_OPT_IF_TSRESOL:
            power = option.data[0]
            units = 2 ** (power & 127) if power & 128 else 10**power
        elif option.code == pcapng.PCAPNG_OPT_IF_TSOFFSET:
            offset = struct.unpack(order + "q", option.data[:8])[0]
    return described.linktype, units, offset


def _cut(path: Path, count: int) -> str:
    return f"{path.name} is cut off after {count} packets: what followed is lost"


def _sample(
    kind: int, data: bytes, t_ns: int, notes: ReadingNotes, marks: bool
) -> RecordedSample | None:
    import dpkt

    try:
        found = _network(kind, data)
        if isinstance(found, bytes):
            return _can_frame(found, t_ns)
    except (dpkt.UnpackError, struct.error, IndexError):
        found = None
    if found is None:
        notes.counts["packets are neither IP nor CAN, and are left out"] += 1
        return None
    inner = found.data
    if isinstance(inner, dpkt.udp.UDP):
        name, mark = "udp", getattr(found, "id", 0)
    elif isinstance(inner, dpkt.tcp.TCP):
        if not inner.data:
            return None  # acknowledgements
        name, mark = "tcp", inner.seq
    else:
        what = "are fragments, and are left out" if _fragment(found) else "are neither UDP nor TCP"
        notes.counts[f"packets {what}"] += 1
        return None
    payload = bytes(inner.data)
    where = f"{_address(found.src)}:{inner.sport} -> {_address(found.dst)}:{inner.dport}"
    key = hash((payload, mark) if marks else payload)
    return RecordedSample(f"{name} {where}", t_ns, NONE, NONE, NONE, key)


def _network(kind: int, data: bytes) -> Any:
    """The IP packet inside a frame, the bytes of a frame of CAN, or None."""
    import dpkt

    found: Any = None
    if kind == _ETHERNET:
        found = dpkt.ethernet.Ethernet(data).data
    elif kind in _RAW:
        found = dpkt.ip.IP(data) if data[0] >> 4 == 4 else dpkt.ip6.IP6(data)
    elif kind == _SLL:
        cooked = dpkt.sll.SLL(data)
        found = data[16:] if cooked.ethtype in (0x0C, 0x0D) else cooked.data
    elif kind == _SLL2:
        cooked = dpkt.sll2.SLL2(data)
        found = data[20:] if cooked.ethtype in (0x0C, 0x0D) else cooked.data
    elif kind in _NULL:
        found = dpkt.loopback.Loopback(data).data
    elif kind == _CAN:
        found = data
    known = isinstance(found, dpkt.ip.IP | dpkt.ip6.IP6) or (
        isinstance(found, bytes) and kind in (_SLL, _SLL2, _CAN) and len(found) >= 8
    )
    return found if known else None


def _fragment(packet: Any) -> bool:
    return bool(getattr(packet, "mf", 0) or getattr(packet, "offset", 0))


def _can_frame(data: bytes, t_ns: int) -> RecordedSample | None:
    """A frame of SocketCAN; None for an error frame."""
    (identifier,) = struct.unpack_from(">I", data)
    if identifier & 0x20000000:
        return None
    name = f"{identifier & 0x1FFFFFFF:0{8 if identifier & 0x80000000 else 3}X}"
    return RecordedSample(f"can {name}", t_ns, NONE, NONE, NONE, hash(data[8 : 8 + data[4]]))


@lru_cache(maxsize=4096)
def _address(raw: bytes) -> str:
    from ipaddress import ip_address

    found = ip_address(raw)
    return f"[{found}]" if found.version == 6 else str(found)
