"""``cosim show``: the graph, the order of a tick and why, and what each input samples and holds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from cosim.plan import Plan, Slot, Step


def show(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml).")],
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="PATH=VALUE", help="Change a value; repeatable."),
    ] = None,
) -> None:
    """Print how a scenario will run: components, rates, order, and what every input samples."""
    from rich.console import Console

    from cosim.assemble import assemble
    from cosim.scenario import load

    loaded = load(scenario, set_ or [])
    plan = assemble(loaded)
    console = Console(highlight=False, soft_wrap=True)
    console.print(loaded.title, style="bold")
    seconds = plan.ticks * plan.h
    console.print(
        f"base step {plan.h:g} s, {plan.ticks} ticks ({seconds:g} s), algorithm "
        f"{plan.algorithm}, seed {loaded.run.seed}\n"
    )
    console.print(_components(plan))
    console.print(_order(plan))
    console.print(_inputs(plan))
    if plan.links:
        console.print(_links(plan))


def _table(title: str, *columns: str) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        table.add_column(column, overflow="fold")
    return table


def _model(step: Step) -> str:
    from cosim.fmi import FmuComponent

    component = step.component
    if isinstance(component, FmuComponent):
        return f"{component.archive.path.name} (FMI {component.description.fmi})"
    return f"{type(component).__module__}:{type(component).__name__} (Python call-back)"


def _components(plan: Plan) -> Table:
    table = _table("Components", "name", "kind", "model", "every", "inputs", "outputs")
    for c in plan.components:
        table.add_row(
            c.name, c.kind, _model(c), f"{c.period} ticks = {c.period * plan.h:g} s",
            " ".join(_shape(s) for s in c.inputs) or "-",
            " ".join(_shape(s) for s in c.outputs) or "-",
        )  # fmt: skip
    return table


def _shape(slot: Slot) -> str:
    shape = ",".join(str(n) for n in slot.shape)
    return f"{slot.port}\\[{shape}]" if shape else slot.port


def _order(plan: Plan) -> Table:
    """The stages of a tick, each step with its reason."""
    table = _table("Order within tick k", "", "step", "why")
    last = [c.name for c in plan.components if c.name not in plan.order]
    position = 0
    for position, name in enumerate(plan.order, 1):
        step = plan.component(name)
        after = sorted(
            {
                w.source.component
                for w in plan.wires
                if w.target.component == name and w.source.component in plan.order
            }
        )
        reason = f"after {', '.join(after)}, whose outputs it samples" if after else (
            "sampled; waits for no other in this tick"
        )
        every = "" if step.period == 1 else f" (when k mod {step.period} = 0)"
        table.add_row(str(position), f"{name}{every}: sample, compute, hold", reason)
    table.add_row(str(position + 1), "record", "everything known at t_k")
    why = "continuous: inputs gathered at the start of the interval, outputs given at its end"
    if plan.algorithm == "jacobi":
        why = "jacobi: everybody sees the outputs of the previous tick"
    for name in last:
        table.add_row(str(position + 2), f"{name}: t_k -> t_k + {_interval(plan, name)}", why)
    return table


def _interval(plan: Plan, name: str) -> str:
    return f"{plan.component(name).period * plan.h:g} s"


def _inputs(plan: Plan) -> Table:
    table = _table("What each input samples and holds", "input", "from", "samples", "holds for")
    fed = {e.target.name: e for e in (*plan.wires, *plan.links)}
    for c in plan.components:
        hold = f"{c.period * plan.h:g} s"
        for slot in c.inputs:
            parts = [e for name, e in sorted(fed.items()) if name.split("[")[0] == slot.name]
            for e in parts:
                table.add_row(_escape(e.target.name), _escape(e.source.name), _samples(plan, e), hold)
            if not parts:
                value = list(c.start.get(slot.port, ())) or "its default"
                table.add_row(slot.name, "-", f"nothing: keeps {value}", "the run")
    return table


def _samples(plan: Plan, edge: object) -> str:
    from cosim.plan import Link, Wire

    if isinstance(edge, Link):
        return "the sample its link holds (see Links)"
    assert isinstance(edge, Wire)
    factor = "" if (edge.gain, edge.offset) == (1.0, 0.0) else f", x {edge.gain:g} + {edge.offset:g}"
    source = plan.component(edge.source.component)
    if source.name in plan.order:
        return f"value computed in this tick (held {source.period * plan.h:g} s){factor}"
    return f"value at t_k{factor}"


def _escape(text: str) -> str:
    return text.replace("[", "\\[")


def _links(plan: Plan) -> Table:
    table = _table("Links", "link", "delay law (s)", "semantics", "least delay (ticks)")
    for x in plan.links:
        least = x.table.minimum_delay_ticks
        wire = " (acts as a wire in the order)" if least == 0 else ""
        facts = x.table.facts()
        law = _escape(" ".join(f"{k}={v}" for k, v in _flat(facts["delay"])))
        rule = facts.get("semantics", "")
        table.add_row(_escape(x.name), law, str(rule), f"{least}{wire}")
    return table


def _flat(facts: object) -> list[tuple[str, object]]:
    return list(facts.items()) if isinstance(facts, dict) else [("law", facts)]
