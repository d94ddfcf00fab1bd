"""FMUs whose arrays count from 1 in a deployment: messages carry entries by the FMU's own names."""

from __future__ import annotations

from pathlib import Path

from bridge.deployment.system import load_system
from bridge.results.outcome import run_twin
from cosim.record import Run
from tests.cosim.fmi.plain import counted, export

SCENARIO = """
[run]
step = 0.01
stop = 0.1
[components.k]
model = "plain.fmu"
kind = "sampled"
parameters = { p = [10, 20, 30] }
inputs = { "f[2]" = "m.now" }
[components.m]
model = "plain.fmu"
inputs = { "f[1]" = "k.r[3]", "f[3]" = "k.r[1]" }
"""
DEPLOYMENT = """
[nodes.a]
components = ["k"]
number = 1
[nodes.b]
components = ["m"]
number = 2
[buses.net]
kind = "zenoh"
[messages.one]
carries = ["k.r[3]", "k.r[1]"]
max_age = "1 s"
bus = "net"
[messages.two]
carries = ["m.now"]
max_age = "1 s"
bus = "net"
"""


def test_values_arrive_where_the_names_say(tmp_path: Path) -> None:
    export(tmp_path / "plain.fmu", counted(1))
    (tmp_path / "s.toml").write_text(SCENARIO)
    (tmp_path / "d.toml").write_text(DEPLOYMENT)
    system = load_system(tmp_path / "s.toml", str(tmp_path / "d.toml"))
    run = Run.open(run_twin(system, tmp_path / "run", []))
    last = {name: run.column(name)[-1] for name in run.names if name.startswith("m.r")}
    assert last == {"m.r[1]": 30.0, "m.r[2]": 0.0, "m.r[3]": 10.0}
