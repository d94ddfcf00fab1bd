"""Nodes of a deployment as network FMUs: frames and trajectories equal those of the twin."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.deployment.system import System, load_system
from bridge.export import node_fmu
from bridge.export.kernels import kernels
from bridge.export.node_fmu import check, export_nodes, notes
from cosim.base.errors import CosimError, FmuError, ScenarioError
from cosim.bus.timing import BusTiming
from cosim.cli.export import FirmwareOptions, NodeFmuOptions, RunFileOptions, SystemOptions, export
from cosim.fmi import FmuComponent
from cosim.fmi.file.validation import problems
from cosim.fmi.options import FmuOptions
from cosim.lsbus.codec import encode, split
from cosim.lsbus.network import CanNetwork
from cosim.lsbus.node import NodeFmu
from cosim.lsbus.operations import (
    CanFdTransmit,
    CanTransmit,
    Configuration,
    Confirm,
    FormatError,
)
from cosim.lsbus.terminals import read_terminals
from fmus.build.archive import write_archive
from fmus.build.bus_fmu import build_bus
from fmus.build.kernel import Kernel
from fmus.models import planar2r
from tests.bridge.deployments import TELEOPERATION, named
from tests.bridge.export.nodes import (
    Frames,
    bare,
    heard_on_buses,
    logged,
    one_bus,
    rebuilt,
    received_ps,
    rounded,
    run_nodes,
    system,
    trajectories,
    twin_frames,
    twin_rows,
    without_binaries,
)
from tests.cosim.lsbus.importer import End, Imported, run

STOP = 0.06
MS = 10**9


class Built:
    """All nodes of a deployment as FMUs, and the frames of its twin."""

    def __init__(self, folder: Path, found: System) -> None:
        self.system, self.folder = found, folder
        self.fmus = {p.stem: p for p in export_nodes(found, list(found.nodes), folder / "fmus")}
        self.frames = twin_frames(found, folder / "twin")


@pytest.fixture(scope="module")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> Built:
    """The deployment of the project, with guards, drives, services and delays."""
    folder = tmp_path_factory.mktemp("shipped")
    return Built(folder, system(folder, one_bus(), STOP))


# ---- frames and trajectories ------------------------------------------------------------------


@pytest.mark.slow
def test_frames_and_trajectories_are_those_of_the_twin(shipped: Built, tmp_path: Path) -> None:
    """Every frame at its time with its bytes; every output at every slot."""
    folder = run_nodes(shipped.system, shipped.fmus, tmp_path)
    assert logged(folder) == rounded(shipped.frames)
    assert received_ps(folder) == [1000 * t for t, _, _ in shipped.frames]
    identifiers = {frame[1] for frame in shipped.frames}
    assert identifiers >= {0x080, 0x4A1, 0x4A3, 0x3A2, 0x3A4, 0x701, 0x702}
    for node in ("master", "slave"):
        for output in (f"{node}.q", f"{node}.dq"):
            found = trajectories(folder, node, output)
            assert np.array_equal(found[:-1], twin_rows(shipped.system, tmp_path, node, output))
    for node in ("master_control", "slave_control"):
        for output in (f"{node}.tau", f"{node}.xi", f"{node}.theta_hat"):
            wanted = twin_rows(shipped.system, tmp_path, node, output)
            found = trajectories(folder, node, output)
            assert np.array_equal(found[1::5], wanted)  # a slot ends 0.5 ms after its tick
            assert np.ptp(found[:, 0]) > 0.0


@pytest.mark.parametrize(
    "name", ["can-one-bus", pytest.param("can-classic", marks=pytest.mark.slow)]
)
def test_frames_of_a_bare_deployment_are_those_of_the_twin(name: str, tmp_path: Path) -> None:
    """Samples alone: CAN FD with Profile 5, and classic CAN with Profile 2."""
    built = Built(tmp_path, system(tmp_path, bare(one_bus(name)), STOP))
    folder = run_nodes(built.system, built.fmus, tmp_path / "run")
    assert logged(folder) == rounded(built.frames)
    assert len(built.frames) >= 4 * 12


@pytest.mark.slow
def test_nodes_of_several_components_with_weights_over_time_are_those_of_the_twin(
    tmp_path: Path,
) -> None:
    """Six nodes with robot and controller: two kernels in one library, wires between them."""
    found = named("network-can", "run.stop=0.1")
    assert {len(node.plan.components) for node in found.nodes.values()} == {2}
    assert all(node.plan.players for node in found.nodes.values())
    built = Built(tmp_path, found)
    folder = run_nodes(found, built.fmus, tmp_path / "run")
    assert logged(folder) == rounded(built.frames)
    wanted = twin_rows(found, tmp_path / "rows", "robot3", "robot3.q")
    assert np.array_equal(trajectories(folder, "robot3", "robot3.q")[:-1], wanted)


@pytest.mark.slow
def test_two_instances_in_one_process_do_not_touch_each_other(shipped: Built) -> None:
    """One alone, and one with steps of another between its steps."""
    sent = []
    for both in (False, True):
        nodes = [NodeFmu(FmuComponent(shipped.fmus["slave"], f"n{i}")) for i in range(1 + both)]
        timing = BusTiming(1e6, 5e6, fd=True)
        with ExitStack() as stack:
            networks = [stack.enter_context(CanNetwork(timing, [n], step=1e-3)) for n in nodes]
            for k in range(1, 21):
                for i, network in enumerate(networks):
                    network.run(k * 1e-3 * (1 + 2 * i))
            sent.append([(x.time_ps, x.operation) for x in networks[0].exchanged if x.sent])
    assert sent[0] == sent[1]
    assert len(sent[0]) > 5


def in_fmpy(found: System, fmus: Mapping[str, Path], folder: Path) -> dict[str, Frames]:
    """Frames by bus, in an importer and on bus FMUs that share no code with those of a scenario."""
    d, slaves = found.deployment, {name: Imported(path, {}) for name, path in fmus.items()}
    pairs, on, buses = [], [], []
    for name, spec in d.buses.items():
        nodes = [node for node in fmus if name in found.buses_of(node)]
        timing = BusTiming(spec.bitrate, spec.data_bitrate if spec.fd else None, spec.fd)
        buses.append(Imported(build_bus(len(nodes), timing, folder / f"{name}.fmu"), {}))
        for i, node in enumerate(nodes):
            terminal = found.buses_of(node).index(name)
            pairs.append((End(slaves[node], 4 * terminal + 1), End(buses[-1], 4 * i + 1)))
            on.append(name)
    log = run([*buses, *slaves.values()], pairs, round(STOP * 1e12), MS)
    heard: dict[str, set[tuple[int, int, bytes]]] = {name: set() for name in d.buses}
    for at, pair, by_node, raw in log:
        for x in split(raw) if not by_node else []:
            if isinstance(x, CanTransmit | CanFdTransmit):
                heard[on[pair]].add((at // 1000, x.identifier, x.data))
    return {name: sorted(frames) for name, frames in heard.items()}


@pytest.mark.slow
def test_frames_are_the_same_with_fmpy_and_the_bus_fmu(shipped: Built, tmp_path: Path) -> None:
    assert in_fmpy(shipped.system, shipped.fmus, tmp_path) == {"arms": shipped.frames}


@pytest.mark.slow
def test_nodes_on_two_buses_have_two_terminals(tmp_path: Path) -> None:
    """Both controllers of can.toml: a bus an arm, and each hears xi on the bus of the other."""
    found = named("can", f"run.stop={STOP}")
    fmus = {p.stem: p for p in export_nodes(found, list(found.nodes), tmp_path)}
    assert problems(fmus["slave_control"]) == []
    assert list(read_terminals(FmuComponent(fmus["slave_control"]))) == ["left", "right"]
    heard = in_fmpy(found, fmus, tmp_path)
    assert heard == heard_on_buses(found, tmp_path / "twin")
    assert min(map(len, heard.values())) >= 2 * 12


@pytest.mark.slow
@pytest.mark.parametrize(
    ("node", "file", "old", "new"),
    [
        ("master", "outlet.c", "header.counter = (uint32_t)sequence;",
         "header.counter = (uint32_t)sequence + 1;"),
        ("master_control", "node_data.c", ".h_ns = 5000000, .phase_ns = 5",
         ".h_ns = 5000000, .phase_ns = 6"),
        ("master_control", "inlet.c", "target[k] = in->gain * value[k] + in->offset;",
         "target[k] = 1.01 * in->gain * value[k] + in->offset;"),
    ],
    ids=["counter", "phase", "gain"],
)  # fmt: skip
def test_a_mutant_is_noticed(
    shipped: Built, tmp_path: Path, node: str, file: str, old: str, new: str
) -> None:
    path = rebuilt(shipped.fmus[node], tmp_path / f"{node}.fmu", file, old, new)
    folder = run_nodes(shipped.system, {**shipped.fmus, node: path}, tmp_path)
    assert logged(folder) != rounded(shipped.frames)


@pytest.mark.slow
def test_a_component_that_fails_stops_the_run_with_its_sentence(
    shipped: Built, tmp_path: Path
) -> None:
    old, new = "return model_step((Model *)x, t, h);", 'return t > 0.0025 ? "it broke" : '
    path = rebuilt(
        shipped.fmus["master"], tmp_path / "master.fmu", "planar2r/kernel.c", old, new + old[7:]
    )
    with pytest.raises(CosimError, match=r"master, t = 0\.003 s: it broke"):
        run_nodes(shipped.system, {"master": path}, tmp_path)


@pytest.mark.slow
def test_nodes_in_webassembly_have_the_frames_of_the_twin(shipped: Built, tmp_path: Path) -> None:
    """The FMU that `--wasm` writes, without its sources and native binaries."""
    nodes = NodeFmuOptions(deploy="can-one-bus", nodes=tmp_path, wasm=True)
    export(
        TELEOPERATION,
        RunFileOptions(),
        SystemOptions(),
        nodes,
        FirmwareOptions(),
        [f"run.stop={STOP}"],
    )
    fmus = {}
    for path in tmp_path.glob("*.fmu"):
        with zipfile.ZipFile(path) as archive:
            names = [n for n in archive.namelist() if not n.startswith("sources/")]
            kept = [n for n in names if "wasm" in n or not n.startswith("binaries/")]
            fmus[path.stem] = tmp_path / "alone" / path.name
            write_archive({n: archive.read(n) for n in kept}, fmus[path.stem])
    assert len(fmus) == 4
    folder = run_nodes(shipped.system, fmus, tmp_path / "run")
    assert logged(folder) == rounded(shipped.frames)


# ---- the FMU alone ----------------------------------------------------------------------------


@pytest.mark.slow
def test_the_archive_is_valid_complete_and_the_same_each_time(
    shipped: Built, tmp_path: Path
) -> None:
    for path in shipped.fmus.values():
        assert problems(path) == []
    path = shipped.fmus["master"]
    (again,) = export_nodes(shipped.system, ["master"], tmp_path)
    assert again.read_bytes() == path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        names = set(archive.namelist())
        manifest = archive.read("extra/org.fmi-standard.fmi-ls-bus/fmi-ls-manifest.xml").decode()
    assert 'isBusSimulationFMU="false"' in manifest
    assert {"sources/slot.c", "sources/node_data.c", "sources/planar2r/planar2r.c"} <= names
    (unit,) = {p.unit for p in FmuComponent(path).outputs if p.name == "master.q"}
    assert unit == "rad"


@pytest.mark.slow
def test_its_sources_alone_make_the_same_frames(shipped: Built, tmp_path: Path) -> None:
    """Sent at the start, with the binary and with one that the importer compiles."""
    sent = []
    alone = without_binaries(shipped.fmus["slave"], tmp_path / "alone.fmu")
    for path in (shipped.fmus["slave"], alone):
        fmu = FmuComponent(path, "slave", options=FmuOptions(build=True))
        timing = BusTiming(1e6, 5e6, fd=True)
        with CanNetwork(timing, [NodeFmu(fmu)], step=1e-3) as network:
            network.run(0.5e-3)
            sent.append([x.operation for x in network.exchanged if x.sent])
    assert sent[0] == sent[1]
    kinds = [Configuration, Configuration, CanFdTransmit, CanTransmit]  # rates, STATE, heartbeat
    assert [type(x) for x in sent[0]] == kinds


@pytest.mark.slow
def test_another_bit_rate_is_refused_and_unknown_operations_go_back(shipped: Built) -> None:
    fmu = FmuComponent(shipped.fmus["master"], "master")
    with (
        CanNetwork(BusTiming(500e3), [NodeFmu(fmu)], step=1e-3) as network,
        pytest.raises(CosimError, match="1000000"),
    ):
        network.run(1e-3)
    alone = Imported(shipped.fmus["master"], {})
    alone.slave.exitInitializationMode()
    end = End(alone, 1)
    end.give(encode([Confirm(0x4A1)]) + b"\x77\0\0\0\x0c\0\0\0????")
    alone.slave.updateDiscreteStates()
    end.ask(False, 0)
    found = split(end.take(0))
    assert sum(isinstance(x, FormatError) for x in found) == 1
    alone.slave.updateDiscreteStates()
    first = alone.slave.getFloat64([6], nValues=2)
    alone.slave.enterStepMode()
    alone.slave.doStep(0.0, 0.01)
    alone.slave.reset()
    alone.slave.enterInitializationMode()
    assert alone.slave.getFloat64([6], nValues=2) == first
    alone.slave.freeInstance()


# ---- what is refused --------------------------------------------------------------------------


def refused(name: str, node: str) -> str:
    with pytest.raises(ScenarioError) as error:
        check(named(name), node)
    return str(error.value)


def test_nodes_that_cannot_be_such_an_fmu_are_refused() -> None:
    gateway = next(n for n, s in named("gateway").deployment.nodes.items() if not s.components)
    assert "found a gateway, expected a node that forwards nothing" in refused("gateway", gateway)
    assert "found bus" in refused("zenoh", "master")
    assert "found no node 'nobody', expected one of master, " in refused("can", "nobody")


def test_a_component_without_kernel_and_too_many_delays_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = load_system(TELEOPERATION, "can-one-bus", ["run.stop=0.02"])
    monkeypatch.setattr(node_fmu, "DRAWN", 3)
    with pytest.raises(
        ScenarioError, match=r"found 4 delays of the link to .*, expected at most 3"
    ):
        export_nodes(found, ["master_control"], tmp_path)
    with pytest.raises(
        FmuError, match=r"component arm: found .*Kernel, Python call-back, expected"
    ):
        kernels([("arm", Kernel(planar2r.model()))])


def test_a_link_between_components_of_one_node_is_refused(tmp_path: Path) -> None:
    found = one_bus()
    both = ["master_control", "slave_control"]
    found["nodes"]["master_control"]["components"] = both
    del found["nodes"]["slave_control"], found["nodes"]["master_control"]["stale"]
    with pytest.raises(ScenarioError, match="found a link between its components, expected wires"):
        export_nodes(system(tmp_path, found, 0.02), ["master_control"], tmp_path)


def test_what_an_fmu_does_differently_is_said() -> None:
    found = notes(named("can-one-bus"), "master_control")
    assert any('queue = "fifo"' in note for note in found)
    assert any("drawn for 60 s" in note for note in found)
    assert any("2 CAN terminals (left, right)" in n for n in notes(named("can"), "master_control"))
    assert not any("drawn" in note for note in notes(named("can-one-bus"), "master"))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"nodes": Path("x")}, "expected --deploy NAME --nodes FOLDER"),
        ({"deploy": "can"}, "expected --deploy NAME --nodes FOLDER"),
        ({"ssp": Path("x.ssp"), "node": ["master"]}, "expected --deploy NAME --nodes FOLDER"),
        ({"ssp": Path("x.ssp"), "wasm": True}, "expected --deploy NAME --nodes FOLDER"),
        ({}, "expected --ssp FILE, --fmu FILE, --nodes FOLDER"),
        ({"deploy": "can", "nodes": Path("x"), "node": ["me"]}, "found no node 'me', expected one"),
    ],
)
def test_the_command_says_what_it_expected(given: dict[str, Any], said: str) -> None:
    with pytest.raises(ScenarioError, match=said):
        export(
            TELEOPERATION,
            RunFileOptions(),
            SystemOptions(ssp=given.get("ssp")),
            NodeFmuOptions(**{k: v for k, v in given.items() if k != "ssp"}),
            FirmwareOptions(),
        )
