"""A whole scenario as one FMU 2.0: a container, made by fmu-manipulation-toolbox.

Inside everybody sees the last step (Jacobi), all FMUs step together, and links are delay FMUs.
Outputs are called ``component_output``; inputs that nothing feeds keep their start value.
"""

from __future__ import annotations

import importlib
import logging
import shutil
import tempfile
from pathlib import Path
from typing import Any

from cosim.errors import FmuError, ScenarioError
from cosim.fmi import FmuComponent
from cosim.plan import Link, Plan, Slot, Step, Wire
from cosim.scenario import Scenario
from cosim.ssp.delays import build_delays
from cosim.ssp.export import fmu_of, literal

_TOOL = "fmu_manipulation_toolbox"


def write(scenario: Scenario, plan: Plan, out: Path) -> list[str]:
    """Write one FMU of a scenario and its plan; returns what is different inside of it.

    Raises ScenarioError for what a container cannot hold, FmuError where the tool is missing or
    fails.
    """
    slow = [c.name for c in plan.components if c.period != 1]
    if slow:
        raise ScenarioError(
            f"{', '.join(slow)} step at their own period, and a container steps all together; "
            "leave out the period, or set run.step to it",
            str(scenario.path),
        )
    try:
        assembly = importlib.import_module(f"{_TOOL}.assembly")
    except ImportError:
        message = f"a container needs {_TOOL}: pip install {_TOOL.replace('_', '-')}"
        raise FmuError(message) from None
    _make(assembly, scenario, plan, out)
    notes = [] if plan.algorithm == "jacobi" else ["inside, everybody sees the last step (jacobi)"]
    if plan.players or any(x.age is not None for x in plan.links):
        notes.append("weights of a topology and ages of links keep their start value")
    return notes


def _make(assembly: Any, scenario: Scenario, plan: Plan, out: Path) -> None:
    """Have the tool make the container. Raises FmuError."""
    with tempfile.TemporaryDirectory(prefix="container-") as scratch:
        folder = Path(scratch)
        node = assembly.AssemblyNode(
            "loop.fmu", step_size=plan.h, auto_link=False, auto_input=False, auto_output=False
        )
        _fill(node, scenario, plan, folder)
        logger = logging.getLogger(_TOOL)
        level = logger.level
        try:
            logger.setLevel(logging.ERROR)  # it reports every input that nothing feeds
            node.make_fmu(folder)
            out.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / "loop.fmu", out)
        except Exception as error:  # the tool's own kinds, and those of the file system
            raise FmuError(f"{out}: {_TOOL} failed: {error}") from error
        finally:
            logger.setLevel(level)


def _fill(node: Any, scenario: Scenario, plan: Plan, folder: Path) -> None:
    """FMUs, start values, connections and outputs of the container."""
    for step in plan.components:
        fmu = fmu_of(step, scenario)
        shutil.copyfile(fmu.archive.path, folder / _file(step.name))
        node.add_fmu(_file(step.name))
        _values(node, step, fmu)
    for wire in plan.wires:
        _join(node, wire, wire.source, wire.target, scenario)
    delays = build_delays(scenario, plan, folder)
    for link in plan.links:
        name = delays[link.name].name.split(".")[0]
        delays[link.name].rename(folder / _file(name))
        node.add_fmu(_file(name))
        size, unit = link.target.size, link.target.unit
        u, y = (Slot(f"{name}.{p}", name, p, 0, (size,), unit) for p in "uy")
        _join(node, link, link.source, u, scenario)
        _join(node, Wire(y, link.target), y, link.target, scenario)
    for step in plan.components:
        for scalar in (name for slot in step.outputs for name in slot.scalars()):
            node.add_output(_file(step.name), scalar.split(".", 1)[1], scalar.replace(".", "_", 1))


def _file(component: str) -> str:
    return f"{component}.fmu"


def _values(node: Any, step: Step, fmu: FmuComponent) -> None:
    for name, numbers in {**step.values, **step.start}.items():
        group = fmu.groups[name]
        for variable, value in zip(group.variables, numbers, strict=True):
            node.add_start_value(_file(step.name), variable.name, literal(group, value))


def _join(node: Any, edge: Wire | Link, source: Slot, target: Slot, scenario: Scenario) -> None:
    """Connect two slots, scalar by scalar. Raises ScenarioError for a gain, which it has not."""
    if (edge.gain, edge.offset) != (1.0, 0.0):
        raise ScenarioError(
            f"{source.name} -> {target.name} has gain {edge.gain:g} and offset {edge.offset:g} "
            "(or converts a unit), and a container only copies",
            str(scenario.path),
        )
    for start, end in zip(source.scalars(), target.scalars(), strict=True):
        (a, output), (b, name) = start.split(".", 1), end.split(".", 1)
        node.add_link(_file(a), output, _file(b), name)
