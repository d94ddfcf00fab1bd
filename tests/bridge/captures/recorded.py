"""Recordings of a known table of delays, written by the libraries that define their formats."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import can
import dpkt
import numpy as np
from mcap.writer import Writer as McapWriter
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

Integers = NDArray[np.int64]
START = 1_790_000_000_000_000_000
TYPES = get_typestore(Stores.ROS2_HUMBLE)
JOINT_STATE = "sensor_msgs/msg/JointState"


@dataclass(frozen=True)
class KnownTable:
    """Packets sent at `sent` (n,), ns, that took `delay` (n,), ns, unless `lost` (n,)."""

    sent: Integers
    delay: Integers
    lost: NDArray[np.bool_]

    @property
    def rows(self) -> Iterable[int]:
        """The packets that arrived, in the order of arrival."""
        order = np.argsort(self.sent + self.delay, kind="stable")
        return [int(i) for i in order if not self.lost[i]]

    def received(self, i: int) -> int:
        return int(self.sent[i] + self.delay[i])

    def expected(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """t_send and delay of the link, s, NaN: lost."""
        delay = np.where(self.lost, np.nan, self.delay * 1e-9)
        return (self.sent - self.sent[0]) * 1e-9, delay


def table(
    seed: int = 1, n: int = 400, lost: float = 0.05, unit: int = 1, scale: float = 1e6
) -> KnownTable:
    """5 ms apart; delays of 2 ms and more, multiples of `unit` ns. Both ends arrive."""
    rng = np.random.default_rng(seed)
    sent = START + np.arange(n) * 5_000_000
    delay = (2e6 + rng.gamma(2, scale, n)).astype(np.int64) // unit * unit
    gone = rng.random(n) < lost
    gone[[0, -1]] = False
    return KnownTable(sent, delay, gone)


Shift = Callable[[int], int]


def no_shift(t: int) -> int:
    return t


def drifting(offset_s: float, ppm: float) -> Shift:
    """The time on a clock that is `offset_s` ahead at START, and runs `ppm` fast."""
    return lambda t: t + round(offset_s * 1e9) + round((t - START) * ppm * 1e-6)


def joint_state(stamp: int, i: int) -> bytes:
    header = TYPES.types["std_msgs/msg/Header"](
        TYPES.types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9), "base"
    )
    empty = np.array([])
    message = TYPES.types[JOINT_STATE](header, [], np.array([float(i)]), empty, empty)
    return bytes(TYPES.serialize_cdr(message, JOINT_STATE))


def write_mcap(
    path: Path, known: KnownTable, log: Shift = no_shift, stamp: Shift = no_shift, **options: bool
) -> Path:
    """Header stamps on the clock `stamp`, log times on the clock `log`; `numbered`, `publish`."""
    definition = TYPES.generate_msgdef(JOINT_STATE)[0].encode()
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=4096)
        writer.start()
        schema = writer.register_schema(JOINT_STATE, "ros2msg", definition)
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for i in known.rows:
            sent, received = stamp(int(known.sent[i])), log(known.received(i))
            publish = sent if options.get("publish") else received
            data = joint_state(0 if options.get("publish") else sent, i)
            number = i if options.get("numbered") else 0
            writer.add_message(channel, received, data, publish, number)
        writer.finish()
    return path


def write_bag(path: Path, known: KnownTable, plugin: StoragePlugin) -> Path:
    with BagWriter(path, version=9, storage_plugin=plugin) as bag:
        topic = bag.add_connection("/joint_states", JOINT_STATE, typestore=TYPES)
        bag.add_connection("/silent", "std_msgs/msg/String", typestore=TYPES)
        for i in known.rows:
            bag.write(topic, known.received(i), joint_state(int(known.sent[i]), i))
    return path


def packet(there: bool, payload: bytes, number: int) -> bytes:
    ends = [(socket.inet_aton(f"10.0.0.{k}"), 5000 + k) for k in (1, 2)]
    (source, sport), (target, dport) = ends if there else ends[::-1]
    udp = dpkt.udp.UDP(sport=sport, dport=dport, data=payload)
    udp.ulen = len(udp)
    ip = dpkt.ip.IP(src=source, dst=target, p=17, id=number & 0xFFFF, data=udp)
    ip.len = len(ip)
    return bytes(dpkt.ethernet.Ethernet(src=b"\2" * 6, dst=b"\4" * 6, type=0x800, data=ip))


def write_ends(
    folder: Path,
    there: KnownTable,
    back: KnownTable | None,
    clock: Shift,
    suffix: str = ".pcap",
) -> tuple[Path, Path]:
    """Captures of nanoseconds at both ends; the second one's clock shows `clock`(t)."""
    here, far = [], []
    for way, known in ((True, there), (False, back)):
        for i in range(known.sent.size if known is not None else 0):
            assert known is not None
            data = packet(way, b"payload" + i.to_bytes(4, "big"), i)
            sent, received = int(known.sent[i]), known.received(i)
            first, second = (here, far) if way else (far, here)
            first.append((sent if way else clock(sent), data))
            if not known.lost[i]:
                second.append((clock(received) if way else received, data))
    paths = folder / f"here{suffix}", folder / f"there{suffix}"
    for path, packets in zip(paths, (here, far), strict=True):
        write_packets(path, sorted(packets))
    return paths


def write_packets(path: Path, packets: Iterable[tuple[int, bytes]]) -> Path:
    with path.open("wb") as file:
        if path.suffix == ".pcapng":
            option = dpkt.pcapng.PcapngOptionLE(
                code=dpkt.pcapng.PCAPNG_OPT_IF_TSRESOL, data=bytes([9])
            )
            end = dpkt.pcapng.PcapngOptionLE(code=dpkt.pcapng.PCAPNG_OPT_ENDOFOPT)
            interface = dpkt.pcapng.InterfaceDescriptionBlockLE(
                linktype=1, snaplen=65535, opts=[option, end]
            )
            writer = dpkt.pcapng.Writer(file, idb=interface)
            for t, data in packets:
                block = dpkt.pcapng.EnhancedPacketBlockLE(
                    ts_high=t >> 32, ts_low=t & 0xFFFFFFFF, caplen=len(data), pkt_len=len(data),
                    pkt_data=data,
                )  # fmt: skip
                file.write(bytes(block))
            del writer
        else:
            plain = dpkt.pcap.Writer(file, nano=True)
            for t, data in packets:
                plain.writepkt(data, Decimal(t) / 10**9)
    return path


def write_gateway(path: Path, known: KnownTable, repeats: int = 1 << 32) -> Path:
    """A log of python-can of two buses, with a gateway between them; contents repeat after some."""
    frames = []
    for i in range(known.sent.size):
        data = (i % repeats).to_bytes(4, "big") + b"\1\2"
        frames.append((int(known.sent[i]), 1, data))
        if not known.lost[i]:
            frames.append((known.received(i), 2, data))
    with can.Logger(path) as log:
        for t, channel, data in sorted(frames):
            log(
                can.Message(
                    timestamp=t / 1e9, arbitration_id=0x1A0, is_extended_id=False, data=data,
                    channel=channel if path.suffix != ".log" else f"can{channel}",
                )
            )  # fmt: skip
    return path


def write_csv(path: Path, known: KnownTable) -> Path:
    rows = ["seq,sent_ns,received_ns"]
    for i in range(known.sent.size):
        rows.append(f"{i},{known.sent[i]},{'' if known.lost[i] else known.received(i)}")
    path.write_text("\n".join(rows) + "\n")
    return path
