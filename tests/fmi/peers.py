"""Other importers on one FMU or SSP, each as its guide uses it: FMPy, libcosim, Ecos, and ours.

``python -m tests.fmi.peers PEER JOB`` runs one of them in a process of its own, since some end the
process, and prints what came out as JSON. :func:`outcome` starts it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PEERS = ("cosim", "FMPy", "libcosim", "Ecos")


@dataclass(frozen=True, slots=True)
class Outcome:
    """Results of a run: outputs at every step by name, `error` of a peer, and its exit status."""

    rows: dict[str, list[float]] = field(default_factory=dict)
    error: str = ""
    status: int = 0

    @property
    def good(self) -> bool:
        """True if it ended as it should."""
        return not self.error and self.status == 0

    def last(self, name: str) -> float:
        """The last value of an output; not a number if there is none."""
        return self.rows[name][-1] if self.rows.get(name) else float("nan")


def outcome(
    peer: str, path: Path, steps: int, h: float, values: Mapping[str, float], outputs: list[str],
    calls: Path | None = None,
) -> Outcome:  # fmt: skip
    """Run an FMU or SSP in a peer, `steps` of `h` (s), with `values` set before the start."""
    job = json.dumps([str(path), steps, h, dict(values), outputs])
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    if calls is not None:
        environment["FMI_CALLS"] = str(calls)
    done = subprocess.run(
        [sys.executable, "-m", "tests.fmi.peers", peer, job],
        capture_output=True, text=True, check=False, timeout=100, env=environment, cwd=path.parent,
    )  # fmt: skip
    last = done.stdout.strip().rpartition("\n")[2]
    try:
        said = json.loads(last.partition("RESULT ")[2])
    except ValueError:
        said = {"rows": {}, "error": (done.stderr.strip().splitlines() or [""])[-1][:200]}
    return Outcome(said["rows"], said["error"], done.returncode)


def cosim(path: str, steps: int, h: float, values: dict[str, float], outputs: list[str]) -> Any:
    from cosim.engine.engine import Engine
    from cosim.loading.files import load
    from cosim.scenario.assemble import assemble

    settings = [f"run.step={h}", f"run.stop={steps * h}"]
    if path.endswith(".fmu"):
        settings += [f"{k}={v}" for k, v in values.items()]
    plan = assemble(load(Path(path), settings))
    slots = {
        n.partition(".")[2] if path.endswith(".fmu") else n: s.start + i
        for s in plan.slots().values()
        for i, n in enumerate(s.scalars())
    }
    rows: dict[str, list[float]] = {name: [] for name in outputs}
    with Engine(plan) as engine:
        engine.initialize()
        for k in range(plan.ticks + 1):
            if k and engine.ended is None:
                engine.run(1)
            for name in outputs:
                rows[name].append(float(engine.signals[slots[name]]))
    return rows


def FMPy(path: str, steps: int, h: float, values: dict[str, float], outputs: list[str]) -> Any:
    import fmpy
    from fmpy.ssp.simulation import simulate_ssp

    if path.endswith(".ssp"):
        found = simulate_ssp(path, stop_time=steps * h, step_size=h)
    else:
        found = fmpy.simulate_fmu(
            path, validate=False, stop_time=steps * h, step_size=h, output_interval=h,
            start_values=values, output=outputs,
        )  # fmt: skip
    return {name: [float(x) for x in found[name]] for name in outputs}


def libcosim(path: str, steps: int, h: float, values: dict[str, float], outputs: list[str]) -> Any:
    from fmpy import read_model_description
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.FATAL)
    references: dict[str, tuple[int, int]] = {}
    if path.endswith(".ssp"):
        execution = CosimExecution.from_ssp_file(path, round(h * 1e9))
        for name in outputs:
            part, _, variable = name.partition(".")
            slave = execution.slave_index_from_instance_name(part)
            there = {v.name.decode(): v.reference for v in execution.slave_variables(slave)}
            references[name] = slave, there[variable]
    else:
        execution = CosimExecution.from_step_size(round(h * 1e9))
        slave = execution.add_local_slave(CosimLocalSlave(path, "x"))
        assert slave >= 0, "add_local_slave failed"
        variables = {v.name: v for v in read_model_description(path, validate=False).modelVariables}
        for name, value in values.items():
            whole = variables[name].type in ("Integer", "Enumeration")
            put = execution.integer_initial_value if whole else execution.real_initial_value
            put(slave, variables[name].valueReference, int(value) if whole else float(value))
        references = {name: (slave, variables[name].valueReference) for name in outputs}
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    rows: dict[str, list[float]] = {name: [] for name in outputs}
    for _ in range(steps):
        assert execution.step(), "step failed"
        for name, (slave, reference) in references.items():
            rows[name].append(observer.last_real_values(slave, [reference])[0])
    return rows


def Ecos(path: str, steps: int, h: float, values: dict[str, float], outputs: list[str]) -> Any:
    from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure
    from fmpy import read_model_description

    EcosLib.set_log_level("off")
    rows: dict[str, list[float]] = {name: [] for name in outputs}
    if path.endswith(".ssp"):
        with EcosSimulation(h, ssp_path=path) as simulation:
            simulation.init(parameter_set="initialValues")
            _stepped(simulation, steps, rows, {n: n.replace(".", "::", 1) for n in outputs})
        return rows
    types = {v.name: v.type for v in read_model_description(path, validate=False).modelVariables}
    with EcosSimulationStructure() as structure:
        structure.add_model("x", path)
        given = {
            f"x::{k}": int(v) if types[k] in ("Integer", "Int32") else float(v)
            for k, v in values.items()
        }
        structure.add_parameter_set("start", given)
        with EcosSimulation(h, structure=structure) as simulation:
            simulation.init(parameter_set="start")
            _stepped(simulation, steps, rows, {n: f"x::{n}" for n in outputs})
            simulation.terminate()
    return rows


def _stepped(simulation: Any, steps: int, rows: dict[str, list[float]], names: Any) -> None:
    for k in range(steps + 1):
        if k:
            simulation.step()
        for name, full in names.items():
            rows[name].append(simulation.get_real(full))


def main() -> None:
    peer, job = sys.argv[1:]
    said: dict[str, Any] = {"rows": {}, "error": ""}
    try:
        said["rows"] = globals()[peer](*json.loads(job))
    except Exception as error:
        said["error"] = f"{type(error).__name__}: {error}"[:300] or "failed"
    print("RESULT " + json.dumps(said), flush=True)


if __name__ == "__main__":
    main()
