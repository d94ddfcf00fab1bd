"""FMUs with CAN terminals on one simulated bus: each operation at its exact time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import final

from cosim.base.files import Closing
from cosim.bus.settings import BusNodeSettings, Disturbance
from cosim.bus.timing import BusTiming
from cosim.lsbus.codec import Malformed, encode, split
from cosim.lsbus.exchange import OperationBus
from cosim.lsbus.node import PS, NodeFmu
from cosim.lsbus.operations import LsBusError, Operation

_ROUNDS = 10_000


@dataclass(frozen=True, slots=True)
class Exchanged:
    """An operation that a node has sent (`sent`) or received, and when, ps."""

    time_ps: int
    node: str
    sent: bool
    operation: Operation | Malformed


@final
class CanNetwork(Closing):
    """Nodes on a bus, from time 0 on: all are stepped to the next time at which something happens.

    That is a tick of a Tx clock, a time event of a node, an operation of the bus for a node, or a
    multiple of `step` (s), where FMUs with triggered Tx clocks are heard. To be used in `with`,
    which frees the FMUs.
    """

    def __init__(
        self,
        timing: BusTiming,
        nodes: Sequence[NodeFmu],
        *,
        step: float,
        disturbances: Sequence[Disturbance] = (),
        seed: int = 0,
        settings: Mapping[str, BusNodeSettings] | None = None,
    ) -> None:
        self._step_ps = round(step / PS)
        if self._step_ps < 1:
            raise LsBusError(f"found a step of {step:g} s, expected one of 1 ps or more")
        names = [n.name for n in nodes]
        if len(set(names)) != len(names):
            raise LsBusError(f"found the nodes {', '.join(names)}, expected each name once")
        self.nodes = tuple(nodes)
        self.bus = OperationBus(
            timing,
            names,
            notified=[n.notified for n in nodes],
            disturbances=disturbances,
            seed=seed,
            settings=settings,
        )
        #: All operations so far, in the order in which nodes sent and received them.
        self.exchanged: list[Exchanged] = []
        #: The node that ended the simulation; "": none.
        self.ended = ""
        self._started = False

    def close(self) -> None:
        """Free all FMUs, also where one of them cannot be freed; may be called twice."""
        with ExitStack() as stack:
            for node in self.nodes:
                stack.callback(node.close)

    def run(self, until: float) -> None:
        """Go on to `until` (s), or to where a node ends the simulation.

        Raises FmuError and LsBusError for what an FMU must not do.
        """
        if not self._started:
            for node in self.nodes:
                node.initialize()
            self.start([node.start() for node in self.nodes])
        self.go_on(round(until / PS))

    def start(self, sent: Sequence[Sequence[bytes]]) -> None:
        """Begin at time 0, where the nodes have left Initialization Mode and `sent` this."""
        self._started = True
        for i, buffers in enumerate(sent):
            self._send(i, buffers)
        self._settle(set())

    def jump(self, due: set[int]) -> None:
        """Let the nodes of these numbers have an event now, for inputs that are new."""
        if due:
            self._settle(due, self.bus.now_ps)

    def go_on(self, until_ps: int) -> None:
        """Run nodes that have started (see :meth:`run`) to a time in ps."""
        while self.bus.now_ps < until_ps and not self.ended:
            stop = self._next(until_ps)
            ends = [node.step(stop) for node in self.nodes]
            due = {
                i
                for i, (node, end) in enumerate(zip(self.nodes, ends, strict=True))
                if end.event or node.next_ps <= stop
            }
            self.ended = next(
                (n.name for n, e in zip(self.nodes, ends, strict=True) if e.ended), ""
            )
            if not self.ended:
                self._settle(due, stop)

    def _next(self, until_ps: int) -> int:
        """The next time at which the nodes have to be stopped, ps."""
        now = self.bus.now_ps
        grid = (now // self._step_ps + 1) * self._step_ps
        first = min(until_ps, grid, *(n.next_ps for n in self.nodes))
        return max(self.bus.next_time(first), now + 1)

    def _settle(self, due: set[int], stop: int = 0) -> None:
        """Events at `stop` (ps) until nothing more is to be delivered then; `due`: who has one."""
        for _ in range(_ROUNDS):
            arrived: dict[int, list[Operation]] = {i: [] for i in due}
            for delivery in self.bus.advance(stop):
                arrived.setdefault(delivery.node, []).append(delivery.operation)
            if not arrived:
                return
            due = set()
            for i, operations in sorted(arrived.items()):
                self._log(i, False, operations)
                self._send(i, self.nodes[i].event(encode(operations)))
        raise LsBusError(
            f"found operations after {_ROUNDS} rounds at t = {stop * PS:.9g} s, expected an end"
        )

    def _send(self, node: int, buffers: Sequence[bytes]) -> None:
        for buffer in buffers:
            self._log(node, True, split(buffer))
            self.bus.send(node, buffer)

    def _log(self, node: int, sent: bool, operations: Sequence[Operation | Malformed]) -> None:
        now, name = self.bus.now_ps, self.nodes[node].name
        self.exchanged += [Exchanged(now, name, sent, x) for x in operations]
