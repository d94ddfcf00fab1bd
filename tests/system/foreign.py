"""Other masters with our FMUs: all components use values of the previous tick (Jacobi).

Each takes a plan of FMUs connected by plain wires, and gives every output at 0, h, 2 h, ... The
order in a plan is ignored; values and names are used.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path

import numpy as np
import pytest
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

from cosim.schedule.parts import Step
from cosim.schedule.plan import Plan

Outputs = dict[str, np.ndarray]  # (steps + 1,) by the name of the scalar: "master.q[0]"


def output_names(plan: Plan) -> list[str]:
    """Names of all output scalars."""
    return [name for c in plan.components for slot in c.outputs for name in slot.scalars()]


def wires(plan: Plan) -> list[tuple[str, str]]:
    """(source, target) scalars of all wires."""
    assert not plan.links and all((w.gain, w.offset) == (1.0, 0.0) for w in plan.wires)
    pairs = ((w.source.scalars(), w.target.scalars()) for w in plan.wires)
    return [pair for source, target in pairs for pair in zip(source, target, strict=True)]


def start_values(step: Step) -> dict[str, float]:
    """Parameters and start values of a component, by the name of the scalar inside it."""
    found = {}
    for p in step.component.parameters:
        indices = [",".join(map(str, i)) for i in np.ndindex(p.shape)] if p.shape else []
        names = [f"{p.name}[{i}]" for i in indices] or [p.name]
        if p.name in step.values:
            found |= dict(zip(names, step.values[p.name], strict=True))
    return found


def integers(step: Step) -> set[str]:
    """Names of a component's integer parameters."""
    return {p.name for p in step.component.parameters if p.type == "integer"}


def fmu(step: Step) -> Path:
    """Its file."""
    return Path(step.component.archive.path)  # type: ignore[attr-defined]


# ---- FMPy ---------------------------------------------------------------------------------------


class Slave:
    """One FMU behind FMPy; scalars by name, those of FMI 3.0 arrays too."""

    def __init__(self, step: Step, folder: Path) -> None:
        description = read_model_description(fmu(step))
        self.three = description.fmiVersion.startswith("3")
        self.slave = (FMU3Slave if self.three else FMU2Slave)(
            guid=description.guid,
            unzipDirectory=extract(fmu(step), folder),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=step.name,
        )
        self.variables = {v.name: v for v in description.modelVariables}
        self.values: dict[str, float] = {}  # of inputs
        self.slave.instantiate()

    def start(self, values: dict[str, float]) -> None:
        """Set parameters and start values, and enter Initialization Mode."""
        for name, entries in self._arrays(values).items():
            if self.variables[name].type in ("Integer", "Int32"):
                put = self.slave.setInt32 if self.three else self.slave.setInteger
                put([self.variables[name].valueReference], [int(x) for x in entries])
            else:
                self._put(name, entries)
        if self.three:
            self.slave.enterInitializationMode(startTime=0.0)
        else:
            self.slave.setupExperiment(startTime=0.0)
            self.slave.enterInitializationMode()

    def _arrays(self, values: dict[str, float]) -> dict[str, list[float]]:
        """Entries by variable: one each in FMI 2.0, whole arrays in 3.0."""
        found: dict[str, list[float]] = {}
        for name, value in values.items():
            found.setdefault(name.split("[")[0] if self.three else name, []).append(value)
        return found

    def _put(self, name: str, entries: list[float]) -> None:
        put = self.slave.setFloat64 if self.three else self.slave.setReal
        put([self.variables[name].valueReference], entries)

    def feed(self, values: dict[str, float]) -> None:
        """Set all inputs that are connected."""
        for name, entries in self._arrays(values).items():
            self._put(name, entries)

    def read(self, names: list[str]) -> list[float]:
        """Outputs, scalar by scalar."""
        if not self.three:
            return list(self.slave.getReal([self.variables[n].valueReference for n in names]))
        values: list[float] = []
        for name in dict.fromkeys(n.split("[")[0] for n in names):
            size = prod(int(d.start) for d in self.variables[name].dimensions)
            values += self.slave.getFloat64([self.variables[name].valueReference], size)
        return values


