"""FMUs with CAN terminals on a simulated bus, against the bus driven directly."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from cosim.base.errors import CosimError
from cosim.bus.frames import BusEvent, BusFrame, ControllerState
from cosim.bus.settings import BusNodeSettings, Disturbance, ScriptedError
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming
from cosim.fmi import FmuComponent
from cosim.lsbus.network import CanNetwork
from cosim.lsbus.node import NodeFmu
from cosim.lsbus.operations import (
    ArbitrationLost,
    BusFault,
    CanTransmit,
    Confirm,
    FormatError,
    LsBusError,
    NodeStatus,
    StatusReport,
)
from tests.cosim.lsbus.exporter import KINDS, TERMINALS, description, export, member, node

TIMING = BusTiming(500e3)
MS = 10**9
Sent = Sequence[tuple[int, int, BusFrame]]


def direct(requests: Sent, until: int, *disturbances: Disturbance) -> list[tuple[int, int, object]]:
    """(time, node, operation) of frames and confirmations, of requests (time, node, frame)."""
    bus = SimulatedBus(
        TIMING, [BusNodeSettings(n) for n in ("a", "b", "c")], disturbances=disturbances
    )
    for at, who, frame in requests:
        bus.request(who, at, frame)
    found: list[tuple[int, int, object]] = []
    frames: dict[int, BusFrame] = {i: f for i, (_, _, f) in enumerate(requests)}
    for e in bus.advance(until):
        if e["kind"] in (BusEvent.SENT, BusEvent.RECEIVED):
            f = frames[int(e["request"])]
            sent = e["kind"] == BusEvent.SENT
            what = Confirm(f.identifier) if sent else CanTransmit(f.identifier, data=f.data)
            found.append((int(e["time"]), int(e["node"]), what))
    return sorted(found, key=str)


def run(nodes: Sequence[NodeFmu], until: float, *disturbances: Disturbance) -> CanNetwork:
    with CanNetwork(TIMING, nodes, step=1e-4, disturbances=disturbances) as network:
        network.run(until)
    return network


def heard(network: CanNetwork) -> list[tuple[int, int, object]]:
    names = [n.name for n in network.nodes]
    return sorted(
        (
            (x.time_ps, names.index(x.node), x.operation)
            for x in network.exchanged
            if not x.sent and isinstance(x.operation, Confirm | CanTransmit)
        ),
        key=str,
    )


def data(k: int, n: int) -> bytes:
    return bytes((k + i) % 256 for i in range(n))


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_tx_clock_gives_the_frames_and_times_of_the_bus(
    tmp_path: Path, kind: str
) -> None:
    """Two nodes send in the same instants, five times: arbitration decides."""
    nodes = [
        node(tmp_path, "a", kind, id=0x300, bytes=8, count=5),
        node(tmp_path, "b", "countdown", id=0x100, bytes=3, count=5),
        node(tmp_path, "c", kind),
    ]
    network = run(nodes, 7e-3)
    requests = [
        (k * MS + MS, who, BusFrame(i, data(k, n)))
        for k in range(5)
        for who, i, n in ((0, 0x300, 8), (1, 0x100, 3))
    ]
    assert heard(network) == direct(requests, 7 * MS)
    assert network.bus.remarks == []


def test_times_between_the_steps_are_kept(tmp_path: Path) -> None:
    """A clock that counts down ticks at its time, whatever the step."""
    nodes = [node(tmp_path, "a", id=1, count=3, first=123.456e-6, period=345.678e-6),
             node(tmp_path, "b"), node(tmp_path, "c")]  # fmt: skip
    found = heard(run(nodes, 2e-3))
    times = [123_456_000 + k * 345_678_000 for k in range(3)]
    assert found == direct([(t, 0, BusFrame(1)) for t in times], 2 * MS)


def test_a_lost_arbitration_reaches_the_fmu_that_asked_for_it(tmp_path: Path) -> None:
    nodes = [node(tmp_path, "a", id=0x300, count=1, discard=1), node(tmp_path, "b", id=1, count=1),
             node(tmp_path, "c")]  # fmt: skip
    network = run(nodes, 3e-3)
    lost = [x for x in network.exchanged if isinstance(x.operation, ArbitrationLost)]
    assert [(x.node, x.operation) for x in lost] == [("a", ArbitrationLost(0x300))]
    assert heard(network) == direct([(MS, 1, BusFrame(1))], 3 * MS)


def test_a_disturbed_frame_is_told_and_sent_again(tmp_path: Path) -> None:
    error = ScriptedError(0x55, bit=25)
    network = run([node(tmp_path, "a", id=0x55, bytes=8, count=1), node(tmp_path, "b"),
                   node(tmp_path, "c")], 3e-3, error)  # fmt: skip
    assert heard(network) == direct([(MS, 0, BusFrame(0x55, data(0, 8)))], 3 * MS, error)
    faults = [x for x in network.exchanged if isinstance(x.operation, BusFault)]
    assert sorted(x.node for x in faults) == ["a", "b", "c"]


def test_a_node_says_that_it_is_bus_off_when_the_bus_says_so(tmp_path: Path) -> None:
    always = ScriptedError(0x55, bit=25, attempt=0)
    network = run([node(tmp_path, "a", id=0x55, bytes=8, count=9), node(tmp_path, "b"),
                   node(tmp_path, "c")], 8e-3, always)  # fmt: skip
    said = [x.operation for x in network.exchanged if x.node == "a" and x.sent
            and isinstance(x.operation, StatusReport)]  # fmt: skip
    assert said == [StatusReport(NodeStatus.ERROR_PASSIVE), StatusReport(NodeStatus.BUS_OFF)]
    faults = [x.time_ps for x in network.exchanged if x.node == "a" and not x.sent]
    assert len(faults) == 32 and 4 * MS < faults[-1] < 5 * MS
    # The bus has let it back after 1408 bits; frames of before are discarded, and no new ones come.
    state = network.bus.bus.state(0)
    assert (state.state, state.tec, state.pending) == (ControllerState.ACTIVE, 0, 0)
    assert network.bus.remarks == []


def test_bytes_that_are_no_operation_come_back(tmp_path: Path) -> None:
    network = run([node(tmp_path, "a", bad=1), node(tmp_path, "b")], 1e-3)
    back = [x for x in network.exchanged if isinstance(x.operation, FormatError)]
    assert [(x.node, x.time_ps) for x in back] == [("a", 0)]
    assert "found code 0x77" in network.bus.remarks[0].text


def test_another_bit_rate_is_refused(tmp_path: Path) -> None:
    nodes = [node(tmp_path, "a", baud=250e3), node(tmp_path, "b")]
    with pytest.raises(
        LsBusError, match=r"node a, .* found CAN_BAUDRATE 250000 bit/s, expected 500"
    ):
        run(nodes, 1e-3)


def test_the_cut_of_the_run_changes_nothing(tmp_path: Path) -> None:
    def nodes() -> list[NodeFmu]:
        return [node(tmp_path, "a", id=3, bytes=8, count=9, first=1e-4, period=2.5e-4),
                node(tmp_path, "b", "changing", id=2, bytes=2, count=9, period=3e-4)]  # fmt: skip

    whole = run(nodes(), 4e-3)
    with CanNetwork(TIMING, nodes(), step=1e-4) as cut:
        for k in range(1, 13):
            cut.run(4e-3 * k / 12)
    assert cut.exchanged == whole.exchanged and len(whole.exchanged) > 30


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (member("Rx_Data"), "", "found the members Rx_Clock, Tx_Clock, Tx_Data, expected Tx_Data"),
        ("bus.transceiver", "bus.other", "found matchingRule 'org.fmi-ls-bus.other', expected"),
        ("Powertrain.Tx_Data", "nowhere", "member 'Tx_Data' is 'nowhere', expected a variable"),
        ("Powertrain.Tx_Clock", "Powertrain.Rx_Clock", "does not belong to the clock"),
        ('<Terminal name="Powertrain"', '<Terminal name="Body"',
         "found no CAN terminal 'Powertrain', expected one of: Body"),
    ],
)  # fmt: skip
def test_terminals_against_the_standard_are_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in TERMINALS
    model = description("countdown", 1.0, 1.0)
    path = export(tmp_path / "x.fmu", model, TERMINALS.replace(old, new))
    with pytest.raises(CosimError, match=f"x: .*{message}"):
        NodeFmu(FmuComponent(path, "x"), "Powertrain")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("fmi-ls-bus.can;", "fmi-ls-bus.lin;", "has mimeType .*expected 'application/"),
        ('hasEventMode="true"', "", "found an FMU without hasEventMode, expected one with it"),
        ('canHandleVariableCommunicationStepSize="true"', "", "found an FMU without canHandle"),
    ],
)
def test_fmus_that_are_no_nodes_are_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    model = description("countdown", 1.0, 1.0)
    assert old in model
    path = export(tmp_path / "x.fmu", model.replace(old, new))
    with pytest.raises(CosimError, match=message):
        NodeFmu(FmuComponent(path, "x"), "Powertrain")


def test_every_node_is_freed_also_when_one_cannot_be(tmp_path: Path) -> None:
    nodes = [node(tmp_path, name, id=1, count=0) for name in ("a", "b")]
    closed = []

    def refuse() -> None:
        closed.append("b")
        raise LsBusError("found an FMU that cannot be freed, expected one that can")

    nodes[1].close = refuse  # type: ignore[method-assign]
    nodes[0].close = lambda: closed.append("a")  # type: ignore[method-assign]
    with pytest.raises(LsBusError, match="freed"), CanNetwork(TIMING, nodes, step=1e-3):
        pass
    assert closed == ["b", "a"]
