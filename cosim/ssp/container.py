"""A whole scenario as one FMU 2.0: a container, made by fmu-manipulation-toolbox.

Inside, all components read the previous step (Jacobi), and links are delay FMUs. FMUs of one period
step together; a container of faster FMUs is one FMU among the slower ones and makes several steps
per step. The periods must therefore be multiples of each other, and the outermost step is the
longest. Outputs are named ``component_output``; unconnected inputs keep their start values.
"""

from __future__ import annotations

import importlib
import logging
import shutil
import tempfile
from collections.abc import Container
from itertools import pairwise
from pathlib import Path
from typing import Any

from cosim.base.errors import FmuError, ScenarioError
from cosim.fmi import FmuComponent
from cosim.scenario.spec import Scenario
from cosim.schedule.parts import Link, Slot, Step, Wire
from cosim.schedule.plan import Plan
from cosim.ssp.delays import build_delays
from cosim.ssp.export import fmu_of
from cosim.ssp.parameters import literal

_TOOL = "fmu_manipulation_toolbox"


def write(scenario: Scenario, plan: Plan, out: str | Path) -> list[str]:
    """Write one FMU of a scenario and its plan; returns what is different inside of it.

    Raises ScenarioError for what a container cannot hold, FmuError where the tool is missing or
    fails.
    """
    out = Path(out)
    periods = sorted({c.period for c in plan.components})
    for fast, slow in pairwise(periods):
        if slow % fast:
            raise ScenarioError(
                f"components step every {fast} and every {slow} ticks; in a container a period "
                "must be a multiple of every shorter one",
                str(scenario.path),
            )
    try:
        assembly = importlib.import_module(f"{_TOOL}.assembly")
    except ImportError:
        message = f"a container needs {_TOOL}: pip install {_TOOL.replace('_', '-')}"
        raise FmuError(message) from None
    _make(assembly, scenario, plan, out)
    notes = [] if plan.algorithm == "jacobi" else ["inside, everybody sees the last step (jacobi)"]
    if periods[-1] > 1:
        notes.append(f"its step is the longest period, {periods[-1] * plan.h:g} s, or a multiple")
    if plan.players or any(x.age is not None for x in plan.links):
        notes.append("weights, tables, events and ages of links keep their start value")
    return notes


def _make(assembly: Any, scenario: Scenario, plan: Plan, out: Path) -> None:
    """Have the tool make the container. Raises FmuError."""
    with tempfile.TemporaryDirectory(prefix="container-") as scratch:
        folder = Path(scratch)
        levels = _Levels(assembly, plan)
        _fill(levels, scenario, plan, folder)
        logger = logging.getLogger(_TOOL)
        level = logger.level
        try:
            logger.setLevel(logging.ERROR)  # it reports every input that nothing feeds
            levels.nodes[-1].make_fmu(folder)
            out.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / levels.nodes[-1].name, out)
        except Exception as error:  # the tool's own kinds, and those of the file system
            raise FmuError(f"{out}: {_TOOL} failed: {error}") from error
        finally:
            logger.setLevel(level)


class _Levels:
    """Containers by period, the fastest first: each is an FMU in the next."""

    def __init__(self, assembly: Any, plan: Plan) -> None:
        periods = sorted({c.period for c in plan.components})
        self._level = {c.name: periods.index(c.period) for c in plan.components}
        names = {p: _free(f"inside_{p}", self._level) for p in periods[:-1]}
        names[periods[-1]] = _free("loop", self._level)
        self.nodes = [
            assembly.AssemblyNode(
                _file(names[period]), step_size=period * plan.h,
                auto_link=False, auto_input=False, auto_output=False,
            )
            for period in periods
        ]  # fmt: skip
        for inner, outer in pairwise(self.nodes):
            outer.add_sub_node(inner)

    def add(self, component: str, beside: str = "") -> Any:
        """The node a component is in (a delay: where the component `beside` it is), with it."""
        level = self._level.setdefault(component, self._level.get(beside, 0))
        self.nodes[level].add_fmu(_file(component))
        return self.nodes[level]

    def publish(self, component: str, port: str) -> None:
        """Give an output to all that is further outside, as ``component_output``."""
        name = f"{component}_{port}"
        where, called = _file(component), port
        for node in self.nodes[self._level[component] :]:
            node.add_output(where, called, name)
            where, called = node.name, name

    def join(self, source: tuple[str, str], target: tuple[str, str]) -> None:
        """Connect an output to an input, through the containers that are between them."""
        a, b = self._level[source[0]], self._level[target[0]]
        top = max(a, b)
        start = (_file(source[0]), source[1])
        if a < top:
            start = (self.nodes[top - 1].name, "_".join(source))
        end = (_file(target[0]), target[1])
        for node in self.nodes[b:top]:
            node.add_input("_".join(target), *end)
            end = (node.name, "_".join(target))
        self.nodes[top].add_link(*start, *end)


def _fill(levels: _Levels, scenario: Scenario, plan: Plan, folder: Path) -> None:
    """FMUs, start values, connections and outputs of the container."""
    for step in plan.components:
        fmu = fmu_of(step, scenario)
        shutil.copyfile(fmu.archive.path, folder / _file(step.name))
        _values(levels.add(step.name), step, fmu)
        for scalar in (name for slot in step.outputs for name in slot.scalars()):
            levels.publish(*scalar.split(".", 1))
    for wire in plan.wires:
        _join(levels, wire, wire.source, wire.target, scenario)
    delays = build_delays(scenario, plan, folder, rates=True)
    for link in plan.links:
        name = delays[link.name].name.split(".")[0]
        delays[link.name].rename(folder / _file(name))
        levels.add(name, beside=link.target.component)
        size, unit = link.target.size, link.target.unit
        u, y = (Slot(f"{name}.{p}", name, p, 0, (size,), unit) for p in "uy")
        _join(levels, link, link.source, u, scenario)
        _join(levels, Wire(y, link.target), y, link.target, scenario)


def _free(name: str, taken: Container[str]) -> str:
    """A name that no component has."""
    return name if name not in taken else _free(f"{name}_", taken)


def _file(component: str) -> str:
    return f"{component}.fmu"


def _values(node: Any, step: Step, fmu: FmuComponent) -> None:
    for name, numbers in {**step.values, **step.start}.items():
        group = fmu.groups[name]
        for variable, value in zip(group.variables, numbers, strict=True):
            node.add_start_value(_file(step.name), variable.name, literal(group, value))


def _join(
    levels: _Levels, edge: Wire | Link, source: Slot, target: Slot, scenario: Scenario
) -> None:
    """Connect two slots, scalar by scalar. Raises ScenarioError for a gain, which it has not."""
    if (edge.gain, edge.offset) != (1.0, 0.0):
        raise ScenarioError(
            f"{source.name} -> {target.name} has gain {edge.gain:g} and offset {edge.offset:g} "
            "(or converts a unit), and a container only copies",
            str(scenario.path),
        )
    for start, end in zip(source.scalars(), target.scalars(), strict=True):
        (a, output), (b, name) = start.split(".", 1), end.split(".", 1)
        levels.join((a, output), (b, name))
