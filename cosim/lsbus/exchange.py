"""The bus that the operations of FMI-LS-BUS are addressed to: :class:`SimulatedBus` behind them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, final

from cosim.bus.frames import BusEvent, BusFrame, ControllerState, DropCause, ErrorRole
from cosim.bus.settings import BusNodeSettings, Disturbance
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming, FrameFormat
from cosim.lsbus.codec import Malformed, split
from cosim.lsbus.operations import (
    ArbitrationLost,
    BusErrorCode,
    BusErrorFlag,
    BusFault,
    CanFdTransmit,
    CanTransmit,
    Configuration,
    ConfigurationParameter,
    Confirm,
    FormatError,
    LostArbitration,
    LsBusError,
    NodeStatus,
    Operation,
    StatusReport,
    Wakeup,
)

_DELIVERED = (BusEvent.SENT, BusEvent.RECEIVED, BusEvent.ERROR, BusEvent.LOST)
_RECORDED = (*_DELIVERED, BusEvent.STARTED, BusEvent.DROPPED)
_STATES = {
    ControllerState.PASSIVE: NodeStatus.ERROR_PASSIVE,
    ControllerState.OFF: NodeStatus.BUS_OFF,
}
#: A Format Error says in 16 bits how long the faulty operation is.
_LONGEST_FAULTY = 0xFFFF


class Delivery(NamedTuple):
    """An operation for a node, and when it gets it, ps."""

    time_ps: int
    node: int
    operation: Operation


@dataclass(frozen=True, slots=True)
class BusRemark:
    """Something a node should not have sent, which does not end the run: when, ps, and why."""

    time_ps: int
    node: str
    text: str


@final
class OperationBus:
    """A simulated CAN bus whose nodes send and receive operations.

    `nodes`: their names, numbered from 0; `notified`: which of them get Confirm, Arbitration Lost
    and Bus Error (`BusNotifications` of the standard), all where None; `settings`: those of nodes
    that differ from a sorted queue of `queue_length` frames. The bus counts errors of
    its nodes itself; what a node says in Status is compared with that and kept in `remarks` where
    it differs, as are operations that could not be decoded.
    """

    def __init__(
        self,
        timing: BusTiming,
        nodes: Sequence[str],
        *,
        notified: Sequence[bool] | None = None,
        disturbances: Sequence[Disturbance] = (),
        seed: int = 0,
        queue_length: int = 64,
        settings: Mapping[str, BusNodeSettings] | None = None,
    ) -> None:
        given = settings or {}
        all_ = [given.get(n) or BusNodeSettings(n, queue_length=queue_length) for n in nodes]
        self.bus = SimulatedBus(
            timing, all_, disturbances=disturbances, seed=seed, record=_RECORDED
        )
        self.names = tuple(nodes)
        #: Frames that were sent and acknowledged so far: when (ps), by which node, and what.
        self.frames: list[tuple[int, int, BusFrame]] = []
        self.remarks: list[BusRemark] = []
        self._notified = [True] * len(nodes) if notified is None else list(notified)
        self._discards = [False] * len(nodes)
        self._off = [False] * len(nodes)
        self._requests: dict[int, tuple[int, BusFrame]] = {}
        self._contenders: dict[int, BusFrame] = {}
        self._started = -1
        self._waiting: list[Delivery] = []

    @property
    def now_ps(self) -> int:
        """The time of the last `advance`, ps."""
        return self.bus.now_ps

    def send(self, node: int, buffer: bytes) -> None:
        """Take the operations of a node's Tx_Data, at `now_ps`.

        Bytes that are no operation are sent back as Format Error. Raises LsBusError for operations
        that this bus cannot carry out.
        """
        for item in split(buffer):
            if isinstance(item, Malformed):
                self._send_back(node, item)
            else:
                self._take(node, item)

    def next_time(self, until_ps: int) -> int:
        """The time at which the next operation is due if no node sends anything, at most
        `until_ps`.
        """
        if self._waiting:
            return self.now_ps
        return self.bus.next_event(until_ps, _DELIVERED)

    def advance(self, until_ps: int) -> list[Delivery]:
        """Go on to `until_ps`; returns what nodes get until then, in the order of time.

        The result does not depend on how the time is cut into calls. Raises LsBusError for a
        transmit queue that is full.
        """
        found, self._waiting = self._waiting, []
        while True:
            part = self.bus.next_event(until_ps, _DELIVERED) if any(self._discards) else until_ps
            for event in self.bus.advance(part):
                found += self._delivered(event)
            if part == until_ps:
                return found

    # ---- what nodes send ---------------------------------------------------------------------

    def _take(self, node: int, operation: Operation) -> None:
        match operation:
            case CanTransmit() | CanFdTransmit():
                self._transmit(node, operation)
            case Configuration(parameter, value):
                self._configure(node, parameter, value)
            case StatusReport(status):
                self._compare(node, status)
            case Wakeup():
                others = (i for i in range(len(self.names)) if i != node)
                self._waiting += [Delivery(self.now_ps, i, operation) for i in others]
            case FormatError(raw):
                self._remark(node, f"refused an operation that the bus sent: {raw.hex()}")
            case _:
                raise self._error(node, f"found {operation}, expected what a node sends to a bus")

    def _transmit(self, node: int, operation: CanTransmit | CanFdTransmit) -> None:
        if isinstance(operation, CanFdTransmit) and not self.bus.timing.fd:
            raise self._error(
                node, "found CAN FD Transmit, expected CAN Transmit: the bus has no data bit rate"
            )
        if self._off[node]:
            raise self._error(
                node, f"found {type(operation).__name__} after the status BUS_OFF, expected none"
            )
        frame = frame_of_operation(operation)
        self._requests[self.bus.request(node, self.now_ps, frame)] = node, frame

    def _configure(self, node: int, parameter: ConfigurationParameter, value: int) -> None:
        timing = self.bus.timing
        if parameter == ConfigurationParameter.ARBITRATION_LOST_BEHAVIOR:
            self._discards[node] = value == LostArbitration.DISCARD_AND_NOTIFY
            return
        rates = {ConfigurationParameter.CAN_BAUDRATE: timing.bitrate}
        if timing.fd:
            rates[ConfigurationParameter.CAN_FD_BAUDRATE] = timing.data_bitrate or timing.bitrate
        if parameter not in rates:
            what = "a CAN FD bus" if timing.fd else "a classic CAN bus"
            raise self._error(node, f"found {parameter.name} {value}, expected none: it is {what}")
        if value != rates[parameter]:
            raise self._error(
                node,
                f"found {parameter.name} {value} bit/s, expected {rates[parameter]:.10g} bit/s, the"
                " bit rate of the bus",
            )

    def _compare(self, node: int, said: NodeStatus) -> None:
        self._off[node] = said == NodeStatus.BUS_OFF
        if self._off[node]:
            for request in [r for r, (sender, _) in self._requests.items() if sender == node]:
                self.bus.abort(node, request)
        state = self.bus.state(node)
        own = _STATES.get(state.state, NodeStatus.ERROR_ACTIVE)
        if said != own:
            self._remark(
                node,
                f"found status {said.name}, expected {own.name}: the bus counts TEC {state.tec},"
                f" REC {state.rec}",
            )

    def _send_back(self, node: int, item: Malformed) -> None:
        if len(item.raw) > _LONGEST_FAULTY:
            raise self._error(
                node,
                f"{item.reason}; found {len(item.raw)} bytes to send back, expected at most"
                f" {_LONGEST_FAULTY}",
            )
        self._remark(node, item.reason)
        self._waiting.append(Delivery(self.now_ps, node, FormatError(item.raw)))

    def _remark(self, node: int, text: str) -> None:
        self.remarks.append(BusRemark(self.now_ps, self.names[node], text))

    def _error(self, node: int, text: str) -> LsBusError:
        return LsBusError(f"node {self.names[node]}, t = {self.now_ps * 1e-12:.9g} s: {text}")

    # ---- what the bus tells them -------------------------------------------------------------

    def _delivered(self, event: Any) -> list[Delivery]:
        """The operation that an event of the bus is for its node; none or one."""
        node, request, at = int(event["node"]), int(event["request"]), int(event["time"])
        operation: Operation | None = None
        match BusEvent(int(event["kind"])):
            case BusEvent.STARTED:
                self._start(node, request, at)
            case BusEvent.RECEIVED:
                return [Delivery(at, node, operation_of_frame(self.bus.frame(event)))]
            case BusEvent.SENT:
                frame = self._requests.pop(request)[1]
                self.frames.append((at, node, frame))
                operation = Confirm(frame.identifier)
            case BusEvent.LOST:
                self._contenders.pop(node, None)
                if self._discards[node] and self.bus.abort(node, request):
                    operation = ArbitrationLost(self._requests[request][1].identifier)
            case BusEvent.ERROR:
                operation = self._fault(event)
            case BusEvent.DROPPED:
                self._requests.pop(request, None)
                self._check_drop(node, event)
        return [Delivery(at, node, operation)] if operation and self._notified[node] else []

    def _check_drop(self, node: int, event: Any) -> None:
        """Raises LsBusError for a frame that did not fit, not for one that was discarded."""
        if event["code"] == DropCause.OVERFLOW:
            raise self._error(
                node,
                f"found a frame more than the {self.bus.nodes[node].queue_length} that its"
                " transmit queue holds, expected fewer",
            )

    def _start(self, node: int, request: int, at: int) -> None:
        if at != self._started:
            self._contenders = {}
        self._started = at
        self._contenders[node] = self._requests[request][1]

    def _fault(self, event: Any) -> BusFault | None:
        """A Bus Error; None for errors outside of a frame."""
        node, role = int(event["node"]), int(event["role"])
        frame = self._contenders.get(node) or next(iter(self._contenders.values()), None)
        if frame is None:
            return None
        primary = bool(role & ErrorRole.PRIMARY)
        return BusFault(
            frame.identifier,
            BusErrorCode(int(event["code"])),
            BusErrorFlag.PRIMARY if primary else BusErrorFlag.SECONDARY,
            bool(role & ErrorRole.SENDER),
        )


def frame_of_operation(operation: CanTransmit | CanFdTransmit) -> BusFrame:
    """The frame that an operation asks for; a remote frame asks for as many bytes as it has."""
    data = operation.data
    if isinstance(operation, CanFdTransmit):
        kind = FrameFormat(operation.extended, True, operation.brs, False, operation.esi)
        return BusFrame(operation.identifier, data, kind)
    kind = FrameFormat(operation.extended, remote=operation.remote)
    if operation.remote:
        return BusFrame(operation.identifier, b"", kind, len(data))
    return BusFrame(operation.identifier, data, kind)


def operation_of_frame(frame: BusFrame) -> CanTransmit | CanFdTransmit:
    """The operation by which receivers learn of a frame; a remote frame has zeros as data."""
    f = frame.format
    if f.fd:
        return CanFdTransmit(frame.identifier, f.extended, f.brs, f.esi, frame.data)
    data = bytes(frame.length) if f.remote else frame.data
    return CanTransmit(frame.identifier, f.extended, f.remote, data)
