"""The simulated bus as an FMU, run by FMPy with node FMUs, against the bus inside a plan."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from cosim.base.errors import CosimError
from cosim.bus.timing import BusTiming
from cosim.fmi import FmuComponent
from cosim.fmi.file.validation import problems
from cosim.lsbus.codec import encode, split
from cosim.lsbus.network import CanNetwork
from cosim.lsbus.operations import (
    ArbitrationLost,
    BusFault,
    CanFdTransmit,
    CanTransmit,
    Configuration,
    ConfigurationParameter,
    Confirm,
    FormatError,
    Wakeup,
)
from cosim.lsbus.terminals import read_terminals
from fmus.build.bus_fmu import build_bus
from tests.cosim.lsbus.exporter import KINDS, PARAMETERS, node
from tests.cosim.lsbus.importer import End, Imported, run
from tests.tiers import first_fast

TIMING = BusTiming(500e3)
MS = 10**9
Heard = list[tuple[int, str, object]]


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bus with three nodes."""
    return build_bus(3, TIMING, tmp_path_factory.mktemp("bus") / "bus.fmu")


def integrated(
    folder: Path, kinds: Sequence[str], given: Sequence[Mapping[str, float]], until: int
) -> Heard:
    """What nodes hear from the bus of this project's importer."""
    nodes = [
        node(folder, f"n{i}", k, **g) for i, (k, g) in enumerate(zip(kinds, given, strict=True))
    ]
    with CanNetwork(TIMING, nodes, step=1e-4) as network:
        network.run(until * 1e-12)
    return sorted(
        ((x.time_ps, x.node, x.operation) for x in network.exchanged if not x.sent), key=str
    )


def by_fmu(
    bus: Path, folder: Path, kinds: Sequence[str], given: Sequence[Mapping[str, float]], until: int
) -> Heard:
    """What nodes hear from the bus FMU in FMPy."""
    fmu = Imported(bus, {})
    fmus, pairs = [fmu], []
    for i, (kind, some) in enumerate(zip(kinds, given, strict=True)):
        node(folder, f"n{i}", kind, **some)  # writes the file
        values = {"period": 1e-3, "first": 1e-3, "baud": 500e3, **some, "kind": float(KINDS[kind])}
        numbers = {10 + PARAMETERS.index(k): v for k, v in values.items()}
        fmus.append(Imported(folder / f"n{i}.fmu", numbers, notify=19))
        end = End(fmus[-1], 1, kind)
        if kind == "constant":
            end.period, end.due = round(values["period"] * 1e12), round(values["first"] * 1e12)
        pairs.append((end, End(fmu, 4 * i + 1)))
    log = run(fmus, pairs, until, MS // 10)
    return sorted(
        ((at, f"n{i}", x) for at, i, by_node, raw in log if not by_node for x in split(raw)),
        key=str,
    )


@pytest.mark.parametrize("kind", first_fast(KINDS, 2))
def test_nodes_hear_the_same_at_the_same_times_as_on_the_bus_of_a_plan(
    tmp_path: Path, three: Path, kind: str
) -> None:
    """Two nodes begin in the same instants, a third one waits for a bus in use."""
    kinds = [kind, "countdown", "changing"]
    given = [{"id": 0x120, "bytes": 8, "count": 5}, {"id": 0x100, "bytes": 3, "count": 5},
             {"id": 0x0F0, "bytes": 2, "count": 4, "first": 1.05e-3, "period": 1.1e-3}]  # fmt: skip
    found = by_fmu(three, tmp_path, kinds, given, 8 * MS)
    assert found == integrated(tmp_path, kinds, given, 8 * MS)
    assert sum(isinstance(x, Confirm) for _, _, x in found) == 14
    assert sum(isinstance(x, CanTransmit) for _, _, x in found) == 28


def test_lost_frames_errors_and_unknown_operations_are_told_alike(
    tmp_path: Path, three: Path
) -> None:
    """Nodes 0 and 1 send the same identifier with other data: bit errors until one is passive."""
    given = [{"id": 0x100, "bytes": 8, "count": 3}, {"id": 0x100, "bytes": 7, "count": 3},
             {"id": 0x200, "bytes": 8, "count": 2, "discard": 1, "bad": 1}]  # fmt: skip
    kinds = ["countdown"] * 3
    found = by_fmu(three, tmp_path, kinds, given, 6 * MS)
    assert found == integrated(tmp_path, kinds, given, 6 * MS)
    seen = {type(x) for _, _, x in found}
    assert seen >= {ArbitrationLost, BusFault, FormatError, Confirm, CanTransmit}


def test_fd_frames_and_wake_up_travel_and_other_bit_rates_are_refused(tmp_path: Path) -> None:
    """The bus alone: what terminal 1 is given comes out of terminal 2 at the end of the frame."""
    path = build_bus(2, BusTiming(500e3, 2e6, fd=True), tmp_path / "fd.fmu")
    frame = CanFdTransmit(0x1234567, True, True, False, bytes(range(48)))
    fmu = Imported(path, {})
    fmu.slave.exitInitializationMode()
    one, two = End(fmu, 1), End(fmu, 5)
    one.give(encode([frame, Wakeup()]))
    fmu.slave.updateDiscreteStates()
    for end in (one, two):
        end.ask(False, 0)
    assert (one.due > 0, two.due) == (True, 0)  # the wake-up is there at once
    assert split(two.take(0)) == [Wakeup()]
    fmu.slave.updateDiscreteStates()
    two.ask(True, 0)
    assert one.due == two.due
    fmu.slave.enterStepMode()
    fmu.slave.doStep(0.0, two.due * 1e-12)
    fmu.slave.enterEventMode()
    assert split(two.take(two.due)) == [frame]
    assert split(one.take(one.due)) == [Confirm(0x1234567)]
    fmu.slave.updateDiscreteStates()
    one.give(encode([Configuration(ConfigurationParameter.CAN_BAUDRATE, 250_000)]))
    with pytest.raises(Exception, match="fmi3UpdateDiscreteStates"):
        fmu.slave.updateDiscreteStates()
    fmu.slave.freeInstance()


def test_the_archive_is_valid_complete_and_the_same_each_time(tmp_path: Path, three: Path) -> None:
    assert problems(three) == []
    again = build_bus(3, TIMING, tmp_path / "again.fmu")
    assert again.read_bytes() == three.read_bytes()
    assert list(read_terminals(FmuComponent(three))) == ["Node1", "Node2", "Node3"]
    with zipfile.ZipFile(three) as archive:
        manifest = archive.read("extra/org.fmi-standard.fmi-ls-bus/fmi-ls-manifest.xml").decode()
        assert {"sources/bus.c", "sources/lsbus_fmi3.c"} <= set(archive.namelist())
    assert 'isBusSimulationFMU="true"' in manifest


def test_a_bus_needs_a_number_of_nodes(tmp_path: Path) -> None:
    with pytest.raises(CosimError, match="found 0 nodes, expected 1 to 64"):
        build_bus(0, TIMING, tmp_path / "x.fmu")
