"""Containers: FMUs wired into one FMU, which any master can step. FMPy's (Rust), fmucontainer (C).

A container is built once and kept under the user's cache, by what is in it; building is not timed.
FMPy steps both: one ``doStep`` a tick, as a master does that looks at results, or one for many
ticks, which leaves the container alone with its FMUs.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import struct
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, final

from benchmarks.ours import Ours
from benchmarks.peers import Absent, Ecos, Unit, Variable, imported, units
from cosim.base.archive import cache_folder
from cosim.base.clock import stopwatch
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build as scenario
from cosim.schedule.plan import Plan

Build = Callable[[Sequence[Unit], float, Path], None]


def rust(wired: Sequence[Unit], h: float, target: Path) -> None:
    """FMPy's container of `wired` with internal step `h` (s). Raises Absent where it cannot."""
    described = imported("fmpy.model_description")
    config, cli = imported("fmpy.container_fmu.config"), imported("fmpy.container_fmu.cli")
    three = wired[0].fmi == "3.0"
    components, known = [], []
    with tempfile.TemporaryDirectory(prefix="container-") as name:
        for unit in wired:
            path = shutil.copyfile(unit.path, Path(name, f"{unit.name}.fmu"))
            read = described.read_model_description(path, validate=False)
            components.append(config.Component(unit.name, path, read))
            for v in read.modelVariables:  # a container's own names of types, which are FMI 3.0's
                v.type = {"Real": "Float64", "Integer": "Int32"}.get(v.type, v.type)
            known.append({v.name: v for v in read.modelVariables})
        links, mapped = [], {}
        for unit, component, own in zip(wired, components, known, strict=True):
            if unit.source is not None:
                origin, others = wired[unit.source], known[unit.source]
                links.append(
                    config.Connection(
                        components[unit.source], [others[v.name] for v in origin.outputs],
                        component, [own[v.name] for v in unit.inputs],
                    )
                )  # fmt: skip
            for v, causality in _exposed(unit):
                outside = _outside(described, three, unit, v, causality)
                mapped[outside] = [(component, own[v.name])]
        whole = _whole(described, three, h, list(mapped))
        folder = Path(name, "unpacked")
        folder.mkdir()
        configuration = config.Configuration(False, whole, components, links, mapped)
        cli.create_container_fmu(configuration, folder, target)


def _exposed(unit: Unit) -> list[tuple[Variable, str]]:
    """What a container shows of a unit; an output's start value is set through a parameter."""
    outputs = [(v, "output") for v in unit.outputs]
    return outputs + [(v, "parameter") for v in unit.start]


def _shown(unit: Unit, v: Variable) -> str:
    """What an output is called outside; fmucontainer's links have the plain name already."""
    return f"out.{unit.name}.{v.name}"


def _outside(described: Any, three: bool, unit: Unit, v: Variable, causality: str) -> Any:
    """A variable of the container, standing for `v` of `unit`."""
    if v.size > 1:
        raise Absent("FMPy writes no start values of arrays into a container")
    number = "Float64" if v.real else "Int32"
    fixed = causality == "parameter"
    start = (repr(v.values[0]) if v.real else str(int(v.values[0]))) if fixed else None
    return described.ModelVariable(
        name=f"start.{unit.name}.{v.name}" if fixed else _shown(unit, v),
        type=number if three else {"Float64": "Real", "Int32": "Integer"}[number],
        causality=causality,
        variability="tunable" if fixed else "continuous" if v.real else "discrete",
        initial="exact" if fixed else "calculated",
        start=start,
    )


def _time(described: Any, three: bool) -> Any:
    """The independent variable, which the container has and expects first."""
    return described.ModelVariable(
        name="time",
        type="Float64" if three else "Real",
        causality="independent",
        variability="continuous",
    )


def _whole(described: Any, three: bool, h: float, variables: list[Any]) -> Any:
    """The model description of a container."""
    token = "{" + hashlib.sha256(repr([v.name for v in variables]).encode()).hexdigest()[:32] + "}"
    return described.ModelDescription(
        fmiVersion="3.0" if three else "2.0",
        modelName="container",
        instantiationToken=token,
        coSimulation=described.CoSimulation(
            modelIdentifier="container_fmu",
            canHandleVariableCommunicationStepSize=True,
            fixedInternalStepSize=h,
        ),
        modelVariables=[_time(described, three), *variables],  # reference 0 is time's
        outputs=[described.Unknown(variable=v) for v in variables if v.causality == "output"],
    )


