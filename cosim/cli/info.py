"""``cosim info``: properties, signals and requirements of an FMU, a model or a scene of MuJoCo."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Mapping
from pathlib import Path
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Annotated

import typer

from cosim.base.extras import cure, is_there
from cosim.base.names import extent
from cosim.base.units import time_text
from cosim.cli.options import Json, write_json

if TYPE_CHECKING:
    from cosim.base.component import Component, Parameter, Port
    from cosim.fmi.component import FmuComponent
    from cosim.fmi.file.variables import FmuVariable


#: Columns of the table of variables of an FMU, and of ports of anything else.
VARIABLES = ("signal", "causality", "type", "unit", "start", "description")
PORTS = ("signal", "causality", "unit", "start", "description")


def info(
    model: Annotated[
        str,
        typer.Argument(
            help="FMU file (.fmu), model as in a scenario (fmus.models.planar2r, module:Class), or "
            "mujoco:FILE for a scene of MuJoCo."
        ),
    ],
    validate: Annotated[
        bool, typer.Option("--validate/--no-validate", help="Validate an FMU with FMPy as well.")
    ] = True,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit with 1 if validation finds a problem.")
    ] = False,
    json: Json = None,
) -> None:
    """Print the ports and units of an FMU, a model or a scene of MuJoCo; validate an FMU."""
    from cosim.cli.show import aligned

    component = _component(model)
    facts, columns, rows = _contents(component)
    width = _columns()
    for line in aligned([list(fact) for fact in facts]):
        typer.echo("\n".join(_folded(line[2:], width, 2 + max(len(name) for name, _ in facts))))
    typer.echo("")
    for line in aligned([columns, *rows]):
        typer.echo("\n".join(_folded(line, width, 6)))
    found = _problems(component) if validate else None
    if json is not None:
        signals = [dict(zip(columns, row, strict=True)) for row in rows]
        write_json(json, "info", {**dict(facts), "signals": signals, "problems": found})
    if found and strict:
        raise typer.Exit(1)


def _columns() -> int:
    """The columns of the terminal; 0 if the output is none, whose lines are not folded."""
    return get_terminal_size().columns if sys.stdout.isatty() else 0


def _folded(line: str, width: int, indent: int) -> list[str]:
    """A line of a table in parts of at most `width` columns, 0: as it is.

    The further parts are indented by `indent` columns, if that leaves half of the width.
    """
    if not width or len(line) <= width:
        return [line]
    gap = " " * (indent if indent <= width // 2 else 2)
    return textwrap.wrap(line, width, subsequent_indent=gap, break_on_hyphens=False)


def _component(model: str) -> Component:
    """The component that a scenario would make of a model. Raises CosimError."""
    from cosim.fmi import FmuComponent
    from cosim.mujoco import PREFIX, scene_path
    from cosim.mujoco.component import MujocoComponent
    from cosim.scenario.models import load_component
    from cosim.scenario.spec import ComponentSpec

    if model.startswith(PREFIX):
        return MujocoComponent(scene_path(model, Path()))
    if model.endswith(".fmu") or "/" in model or Path(model).exists():
        return FmuComponent(Path(model))
    return load_component("component", ComponentSpec(model=model), Path(), "argument")[0]


Contents = tuple[list[tuple[str, str]], tuple[str, ...], list[list[str]]]


def _contents(component: Component) -> Contents:
    """Facts of a component, and the columns and rows of the table of its signals."""
    from cosim.fmi.components import fmu_of
    from cosim.mujoco.component import MujocoComponent

    fmu = fmu_of(component)
    if fmu is not None:
        return _facts(fmu), VARIABLES, _signals(fmu)
    facts: list[tuple[str, str]] = [("kind", component.kind)]
    if isinstance(component, MujocoComponent):
        facts += [*component.scene.facts(), *component.scene.counts()]
        facts += [("remark", remark) for remark in component.remarks({})]
    rows = [
        [_name(p), causality, p.unit, "", p.description]
        for causality, ports in (("input", component.inputs), ("output", component.outputs))
        for p in ports
    ]
    rows += [
        [_name(p), "start", p.unit, " ".join(f"{x:g}" for x in p.default), p.description]
        for p in component.parameters
    ]
    return facts, PORTS, rows


def _name(port: Port | Parameter) -> str:
    return port.name + extent(port.shape, port.base)


def _signals(component: FmuComponent) -> list[list[str]]:
    rows = []
    clocks = {v.reference: v.name for v in component.description.variables if v.type == "Clock"}
    for group in component.groups.values():
        v = group.first
        start = " ".join(f"{float(t):g}" if _is_number(t) else t for t in group.start)
        rows.append(
            [group.name + extent(group.shape, group.base), v.causality, _type(v, clocks), v.unit,
             start, v.description]
        )  # fmt: skip
    return rows


def _type(v: FmuVariable, clocks: Mapping[int, str]) -> str:
    """``Float64 of fast, slow`` for what belongs to clocks, ``Clock constant`` for one."""
    kind = f"Clock {v.attributes.get('intervalVariability', '')}" if v.type == "Clock" else v.type
    belongs = ", ".join(clocks.get(r, str(r)) for r in v.clocks)
    return f"{kind} of {belongs}" if belongs else kind


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _facts(component: FmuComponent) -> list[tuple[str, str]]:
    from cosim.fmi.file.binaries import has_sources

    d = component.description
    binaries = component.archive.folder / "binaries"
    platforms = sorted(_platform(p.name) for p in binaries.glob("*") if p.is_dir())
    flags = sorted(name for name, on in d.flags.items() if on)
    return [
        ("model", f"{d.name} - {d.description}" if d.description else d.name),
        ("FMI", f"{d.fmi} {_interfaces(component)}"),
        ("kind", component.kind + ("" if d.kind else " (assumed; set `kind` in the scenario)")),
        ("token", d.token),
        ("made by", d.tool or "unknown"),
        ("sha256", component.archive.sha256),
        ("platforms", ", ".join(platforms) or "none"),
        ("sources", "yes, built with build = true" if has_sources(component.archive) else "none"),
        *([("start", _time(d.default_start))] if d.default_start else []),
        ("step", _time(d.default_step)),
        ("stop", _time(d.default_stop)),
        ("tolerance", _stated(d.tolerance)),
        ("capabilities", ", ".join(flags) or "none"),
        *_terminals(component),
        *([("ignored", "; ".join(d.ignored))] if d.ignored else []),
    ]


def _platform(name: str) -> str:
    """A platform of an FMU, with what runs WebAssembly."""
    from cosim.fmi.file.binaries import WASM_FOLDER

    if name != WASM_FOLDER:
        return name
    missing = "" if is_there("wasmtime") else f": {cure('wasmtime')}"
    return f"{name} (WebAssembly, on any platform{missing})"


def _interfaces(component: FmuComponent) -> str:
    """The interfaces of an FMU, as ``model exchange (3 states, 1 event indicator)``."""
    from cosim.fmi.file.description import INTERFACES, read_cached

    folder, path = component.archive.folder, component.archive.path
    found = []
    for name in component.description.interfaces:
        found.append(INTERFACES[name])
        states = read_cached(folder, path, (), name).states
        if states is not None:
            counts = ((states.count, "state"), (states.indicators, "event indicator"))
            said = ", ".join(f"{n} {word}{'' if n == 1 else 's'}" for n, word in counts)
            found[-1] += f" ({said})"
    return ", ".join(found)


def _time(value: float | None) -> str:
    return "not stated" if value is None else time_text(value, 6)


def _stated(value: float | None) -> str:
    return "not stated" if value is None else f"{value:g}"


def _terminals(component: FmuComponent) -> list[tuple[str, str]]:
    from cosim.lsbus.terminals import read_terminals

    found = [
        f"{t.name}: Tx clock {t.tx_clock.attributes.get('intervalVariability', '')}"
        for t in read_terminals(component).values()
    ]
    return [("CAN terminals", ", ".join(found))] if found else []


def _problems(component: Component) -> list[str] | None:
    """Print and return what validation finds in an FMU, which may run all the same."""
    from cosim.fmi.components import fmu_of
    from cosim.fmi.file.validation import problems

    fmu = fmu_of(component)
    if fmu is None:
        return None
    found = problems(fmu.archive.path)
    many = f"{len(found)} problem{'s' if len(found) > 1 else ''}" if found else "no problems"
    typer.echo(f"\nvalidation: FMPy found {many}{':' if found else ''}")
    for problem in found:
        typer.echo(f"  - {problem}")
    return list(found)
