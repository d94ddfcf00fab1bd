"""FMUs with CAN terminals on a bus of a scenario, against the same FMUs on a bus from Python."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.component import Outputs, Port, Values
from cosim.base.errors import CosimError
from cosim.bus.candump import candump_lines
from cosim.bus.settings import ScriptedError
from cosim.bus.timing import BusTiming
from cosim.cli.info import info
from cosim.cli.show import BusAccountOptions, show
from cosim.engine.simulate import simulate
from cosim.lsbus.logs import operation_lines
from cosim.lsbus.network import CanNetwork
from cosim.record import Run
from cosim.scenario.assemble import assemble
from cosim.scenario.bus_traffic import log_source
from cosim.scenario.spec import build
from tests.cosim.lsbus.exporter import KINDS, description, export, node

TIMING = BusTiming(500e3)
STEP, STOP = 1e-3, 8e-3
NODE = {"id": 0x100, "bytes": 4, "count": 5}
OTHER = NODE | {"id": 0x200, "period": 1.5e-3}


class Ramp:
    """A Python component: its output is the number of ms since the start, its input a signal."""

    kind = "sampled"
    inputs = (Port("u"),)
    outputs = (Port("y"), Port("seen"))
    parameters = ()

    def initialize(self, values: Values) -> None:
        """Do nothing: it has no state."""

    def initial(self, u: Values) -> Outputs:
        """Outputs at the start."""
        return self.step(0.0, STEP, u)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """The number of ms."""
        return {"y": np.array(round(t / 1e-3)), "seen": u["u"].copy()}


def component(folder: Path, name: str, kind: str, given: Mapping[str, float]) -> dict[str, Any]:
    values = {"period": 1e-3, "first": 1e-3, "baud": 500e3, **given, "kind": float(KINDS[kind])}
    model = description(kind, values["period"], values["first"])
    path = export(folder / f"{name}.fmu", model)
    return {"model": str(path), "parameters": values, "bus": "can0"}


def document(folder: Path, kind: str = "countdown", **bus: Any) -> dict[str, Any]:
    """Two nodes on a bus."""
    return {
        "run": {"step": STEP, "stop": STOP},
        "bus": {"can0": {"bitrate": 500e3, **bus}},
        "components": {
            "a": component(folder, "a", kind, NODE),
            "b": component(folder, "b", "countdown", OTHER),
        },
    }


def run(folder: Path, given: Mapping[str, Any], name: str = "run") -> Path:
    simulate(build(given, folder / "x.toml"), folder / name)
    return folder / name


@pytest.mark.parametrize("kind", KINDS)
def test_operations_and_times_are_those_of_the_same_nodes_without_a_scenario(
    tmp_path: Path, kind: str
) -> None:
    folder = run(tmp_path, document(tmp_path, kind))
    nodes = [node(tmp_path, "a", kind, **NODE), node(tmp_path, "b", **OTHER)]
    with CanNetwork(TIMING, nodes, step=STEP) as network:
        network.run(STOP)
    assert len(network.bus.frames) == 10
    assert (folder / "can0.operations.tsv").read_text("utf-8") == operation_lines(network)
    assert (folder / "can0.log").read_text("utf-8") == candump_lines(
        ((at, frame) for at, _, frame in network.bus.frames), "can0"
    )
    recorded = Run.open(folder)
    assert recorded.column("a.sent")[-1] == recorded.column("b.sent")[-1] == 5
    log_source(folder / "can0.log", 0, TIMING, 0)  # can be traffic of another bus


def test_the_same_scenario_gives_the_same_bytes(tmp_path: Path) -> None:
    given = document(tmp_path, errors=[{"kind": "rate", "rate": 1e-3}])
    one, two = run(tmp_path, given, "one"), run(tmp_path, given, "two")
    for name in ("can0.log", "can0.operations.tsv", "trajectories.parquet"):
        assert (one / name).read_bytes() == (two / name).read_bytes()
    assert "BusFault" in (one / "can0.operations.tsv").read_text("utf-8")
    assert "a" in Run.open(one).metadata["fmus"]


def test_errors_and_queues_of_the_scenario_are_those_of_the_bus(tmp_path: Path) -> None:
    error = {"kind": "script", "id": 0x100, "bit": 30, "attempt": 1, "node": "a"}
    nodes = {"a": {"one_shot": True}}
    folder = run(tmp_path, document(tmp_path, errors=[error], nodes=nodes))
    text = (folder / "can0.operations.tsv").read_text("utf-8")
    assert text.count("b\treceived\tCanTransmit(identifier=256") == 4
    with CanNetwork(
        TIMING,
        [node(tmp_path, "a", **NODE), node(tmp_path, "b", **OTHER)],
        step=STEP,
        disturbances=[ScriptedError(0x100, 30, node=0)],
    ) as network:
        network.run(STOP)
    assert len(network.bus.frames) == 10


def test_signals_reach_nodes_at_ticks_and_frames_carry_them_to_others(tmp_path: Path) -> None:
    """A frame sent at 2 ms has the input of that tick; a link and a wire connect the rest."""
    given = document(tmp_path)
    given["components"]["ramp"] = {
        "model": f"{__name__}:Ramp", "period": STEP, "inputs": {"u": "b.heard"}
    }  # fmt: skip
    a = given["components"]["a"]
    a["inputs"] = {"smooth": "ramp.y", "jump": "b.sent"}
    a["parameters"] |= {"first": 1.2e-3}
    given["links"] = [
        {"from": "a.sent", "to": "b.smooth", "delay": {"law": "constant", "delay": 2e-3}}
    ]
    folder = run(tmp_path, given)
    text = (folder / "can0.operations.tsv").read_text("utf-8")
    sent = [int(x, 16) for x in re.findall(r"can0 100#(..)", (folder / "can0.log").read_text())]
    # frame k is sent at (1.2 + k) ms: ramp is 1 + k, b has sent this often at the tick before
    times = [1.2e-3 + k * 1e-3 for k in range(5)]
    before = [
        sum(1e-3 + i * 1.5e-3 <= int(t / STEP) * STEP + 1e-9 for i in range(5)) for t in times
    ]
    assert sent == [k + (1 + k) + n for k, n in enumerate(before)]
    recorded = Run.open(folder)
    assert list(recorded.column("b.heard")[2:7]) == sent
    assert list(recorded.column("ramp.seen")) == list(recorded.column("b.heard"))
    assert "b\tsent\tCanTransmit" in text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["components"]["a"].pop("bus"), "found the CAN terminal Powertrain .* without"),
        (lambda d: d["components"]["a"].update(bus="can1"), "no bus 'can1'"),
        (lambda d: d["components"]["a"].update(terminal="Body"), "found no CAN terminal 'Body'"),
        (lambda d: d["components"]["a"].update(isolate=True), "found isolate = true"),
        (lambda d: d["components"]["a"].update(period=2e-3), "expected one period"),
        (lambda d: d["components"]["a"].update(kind="sampled"), "a is sampled"),
        (lambda d: d["run"].update(algorithm="gauss-seidel"), "gauss-seidel"),
        (lambda d: d["bus"]["can0"].update(nodes={"c": {}}), "found the nodes c, expected"),
        (lambda d: d["bus"]["can0"].update(traffic=[{"kind": "babbling", "id": 1}]), "no|traffic"),
        (lambda d: d.update(links=[{"from": "a.sent", "to": "b.smooth", "bus": "can0",
                                    "frame": {"id": 5}}]), "found links on the bus"),
    ],
)  # fmt: skip
def test_what_cannot_be_on_a_bus_is_refused(tmp_path: Path, change: Any, message: str) -> None:
    given = document(tmp_path)
    change(given)
    with pytest.raises(CosimError, match=message):
        assemble(build(given, tmp_path / "x.toml"))


def test_a_node_with_another_bit_rate_stops_the_run_with_the_time(tmp_path: Path) -> None:
    given = document(tmp_path, bitrate=250e3)
    with pytest.raises(CosimError, match=r"CAN_BAUDRATE 500000 bit/s, expected 250000 bit/s"):
        run(tmp_path, given)


def test_info_and_show_name_terminal_and_bus(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (
        str(document(tmp_path)["components"]["a"]["parameters"]).replace("'", "").replace(":", "=")
    )
    (tmp_path / "x.toml").write_text(
        f"[run]\nstep = {STEP}\nstop = {STOP}\n[bus.can0]\nbitrate = 500e3\n"
        f'[components.a]\nmodel = "a.fmu"\nbus = "can0"\nparameters = {text}\n'
    )
    show(tmp_path / "x.toml", BusAccountOptions(), check=False)
    assert "CAN terminal Powertrain on bus can0" in capsys.readouterr().out
    info(str(tmp_path / "a.fmu"), validate=False)
    assert re.search(r"CAN terminals +Powertrain: Tx clock countdown", capsys.readouterr().out)
