"""Rows of nodes as messages for plotting tools: MCAP files and Foxglove.

A component is a topic, ``/master``, whose fields are its ports, flattened. A node is another topic,
``/nodes/master``, with the data of its journal for each slot. Messages are JSON with a schema, so
readers need no code of this project; a number that is not finite is ``null``. Times are those of
the deadlines: log time 0 is t = 0 if the date of t = 0 is unknown.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil, isfinite
from typing import Any, Protocol, final

import numpy as np
from numpy.typing import NDArray

from bridge.deployment.cut import NodePlan
from bridge.native.safety import LifeState
from bridge.recording.live_run import LiveRun
from bridge.records.node_lives import Life
from bridge.safety.limits import explain
from bridge.wiring.wiring import INLET_ROW

Rows = NDArray[np.void]
#: Rows of a node turned into messages at once.
BATCH = 4096
_TIMES = ("deadline_ns", "woke_ns", "received_ns", "send_ns", "done_ns")


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic: `schema` as JSON Schema has it."""

    name: str
    title: str
    schema: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class TopicMessage:
    """A message: `t_ns` of its deadline since 1970 (or of the run), `content` plain JSON data."""

    topic: Topic
    t_ns: int
    content: Mapping[str, Any]


class Sink(Protocol):
    """Destination of messages; `rate`: maximum rate, Hz, for each node; inf: all messages."""

    rate: float

    def put(self, sample: TopicMessage) -> None:
        """Take one."""


@final
class Feed:
    """Gives sinks what was written since the last time."""

    def __init__(self, watched: LiveRun, sinks: Sequence[Sink]) -> None:
        self._watched, self._sinks = watched, sinks
        self._given: dict[Life, int] = {}
        self._sources: dict[Life, TopicSource] = {}

    def new(self) -> int:
        """All rows that are new, as messages by time; returns how many slots they were."""
        if not self._sinks:
            return 0
        total = 0
        while batch := list(self._batch()):
            total += sum(len(rows) for _, rows in batch)
            self._give(batch)
        return total

    def _batch(self) -> Iterator[tuple[Life, Rows]]:
        """New rows of all lives up to a common time, so that files are nearly sorted."""
        found: dict[Life, Rows] = {}
        for life, tail in self._watched.lives.items():
            first = self._given.get(life, 0)
            rows = tail.rows(first, first + BATCH)
            if len(rows):
                found[life] = rows
        full = [int(r["deadline_ns"][-1]) for r in found.values() if len(r) == BATCH]
        for life, rows in found.items():
            here = rows[rows["deadline_ns"] <= min(full)] if full else rows
            self._given[life] = self._given.get(life, 0) + len(here)
            if len(here):
                yield life, here

    def _give(self, batch: Sequence[tuple[Life, Rows]]) -> None:
        for sink in self._sinks:
            samples: list[TopicMessage] = []
            for life, rows in batch:
                samples += self._source(life).samples(rows, sink.rate)
            samples.sort(key=lambda s: s.t_ns)
            for sample in samples:
                sink.put(sample)

    def _source(self, life: Life) -> TopicSource:
        if life not in self._sources:
            node = self._watched.system.nodes[life.node]
            self._sources[life] = TopicSource(node, self._watched.facts.wall_ns)
        return self._sources[life]


@final
class TopicSource:
    """Messages of a node. `wall_ns`: of t = 0, since 1970."""

    def __init__(self, node: NodePlan, wall_ns: int) -> None:
        self._node, self._wall = node, wall_ns
        self._slots = {
            step.name: {s.port: s for s in (*step.inputs, *step.outputs)}
            for step in node.plan.components
        }

    def samples(self, rows: Rows, rate: float) -> list[TopicMessage]:
        """Return messages for the rows (n,), at most `rate` per second (Hz)."""
        every = max(1, ceil(1.0 / (self._node.h * rate) - 1e-9))
        found: list[TopicMessage] = []
        for row in rows[rows["slot"] % every == 0]:
            t_ns = self._wall + int(row["deadline_ns"])
            signals = [v if isfinite(v) else None for v in row["signals"].tolist()]
            for topic in self.components:
                ports = self._slots[topic.name[1:]]
                content = {
                    p: _shaped(signals[s.start : s.start + s.size], s.shape)
                    for p, s in ports.items()
                }
                found.append(TopicMessage(topic, t_ns, content))
            found.append(TopicMessage(self.node, t_ns, self._of_slot(row)))
        return found

    def _of_slot(self, row: np.void) -> dict[str, Any]:
        numbers = {name: int(row[name]) for name in ("slot", *_TIMES, "guard", "flags")}
        state = int(row["state"])
        known = {int(s) for s in LifeState}
        return {
            **numbers,
            "late_us": (numbers["woke_ns"] - numbers["deadline_ns"]) * 1e-3,
            "scale": float(row["scale"]),
            "state": LifeState(state).name.lower() if state in known else str(state),
            "reasons": explain(int(row["reasons"])) if row["reasons"] else "",
            "inputs": {
                inlet.target.name: {k: int(held[k]) for k in INLET_ROW}
                for inlet, held in zip(self._node.inlets, row["inlets"], strict=True)
            },
        }

    @cached_property
    def components(self) -> tuple[Topic, ...]:
        """A topic a component; the units are in its schema."""
        return tuple(
            Topic(f"/{name}", name, _object({p: _field(s.shape, s.unit) for p, s in ports.items()}))
            for name, ports in self._slots.items()
        )

    @cached_property
    def node(self) -> Topic:
        """The topic of the node itself."""
        integer, text = {"type": "integer"}, {"type": "string"}
        number = {"type": "number"}
        inlet = _object({k: integer for k in INLET_ROW})
        fields = {
            **{name: integer for name in ("slot", *_TIMES, "guard", "flags")},
            "late_us": number, "scale": number, "state": text, "reasons": text,
            "inputs": _object({i.target.name: inlet for i in self._node.inlets}),
        }  # fmt: skip
        return Topic(f"/nodes/{self._node.name}", f"node.{self._node.name}", _object(fields))


def _shaped(values: list[float | None], shape: tuple[int, ...]) -> Any:
    """A scalar alone, else all entries in one list."""
    return values if shape else values[0]


def _field(shape: tuple[int, ...], unit: str) -> dict[str, Any]:
    number = {"type": ["number", "null"]}
    return {**({"type": "array", "items": number} if shape else number), "description": unit}


def _object(fields: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": dict(fields)}
