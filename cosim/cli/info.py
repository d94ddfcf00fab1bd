"""``cosim info``: properties, capabilities and requirements of an FMU or a scene of MuJoCo."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from cosim.base.component import Parameter, Port
    from cosim.fmi.component import FmuComponent
    from cosim.fmi.variables import FmuVariable


def info(
    model: Annotated[
        str, typer.Argument(help="FMU file (.fmu), or mujoco:FILE for a scene of MuJoCo.")
    ],
    validate: Annotated[
        bool, typer.Option("--validate/--no-validate", help="Validate an FMU with FMPy as well.")
    ] = True,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit with 1 if validation finds a problem.")
    ] = False,
) -> None:
    """Print the ports and units of an FMU or of a scene of MuJoCo; validate an FMU."""
    from cosim.cli.show import aligned
    from cosim.fmi import FmuComponent
    from cosim.mujoco.options import PREFIX

    if model.startswith(PREFIX):
        _scene(model)
        return
    fmu = Path(model)
    component = FmuComponent(fmu)
    for line in aligned(_facts(component)):
        typer.echo(line[2:])
    typer.echo("")
    for line in aligned(_signals(component)):
        typer.echo(line)
    if validate and _findings(fmu) and strict:
        raise typer.Exit(1)


def _scene(model: str) -> None:
    from cosim.cli.show import aligned
    from cosim.mujoco import MujocoComponent, scene_path

    component = MujocoComponent(scene_path(model, Path()))
    facts = [["kind", component.kind], *(list(fact) for fact in component.scene.facts())]
    for line in aligned([*facts, *(list(fact) for fact in component.scene.counts())]):
        typer.echo(line[2:])
    rows = [["signal", "causality", "unit", "start", "description"]]
    for causality, ports in (("input", component.inputs), ("output", component.outputs)):
        rows += [[_name(p), causality, p.unit, "", p.description] for p in ports]
    rows += [
        [_name(p), "start", p.unit, " ".join(f"{x:g}" for x in p.default), p.description]
        for p in component.parameters
    ]
    typer.echo("")
    for line in aligned(rows):
        typer.echo(line)


def _name(port: Port | Parameter) -> str:
    return port.name + (f"[{','.join(str(n) for n in port.shape)}]" if port.shape else "")


def _signals(component: FmuComponent) -> list[list[str]]:
    rows = [["signal", "causality", "type", "unit", "start", "description"]]
    clocks = {v.reference: v.name for v in component.description.variables if v.type == "Clock"}
    for group in component.groups.values():
        v = group.first
        shape = f"[{','.join(str(n) for n in group.shape)}]" if group.shape else ""
        start = " ".join(f"{float(t):g}" if _is_number(t) else t for t in group.start)
        rows.append(
            [group.name + shape, v.causality, _type(v, clocks), v.unit, start, v.description]
        )
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


def _facts(component: FmuComponent) -> list[list[str]]:
    from cosim.fmi.binaries import has_sources

    d = component.description
    binaries = component.archive.folder / "binaries"
    platforms = sorted(p.name for p in binaries.glob("*") if p.is_dir())
    flags = sorted(name for name, on in d.flags.items() if on)
    return [
        ["model", f"{d.name} - {d.description}" if d.description else d.name],
        ["FMI", f"{d.fmi} {_interfaces(component)}"],
        ["kind", component.kind + ("" if d.kind else " (assumed; set `kind` in the scenario)")],
        ["token", d.token],
        ["made by", d.tool or "unknown"],
        ["sha256", component.archive.sha256],
        ["platforms", ", ".join(platforms) or "none"],
        ["sources", "yes, built with build = true" if has_sources(component.archive) else "none"],
        ["step", _stated(d.default_step, " s")],
        ["stop", _stated(d.default_stop, " s")],
        ["tolerance", _stated(d.tolerance)],
        ["capabilities", ", ".join(flags) or "none"],
        *_terminals(component),
    ]


def _interfaces(component: FmuComponent) -> str:
    """What an FMU is exported for, as ``model exchange (3 states, 1 event indicator)``."""
    from cosim.fmi.description import read_cached

    words = {"CoSimulation": "co-simulation", "ModelExchange": "model exchange"}
    found = [words[name] for name in component.description.interfaces]
    if "model exchange" not in found:
        return ", ".join(found)
    folder, path = component.archive.folder, component.archive.path
    states = read_cached(folder, path, (), True).states
    assert states is not None
    counts = ((states.count, "state"), (states.indicators, "event indicator"))
    said = ", ".join(f"{n} {word}{'' if n == 1 else 's'}" for n, word in counts)
    return f"{', '.join(found)} ({said})"


def _stated(value: float | None, unit: str = "") -> str:
    return "not stated" if value is None else f"{value:g}{unit}"


def _terminals(component: FmuComponent) -> list[list[str]]:
    from cosim.lsbus.terminals import read_terminals

    found = [
        f"{t.name}: Tx clock {t.tx_clock.attributes.get('intervalVariability', '')}"
        for t in read_terminals(component).values()
    ]
    return [["CAN terminals", ", ".join(found)]] if found else []


def _findings(fmu: Path) -> int:
    """Print what validation finds; how much that is. An FMU may run all the same."""
    from cosim.fmi.validation import problems

    found = problems(fmu)
    many = f"{len(found)} problem{'s' if len(found) > 1 else ''}" if found else "no problems"
    typer.echo(f"\nvalidation: FMPy found {many}{':' if found else ''}")
    for problem in found:
        typer.echo(f"  - {problem}")
    return len(found)
