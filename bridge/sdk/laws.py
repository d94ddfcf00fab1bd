"""The law that a new participant begins with, in each language: a few lines, to be replaced.

A node that takes torques and sends positions and velocities is a load of 1 kg.m2 a joint with
friction. A node that takes positions and velocities and sends torques damps. Any other node sends
its first values.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from bridge.sdk.c_table import identifier
from bridge.sdk.table import NodeTable, ReceivedEntry, SentEntry

#: kg.m2 and N.m.s/rad of the load; N.m.s/rad of the damping.
INERTIA, FRICTION, DAMPING = 1.0, 2.0, 2.0
_ENTRY = re.compile(r"\w+\.(\w+)(?:\[|\b)")


@dataclass(frozen=True, slots=True)
class FirstLaw:
    """The law of a new participant: its kind (``load``, ``damping``, ``none``), a received and a
    sent message, joints, and the first value of each port.
    """

    kind: str
    received: int = 0
    sent: int = 0
    joints: int = 0
    first: tuple[int, ...] = ()


def law_of(table: NodeTable) -> FirstLaw:
    """The law that fits the messages of a node."""
    for kind, wanted, given in (
        ("load", ("tau",), ("q", "dq")),
        ("damping", ("q", "dq"), ("tau",)),
    ):
        for i, received in enumerate(table.received):
            for o, sent in enumerate(table.sent):
                spans = [*_spans(received, wanted), *_spans(sent, given)]
                joints = {count for _, count in spans}
                if len(joints) == 1 and joints != {0}:
                    return FirstLaw(kind, i, o, joints.pop(), tuple(first for first, _ in spans))
    return FirstLaw("none")


def _spans(entry: ReceivedEntry | SentEntry, ports: Sequence[str]) -> list[tuple[int, int]]:
    """The first value of each port and their number; (0, 0): it is not there."""
    names: list[Any] = [found[1] if (found := _ENTRY.match(v)) else "" for v in entry.values]
    return [(names.index(p), names.count(p)) if p in names else (0, 0) for p in ports]


def law_in_c(table: NodeTable) -> str:
    """The law as the statements of a function in C."""
    hold = (
        "/* participant_output(p, OUT_...)[value] = ... participant_input(p, IN_...)[value] ...; */"
    )
    head = (
        "const double *in = participant_input(p, IN_{received}), scale = participant_scale(p);",
        "double *out = participant_output(p, OUT_{sent});",
        "for (int i = 0; i < {joints}; i++) {{",
    )
    return _law(table, hold, head, ";", ("    ", "}"))


def law_in_cpp(table: NodeTable) -> str:
    """The law as the statements of a function in C++."""
    hold = "/* slot.out(OUT_...)[value] = ... slot.in(IN_...)[value] ...; */"
    head = (
        "const auto in = slot.in(IN_{received});",
        "const auto out = slot.out(OUT_{sent});",
        "const double h = slot.h, scale = slot.scale();",
        "for (std::size_t i = 0; i < {joints}; i++) {{",
    )
    return _law(table, hold, head, ";", ("    ", "}"))


def law_in_rust(table: NodeTable) -> str:
    """The law as the statements of a function in Rust."""
    hold = (
        "// slot.output(number, values)[value] = ... slot.input(number, values)[value] ...; table.h"
    )
    head = (
        "let scale = slot.scale();",
        "let input: Vec<f64> = slot.input({i}, {values}).to_vec(); // {received}",
        "let out = slot.output({o}, {given}); // {sent}",
        "for i in 0..{joints} {{",
    )
    return _law(table, hold, head, ";", ("    ", "}")).replace("in[", "input[")


def law_in_python(table: NodeTable) -> str:
    """The law as the statements of a function in Python."""
    hold = "pass  # outputs[message][value] = ... inputs[message][value] ..."
    head = (
        'u, out = inputs.get("{received}", [0.0] * {values}), outputs["{sent}"]',
        "for i in range({joints}):",
    )
    return _law(table, hold, head, "", ("    ", "")).replace("in[", "u[")


def _law(table: NodeTable, hold: str, head: Sequence[str], end: str, block: tuple[str, str]) -> str:
    """The lines of a law, or `hold`; the variables of each language are in, out, h, scale and i."""
    law = law_of(table)
    if law.kind == "none":
        return f"    {hold}"
    received, sent = table.received[law.received], table.sent[law.sent]
    words = {
        "received": identifier(received.name) if end else received.name,
        "sent": identifier(sent.name) if end else sent.name,
        "i": law.received,
        "o": law.sent,
        "values": len(received.values),
        "given": len(sent.values),
        "joints": law.joints,
    }
    lines = [line.format(**words) for line in head]
    lines += [f"{block[0]}{statement}{end}" for statement in _statements(law)]
    return "\n".join(f"    {line}" for line in (*lines, block[1])).rstrip()


def _statements(law: FirstLaw) -> list[str]:
    """The law of a joint; what sends its torques scales them."""
    if law.kind == "damping":
        _, dq, tau = law.first
        return [f"out[{tau} + i] = -{DAMPING} * in[{dq} + i]"]
    tau, q, dq = law.first
    return [
        f"out[{dq} + i] += h / {INERTIA} * (scale * in[{tau} + i] - {FRICTION} * out[{dq} + i])",
        f"out[{q} + i] += h * out[{dq} + i]",
    ]