def fmpy(plan: Plan, folder: Path) -> Outputs:
    """FMPy's slaves in the shortest loop there is: give everybody his inputs, then step all."""
    slaves = {c.name: Slave(c, folder / c.name) for c in plan.components}
    names = {
        c.name: [n.split(".", 1)[1] for s in c.outputs for n in s.scalars()]
        for c in plan.components
    }
    fed: dict[str, dict[str, str]] = {c.name: {} for c in plan.components}
    for source, target in wires(plan):
        component, name = target.split(".", 1)
        fed[component][name] = source
    rows: list[dict[str, float]] = []

    def read() -> dict[str, float]:
        return {
            f"{c}.{n}": value
            for c, slave in slaves.items()
            for n, value in zip(names[c], slave.read(names[c]), strict=True)
        }

    def feed(row: dict[str, float]) -> None:
        for c, slave in slaves.items():
            slave.feed({name: row[source] for name, source in fed[c].items()})

    for c in plan.components:
        slaves[c.name].start(start_values(c))
    for _ in plan.components:  # outputs at the start travel along every wire
        feed(read())
    rows.append(read())
    for slave in slaves.values():
        slave.slave.exitInitializationMode()
    for k in range(plan.ticks):
        feed(rows[-1])
        for slave in slaves.values():
            slave.slave.doStep(k * plan.h, plan.h)
        rows.append(read())
    for slave in slaves.values():
        slave.slave.terminate()
        slave.slave.freeInstance()
    return {name: np.array([row[name] for row in rows]) for name in output_names(plan)}


# ---- libcosim -----------------------------------------------------------------------------------


def libcosim(plan: Plan, folder: Path) -> Outputs:
    """libcosim's fixed-step algorithm through libcosimpy; steps are counted in nanoseconds."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.FATAL)
    execution = CosimExecution.from_step_size(round(plan.h * 1e9))
    index, references = {}, {}
    for c in plan.components:
        index[c.name] = execution.add_local_slave(CosimLocalSlave(str(fmu(c)), c.name))
        variables = read_model_description(fmu(c)).modelVariables
        references |= {f"{c.name}.{v.name}": v.valueReference for v in variables}
        for name, value in start_values(c).items():
            put = (
                execution.integer_initial_value
                if name in integers(c)
                else execution.real_initial_value
            )
            cast = int if name in integers(c) else float
            assert put(index[c.name], references[f"{c.name}.{name}"], cast(value))
    for source, target in wires(plan):
        at = [(index[n.split(".", 1)[0]], references[n]) for n in (source, target)]
        assert execution.connect_real_variables(*at[0], *at[1]) == 0
    observer = CosimObserver.create_last_value()
    assert execution.add_observer(observer)

    def read() -> list[float]:
        values: list[float] = []
        for c in plan.components:
            at = [references[n] for s in c.outputs for n in s.scalars()]
            values += observer.last_real_values(index[c.name], at)
        return values

    rows = []
    for _ in range(plan.ticks):
        assert execution.step()
        rows.append(read())
    names = output_names(plan)
    return {name: np.array([row[i] for row in rows]) for i, name in enumerate(names)}


# ---- Ecos ---------------------------------------------------------------------------------------


@contextmanager
def _ecos(plan: Plan) -> Iterator[object]:
    try:
        from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure
    except ImportError as error:
        pytest.fail(f"libtbb12 is installed, so Ecos is to be tested; pip install ecospy: {error}")
    EcosLib.set_log_level("warn")
    with EcosSimulationStructure() as structure:
        for c in plan.components:
            structure.add_model(c.name, str(fmu(c)))
        for source, target in wires(plan):
            structure.make_real_connection(
                source.replace(".", "::", 1), target.replace(".", "::", 1)
            )
        values = {
            f"{c.name}::{name}": int(value) if name in integers(c) else float(value)
            for c in plan.components
            for name, value in start_values(c).items()
        }
        structure.add_parameter_set("start", values)
        with EcosSimulation(plan.h, structure=structure) as simulation:
            simulation.init(parameter_set="start")
            yield simulation
            simulation.terminate()


def ecos(plan: Plan, folder: Path) -> Outputs:
    """Ecos' fixed-step algorithm through ecospy."""
    names = output_names(plan)
    rows = []
    with _ecos(plan) as simulation:
        for k in range(plan.ticks + 1):
            if k:
                simulation.step()  # type: ignore[attr-defined]
            rows.append([simulation.get_real(n.replace(".", "::", 1)) for n in names])  # type: ignore[attr-defined]
    return {name: np.array([row[i] for row in rows]) for i, name in enumerate(names)}