def renault(wired: Sequence[Unit], h: float, target: Path) -> None:
    """The container that fmucontainer makes of `wired` with internal step `h` (s), one thread."""
    toolbox = imported("fmu_manipulation_toolbox.container")
    with tempfile.TemporaryDirectory(prefix="container-") as name:
        for unit in wired:
            shutil.copyfile(unit.path, Path(name, f"{unit.name}.fmu"))
        made = toolbox.FMUContainer("container", name, fmi_version=int(float(wired[0].fmi)))
        for unit in wired:
            for v in unit.outputs:
                made.add_output(f"{unit.name}.fmu", v.name, _shown(unit, v))
            for v in unit.start:
                texts = [repr(x) if v.real else str(int(x)) for x in v.values]
                made.add_start_value(f"{unit.name}.fmu", v.name, " ".join(texts))
            if unit.source is not None:
                origin = wired[unit.source]
                for a, b in zip(origin.outputs, unit.inputs, strict=True):
                    made.add_link(f"{origin.name}.fmu", a.name, f"{unit.name}.fmu", b.name)
        made.make_fmu("container.fmu", step_size=h)
        shutil.move(Path(name, "container.fmu"), target)


def kept(build: Build, wired: Sequence[Unit], h: float) -> Path:
    """The container of these units, built unless it is there."""
    facts: list[object] = [build.__name__, h, _shown(wired[0], wired[0].outputs[0])]
    for unit in wired:
        facts.append([unit.name, hashlib.sha256(unit.path.read_bytes()).hexdigest()])
        facts.append([repr(unit.inputs), repr(unit.outputs), repr(unit.start), unit.source])
    key = hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:32]
    path = cache_folder() / "benchmarks" / f"{key}.fmu"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        build(wired, h, path)
    return path


def alone(plan: Plan, build: Build) -> Plan:
    """The container of a plan as the only component of another: for masters that loop in C.

    Raises Absent where the container cannot be built.
    """
    path = kept(build, units(plan), plan.h)
    document = {
        "run": {"step": plan.h, "stop": 1000.0},
        "components": {"container": {"model": str(path)}},
    }
    return assemble(scenario(document, path.with_suffix(".toml")))


def in_engine(plan: Plan, recorded: bool, build: Build) -> Ours:
    """The container in the engine of this project."""
    return Ours(alone(plan, build), plan.ticks if recorded else 0)


def in_ecos(plan: Plan, recorded: bool, build: Build) -> Ecos:
    """The container in Ecos, which loops in C++ and records into CSV."""
    return Ecos(alone(plan, build), recorded)


@final
class Container:
    """A session of a container, stepped by FMPy: `together`, all ticks of a block in one step.

    `recorded`: all outputs, read every tick into a list of rows. Raises Absent where the
    container cannot be built or does not start.
    """

    def __init__(self, plan: Plan, recorded: bool, build: Build, together: bool = False) -> None:
        fmpy = imported("fmpy")
        self._h, self._k, self._recorded, self._together = plan.h, 0, recorded, together
        try:
            path = kept(build, units(plan), plan.h)
            self._folder = tempfile.TemporaryDirectory(prefix="container-")
            self._start(fmpy, path, units(plan))
        except Absent:
            raise
        except Exception as error:  # whatever a foreign builder raises is its reason
            raise Absent(f"{type(error).__name__}: {str(error).splitlines()[0]}") from error
        self._rows: list[Any] = []

    def _start(self, fmpy: Any, path: Path, wired: Sequence[Unit]) -> None:
        description = fmpy.read_model_description(str(path), validate=False)
        three = description.fmiVersion.startswith("3")
        make = imported("fmpy.fmi3").FMU3Slave if three else imported("fmpy.fmi2").FMU2Slave
        self._fmu = fmu = make(
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(path), self._folder.name),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="container",
        )
        fmu.instantiate()
        if three:
            fmu.enterInitializationMode(startTime=0.0)
        else:
            fmu.setupExperiment(startTime=0.0)
            fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        outside = {v.name: v.valueReference for v in description.modelVariables}
        references = [outside[_shown(u, v)] for u in wired for v in u.outputs]
        n = sum(v.size for u in wired for v in u.outputs)
        self._read: Callable[[], list[float]] = (
            (lambda: fmu.getFloat64(references, n)) if three else lambda: fmu.getReal(references)
        )

    def run(self, ticks: int) -> float:
        """Go on for `ticks` ticks; returns s."""
        h, step, read = self._h, self._fmu.doStep, self._read
        self._rows.clear()
        watch = stopwatch()
        if self._together:
            step(self._k * h, ticks * h)
        elif self._recorded:
            for k in range(self._k, self._k + ticks):
                self._rows.append(read())
                step(k * h, h)
        else:
            for k in range(self._k, self._k + ticks):
                step(k * h, h)
        seconds = watch()
        self._k += ticks
        return seconds

    def outputs(self) -> bytes:
        """The outputs of all FMUs as they are."""
        y = self._read()
        return struct.pack(f"={len(y)}d", *y)

    def recorded(self, n: int) -> bytes:
        """In a form of its own."""
        return b""

    def close(self) -> None:
        """Free the container."""
        self._fmu.terminate()
        self._fmu.freeInstance()
        self._folder.cleanup()
