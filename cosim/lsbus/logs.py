"""Operations of FMI-LS-BUS between FMUs and a bus, as text."""

from __future__ import annotations

from cosim.lsbus.network import CanNetwork, Exchanged

_HEAD = "time_s\tnode\tdirection\toperation\n"


def operation_lines(network: CanNetwork) -> str:
    """All operations, one a line: time (s, to the ps), node, whether it sent it, and what."""
    return _HEAD + "".join(map(_line, network.exchanged))


def _line(x: Exchanged) -> str:
    seconds, ps = divmod(x.time_ps, 10**12)
    direction = "sent" if x.sent else "received"
    return f"{seconds}.{ps:012}\t{x.node}\t{direction}\t{x.operation}\n"
