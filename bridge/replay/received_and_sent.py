"""Comparison of received with sent samples, by message and number.

A sender's samples are those that it computes in a replay, encoded and decoded as on its bus, and
forwarded as by gateways. A received sample with other values did not come from the recorded
sender, was altered in transit, or was given a wrong number by its receiver.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from bridge.deployment.carried import Carried
from bridge.deployment.system import System
from bridge.native import node as native
from bridge.native.message import E2EProfile, counter_bits
from bridge.records.node_lives import Life, lives_of
from bridge.wiring.wiring import Rows
from cosim.base.errors import ScenarioError
from cosim.schedule.plan import Plan

Values = NDArray[np.float64]
#: Turns of a counter by which a number may be wrong and still be recognized.
TURNS = 32
#: Numbers that samples may have beyond those of the run: of a sender that counts on.
BEYOND = 1 << 16


@final
class History:
    """Memory for the samples of one message, by sequence number, from `first` on."""

    def __init__(self, width: int, capacity: int, first: int = 0) -> None:
        self.values = np.zeros((capacity, width))
        self.there = np.full(capacity, native.UNKNOWN, np.uint8)
        self.first = first
        self.struct = native.HistoryStruct(
            first=first,
            capacity=capacity,
            width=width,
            values=self.values.ctypes.data,
            there=self.there.ctypes.data,
        )

    def known(self, numbers: NDArray[np.int64]) -> NDArray[np.bool_]:
        """A mask (n,) of the samples that are there."""
        k = numbers - self.first
        inside = (k >= 0) & (k < self.there.size)
        return np.asarray(inside & (self.there[np.where(inside, k, 0)] == native.THERE))

    def at(self, numbers: NDArray[np.int64]) -> Values:
        """Values of these samples, (n, width)."""
        return np.asarray(self.values[numbers - self.first])


@dataclass(frozen=True, slots=True)
class AlteredSamples:
    """Samples of a message that a life received with other values than were sent.

    `count`: their number; of the first one its number, and value `index` as `sent` and as `heard`
    (received). `misnumbered`: how many are other samples of the same sender, some wraps of its
    counter before; `unsent`: how many have a number that the sender has not sent.
    """

    life: Life
    message: str
    count: int
    number: int
    index: int
    sent: float
    heard: float
    misnumbered: int = 0
    unsent: int = 0

    def __str__(self) -> str:
        """For people."""
        others = self.count - self.misnumbered - self.unsent
        parts = {
            "did not come from the recorded sender or were altered": others,
            "have a number that the recorded sender never sent": self.unsent,
            "are older samples under a wrong number": self.misnumbered,
        }
        said = ", ".join(f"{n} {text}" for text, n in parts.items() if n)
        return (
            f"{self.life}: {self.message}: {said}; first: sample {self.number}, "
            f"value {self.index}: heard {self.heard:.6g}, sent {self.sent:.6g}"
        )


def received_history(rows: Rows, carried: Carried, plan: Plan) -> History:
    """Return the history of one message from the samples (n,) that a life received.

    Raises ScenarioError for sequence numbers that no run can have.
    """
    width = carried.outlet.width
    if not len(rows):
        return History(width, 1)
    numbers, at = np.unique(rows["sequence"], return_index=True)  # of two alike the first was taken
    first, span = int(numbers[0]), int(numbers[-1] - numbers[0]) + 1
    most = plan.ticks // carried.outlet.ticks + len(rows) + BEYOND
    if first < 0 or span > most:
        raise ScenarioError(
            f"samples {first} to {first + span - 1} of {carried.name} heard; a run has at most "
            f"{most}: the journal of received samples is damaged"
        )
    history = History(width, span, first)
    history.values[numbers - first] = rows["values"][at, :width]
    history.there[numbers - first] = native.THERE
    return history


def sent_histories(system: System, lives: Mapping[Life, Rows]) -> dict[str, History]:
    """Return empty histories of all messages that recorded nodes and their gateways send.

    `lives`: the rows (slots,) of each life. Without a counter only its time identifies a received
    sample, so such messages have no history.
    """
    found: dict[str, History] = {}
    for life in lives:
        for outlet in system.nodes[life.node].outlets:
            if not system.messages[outlet.message].encoding.message.e2e:
                continue
            capacity = system.plan.ticks // outlet.ticks + 8
            for made in (outlet, *(m.outlet for m in system.forwards_of(outlet.message))):
                found.setdefault(made.message, History(made.width, capacity))
    return found


def compare_with_senders(
    system: System,
    recorded: Mapping[Life, Rows],
    heard: Mapping[Life, Rows],
    sent: Mapping[str, History],
) -> tuple[tuple[AlteredSamples, ...], set[str]]:
    """Return the samples that differ from those sent, and the messages not completely compared.

    `recorded`: rows (slots,) of each life; `heard`: its received samples (n,).
    """
    altered: list[AlteredSamples] = []
    alone: set[str] = set()
    for life, rows in heard.items():
        for number, message in enumerate(system.received_by(life.node)):
            mine = rows[rows["message"] == number]
            history = sent.get(message)
            if not len(mine):
                continue
            if history is None:
                alone.add(message)
                continue
            numbers = mine["sequence"]
            unsent = _never_sent(system, recorded, message, numbers)
            if not (history.known(numbers) | unsent).all():
                alone.add(message)
            altered += _altered_samples(
                system, ReceivedSamples(life, message, mine), history, unsent
            )
    return tuple(altered), alone


def missing_in_journal(
    system: System, life: Life, rows: Rows, histories: Mapping[str, History]
) -> Iterator[str]:
    """Yield the messages of which a life held samples that its journal of received samples lacks.

    `rows`: the rows (slots,) of the life.
    """
    for i, inlet in enumerate(system.nodes[life.node].inlets):
        held = rows["inlets"]["held"][:, i]
        if not histories[inlet.message].known(held[held >= 0]).all():
            yield inlet.message


@dataclass(frozen=True, slots=True)
class ReceivedSamples:
    """The samples of one message that a life received, in the order of reception."""

    life: Life
    message: str
    rows: Rows


def _altered_samples(
    system: System, received: ReceivedSamples, history: History, unsent: NDArray[np.bool_]
) -> Iterator[AlteredSamples]:
    """The samples that are not those of their sender, if there are any."""
    rows, message = received.rows, system.messages[received.message].encoding.message
    values = rows["values"][:, : history.values.shape[1]]
    other = unsent | _differ(history, rows["sequence"], values)
    at = np.flatnonzero(other)
    if not at.size:
        return
    numbers, values = rows["sequence"][at], values[at]
    turn = 1 << counter_bits(E2EProfile(message.e2e))
    wrong = np.zeros(at.size, np.bool_)
    for k in range(-TURNS, TURNS + 1):
        meant = numbers + k * turn
        wrong |= history.known(meant) & ~_differ(history, meant, values)
    true = np.full(values.shape[1], np.nan)
    if history.known(numbers[:1]).all():
        true = history.at(numbers[:1])[0]
    index = int(np.flatnonzero(_bits(true) != _bits(values[0]))[0])
    yield AlteredSamples(
        received.life, received.message, int(at.size), int(numbers[0]), index, float(true[index]),
        float(values[0, index]), int(wrong.sum()), int((unsent[at] & ~wrong).sum()),
    )  # fmt: skip


def _differ(history: History, numbers: NDArray[np.int64], values: Values) -> NDArray[np.bool_]:
    """A mask of the samples that are known and have other values; not one bit may differ."""
    known = history.known(numbers)
    true = history.at(np.where(known, numbers, history.first))
    return np.asarray(known & (_bits(true) != _bits(values)).any(axis=1))


def _bits(values: Values) -> NDArray[np.int64]:
    return np.ascontiguousarray(values).view(np.int64)


def _never_sent(
    system: System, recorded: Mapping[Life, Rows], message: str, numbers: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """A mask (n,) of the numbers that the sender has not sent.

    After the last row of a life there may be a few: of its end, or one whose row it did not live to
    write. After its last life nothing is known.
    """
    carried = system.messages[message]
    origin = carried.forward.origin if carried.forward else message
    node = system.messages[origin].node
    ramp = system.deployment.seconds(system.deployment.nodes[node].ramp, "nodes", node, "ramp")
    few = 2 + int(ramp * 1e9 / carried.period_ns)
    every = carried.outlet.ticks // system.nodes[node].ticks
    lives = [recorded[life] for life in lives_of(recorded, node)]
    found = np.full(numbers.shape, bool(lives))
    for rows in lives:
        first = -(-int(rows["slot"][0]) // every)
        last = int(rows["slot"][-1]) // every + few
        found &= (numbers < first) | (numbers > last)
    if lives:
        found &= numbers <= int(lives[-1]["slot"][-1]) // every
    return found
