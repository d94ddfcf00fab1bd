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
    law = law_of(table)
    if law.kind == "none":
        return (
            "    /* participant_output(p, OUT_...)[value] = ... participant_input(p, IN_...)[value]"
            " ...; */"
        )
    received = identifier(table.received[law.received].name)
    sent = identifier(table.sent[law.sent].name)
    lines = [
        f"const double *in = participant_input(p, IN_{received});",
        f"double *out = participant_output(p, OUT_{sent});",
        f"for (int i = 0; i < {law.joints}; i++) {{",
        *(f"    {line}" for line in _joint_in_c(law)),
        "}",
    ]
    return "\n".join(f"    {line}" for line in lines)


def _joint_in_c(law: FirstLaw) -> list[str]:
    if law.kind == "damping":
        _, dq, tau = law.first
        return [f"out[{tau} + i] = -{DAMPING} * in[{dq} + i];"]
    tau, q, dq = law.first
    return [
        f"const double tau = participant_scale(p) * in[{tau} + i];",
        f"out[{dq} + i] += h / {INERTIA} * (tau - {FRICTION} * out[{dq} + i]);",
        f"out[{q} + i] += h * out[{dq} + i];",
    ]


def law_in_python(table: NodeTable) -> str:
    """The law as the statements of a function in Python."""
    law = law_of(table)
    if law.kind == "none":
        return "    pass  # outputs[message][value] = ... inputs[message][value] ..."
    received, sent = table.received[law.received].name, table.sent[law.sent].name
    lines = [
        f'u, y = inputs.get("{received}", [0.0] * {len(table.received[law.received].values)}), '
        f'outputs["{sent}"]',
        f"for i in range({law.joints}):",
    ]
    if law.kind == "damping":
        _, dq, tau = law.first
        lines.append(f"    y[{tau} + i] = -{DAMPING} * scale * u[{dq} + i]")
    else:
        tau, q, dq = law.first
        lines += [
            f"    y[{dq} + i] += h / {INERTIA} * (scale * u[{tau} + i] - {FRICTION} * y[{dq} + i])",
            f"    y[{q} + i] += h * y[{dq} + i]",
        ]
    return "\n".join(f"    {line}" for line in lines)
