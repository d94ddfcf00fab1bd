"""What happened on a bus between FMUs, as text: frames, and operations of FMI-LS-BUS."""

from __future__ import annotations

from collections.abc import Iterable

from cosim.bus.frames import BusFrame
from cosim.lsbus.network import CanNetwork, Exchanged

_HEAD = "time_s\tnode\tdirection\toperation\n"


def candump(frames: Iterable[tuple[int, int, BusFrame]], bus: str) -> str:
    """Frames (time in ps, node, frame) as ``candump -l`` writes them, with times in µs."""
    return "".join(
        f"({at // 10**12}.{at // 10**6 % 10**6:06}) {bus} {_frame(frame)}\n"
        for at, _, frame in frames
    )


def _frame(frame: BusFrame) -> str:
    kind, data = frame.format, frame.data.hex().upper()
    identifier = f"{frame.identifier:08X}" if kind.extended else f"{frame.identifier:03X}"
    if kind.fd:
        return f"{identifier}##{kind.brs | kind.esi << 1:X}{data}"
    return f"{identifier}#R{frame.length or ''}" if kind.remote else f"{identifier}#{data}"


def operation_lines(network: CanNetwork) -> str:
    """All operations, one a line: time (s, to the ps), node, whether it sent it, and what."""
    return _HEAD + "".join(map(_line, network.exchanged))


def _line(x: Exchanged) -> str:
    seconds, ps = divmod(x.time_ps, 10**12)
    direction = "sent" if x.sent else "received"
    return f"{seconds}.{ps:012}\t{x.node}\t{direction}\t{x.operation}\n"
