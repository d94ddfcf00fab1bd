"""``cosim show``: the graph, the order of a tick with reasons, and the sources of each input."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cosim.base.convert import Struct
from cosim.base.names import extent
from cosim.cli.options import Json, Set, Strict, Verify, drawn, finite, write_json

if TYPE_CHECKING:
    from cosim.bus.accounting import BusHistory
    from cosim.scenario.spec import Scenario
    from cosim.schedule.macro import MacroGroup
    from cosim.schedule.parts import Link, Slot, Step, Wire
    from cosim.schedule.plan import Plan


#: Sections of a scenario with the names of their columns.
SECTIONS = {
    "components": ("name", "kind", "every", "ports", "model"),
    "order within tick k": ("number", "component", "action", "due", "reason"),
    "what each input samples": ("input", "", "source", "value"),
    "links": ("name", "semantics", "law", "least age"),
    "links as tc netem would have them": ("name", "arguments"),
}


class BusAccountOptions(Struct, frozen=True):
    """The account of a simulated bus in an interval."""

    bus: Annotated[
        str,
        typer.Option(
            help="Print load, response times and losses of this simulated bus instead.",
            metavar="NAME",
        ),
    ] = ""
    from_: Annotated[
        float,
        typer.Option(
            "--from", callback=finite, min=0.0, help="With --bus: start of the interval, s."
        ),
    ] = 0.0
    for_: Annotated[
        float,
        typer.Option(
            "--for", callback=finite, min=1e-6, help="With --bus: length of the interval, s."
        ),
    ] = 0.02
    picture: Annotated[
        Path | None,
        typer.Option(callback=drawn, help="With --bus: write a PNG of the frames in the interval."),
    ] = None
    log: Annotated[
        Path | None,
        typer.Option(
            help="With --bus: write the frames of the interval as candump does, in nanoseconds."
        ),
    ] = None


def show(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml), or a run folder.")],
    account: BusAccountOptions,
    set_: Set = None,
    strict: Strict = False,
    check: Verify = True,
    json: Json = None,
) -> None:
    """Print how a scenario runs: components, rates, order, and what every input samples.

    For a run folder: what ran, how it ended, what was recorded, and whether files have changed.
    With --bus: load, response times and lost frames of a simulated CAN bus during an interval.
    """
    from cosim.base.errors import ScenarioError
    from cosim.cli.check import report_unconnected_inputs
    from cosim.loading.files import load
    from cosim.scenario.assemble import assemble

    if scenario.is_dir():
        if set_:
            raise ScenarioError("--set applies to a scenario, not to a recorded run", str(scenario))
        facts = recorded_run(scenario, check=check)
        for line in aligned([list(fact) for fact in facts]):
            typer.echo(line)
        if json is not None:
            write_json(json, "show", dict(facts))
        return
    loaded = load(scenario, set_ or [])
    if account.bus and json is not None:
        raise ScenarioError("found --json with --bus, expected --log FILE, which has every frame")
    if account.bus:
        for line in bus_account(loaded, account):
            typer.echo(line)
        return
    plan = assemble(loaded)
    report_unconnected_inputs([plan], strict=strict, quiet=False)
    typer.echo(loaded.title)
    typer.echo(
        f"base step {plan.h:g} s, {plan.ticks} ticks ({_span(plan)}), "
        f"algorithm {plan.algorithm}, seed {loaded.run.seed}"
    )
    made = (_components(plan), _order(plan), _inputs(plan), _links(plan), _emulated(plan))
    sections = dict(zip(SECTIONS, made, strict=True))
    for title, rows in sections.items():
        if rows:
            typer.echo(f"\n{title}")
            typer.echo("\n".join(aligned(rows)))
    if json is not None:
        write_json(json, "show", _as_data(loaded, plan, sections))


def _as_data(
    scenario: Scenario, plan: Plan, sections: Mapping[str, Sequence[Sequence[str]]]
) -> dict[str, Any]:
    """The printed text as data: a section as a list of rows, columns by name."""
    return {
        "title": scenario.title, "step_s": plan.h, "ticks": plan.ticks,
        "algorithm": plan.algorithm, "seed": scenario.run.seed,
        **{
            title: [{k: v for k, v in zip(SECTIONS[title], row, strict=True) if k} for row in rows]
            for title, rows in sections.items()
        },
    }  # fmt: skip


def bus_account(scenario: Scenario, wanted: BusAccountOptions) -> list[str]:
    """The account of a simulated bus, its picture and its log.

    Raises ScenarioError for an unknown bus, RunError for a file that cannot be written.
    """
    from cosim.base.errors import ScenarioError
    from cosim.base.names import unknown
    from cosim.reporting.bus_account import account_lines, draw_account
    from cosim.scenario.assemble import scenario_components
    from cosim.scenario.buses import bus_history
    from cosim.scenario.connect_links import frames_on_buses

    name = wanted.bus
    if name not in scenario.buses:
        raise ScenarioError(unknown(name, scenario.buses, "bus"), f"{scenario.path}: --bus")
    frames = frames_on_buses(scenario_components(scenario)).get(name)
    if not frames:
        raise ScenarioError(
            "found no link on this bus, expected one: an account is of buses that carry links",
            scenario.place("bus", name),
        )
    first, last = round(wanted.from_ * 1e12), round((wanted.from_ + wanted.for_) * 1e12)
    h = bus_history(scenario, name, frames, last)
    lines = list(account_lines(h, first, last))
    if wanted.picture is not None:
        drawn = draw_account(wanted.picture, h, first, last)
        lines.append(f"picture          {drawn}")
    if wanted.log is not None:
        lines.append(f"log              {_write_log(h, name, wanted.log, first, last)}")
    return lines


def _write_log(h: BusHistory, name: str, path: Path, first: int, last: int) -> str:
    """Write the frames that ended from `first` to `last` (ps); what was written."""
    from cosim.base.files import write_file
    from cosim.bus.candump import candump_lines

    frames = [x for x in h.sent() if first <= x[0] <= last]
    write_file(path, candump_lines(frames, name, 9))
    return f"{path}: {len(frames)} frames"


def recorded_run(folder: Path, *, check: bool) -> list[tuple[str, str]]:
    """The content of a run folder, as (what, value).

    Raises ScenarioError where a file was altered, and `check` asks.
    """
    from cosim.record import Run, verify
    from cosim.record.folder import SUMS

    if check:
        verify(folder)
    run = Run.open(folder)
    facts = run.metadata
    rows = [
        ("scenario", str(facts.get("scenario", {}).get("title", "unknown"))),
        ("status", str(facts.get("status", "unknown"))),
        ("recorded", f"{len(run)} rows to t = {run.span[1] if len(run) else 0:.6g} s"),
        ("signals", str(len(run.names))),
        ("link tables", str(len(run.link_tables))),
    ]
    if error := facts.get("error"):
        rows.append(("error", str(error)))
    if check and (folder / SUMS).exists():
        rows.append(("files", f"as they were written ({SUMS})"))
    return rows


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of texts as lines with aligned columns; the last column is not padded."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]) - 1)]
    return [
        "  " + "  ".join([*(f"{t:<{w}}" for t, w in zip(row, widths, strict=False)), row[-1]])
        for row in rows
    ]


def _components(plan: Plan) -> list[list[str]]:
    return [
        [
            c.name,
            c.kind,
            f"every {_times(c.period, plan.h)}",
            f"{_ports(c.inputs)} -> {_ports(c.outputs)}",
            _model(c),
        ]
        for c in plan.components
    ]


def _span(plan: Plan) -> str:
    if plan.start:
        return f"{plan.start:g} to {plan.end:g} s"
    return f"{plan.end:g} s"


def _times(period: int, h: float) -> str:
    return f"{period * h:g} s ({period} tick{'s' if period != 1 else ''})"


def _ports(slots: Sequence[Slot]) -> str:
    return " ".join(s.port + extent(s.shape, s.base) for s in slots) or "nothing"


def _model(step: Step) -> str:
    from cosim.fmi.components import model_name

    return model_name(step.component)


def _order(plan: Plan) -> list[list[str]]:
    """The stages of a tick, each step with its reason."""
    rows: list[list[str]] = []
    for name in plan.order:
        step = plan.component(name)
        sources = {w.source.component for w in plan.wires if w.target.component == name}
        after = sorted(sources & set(plan.order))
        reason = "waits for no other in this tick"
        if after:
            reason = f"after {', '.join(after)}: samples what they compute in this tick"
        rows.append([f"{len(rows) + 1}.", name, "sample, compute, hold", _due(step), reason])
    rows.append([f"{len(rows) + 1}.", "record", "the signal vector", "", "what is known at t_k"])
    why = "input held over the step, output at its end"
    if plan.algorithm == "jacobi":
        why = "jacobi: everybody sees what the tick before left behind"
    number = len(rows) + 1
    for i, step in enumerate(plan.component(name) for name in plan.later):
        span = f"t_k -> t_k + {step.period * plan.h:g} s"
        if plan.algorithm == "gauss-seidel":
            why = _gauss_seidel_order(plan, step, plan.later[:i])
            number += i > 0
        if plan.algorithm == "adaptive":
            why = _macro_steps(plan, step)
        rows.append([f"{number}.", step.name, span, _due(step), why])
    return rows


def _macro_steps(plan: Plan, step: Step) -> str:
    """With which others a component is stepped, and how finely."""
    assert plan.adaptive is not None
    group = _group(plan, step)
    if group is None:
        return "no macro steps: input held over the step, output at its end"
    others = [c.name for c in (plan.components[i] for i in group.components) if c.name != step.name]
    together = f" with {', '.join(others)}" if others else ""
    least = step.period * plan.h / 2**group.halvings
    tolerance = f"tolerance {plan.adaptive.tolerance:g}"
    return f"macro steps{together}, at least {least:.3g} s, {tolerance}"


def _group(plan: Plan, step: Step) -> MacroGroup | None:
    number = plan.components.index(step)
    return next((group for group in plan.groups if number in group.components), None)


def _gauss_seidel_order(plan: Plan, step: Step, before: Sequence[str]) -> str:
    """The components of which a Gauss-Seidel step uses the end of the interval, and the others."""
    sources = {w.source.component for w in plan.wires if w.target.component == step.name}
    new = ", ".join(sorted(sources & set(before)))
    old = ", ".join(sorted(sources - set(before)))
    seen = [f"newest of {new}"] if new else []
    seen += [f"{old} as at t_k"] if old else []
    return f"sees {'; '.join(seen) or 'no other'}"


def _due(step: Step) -> str:
    return "every tick" if step.period == 1 else f"k mod {step.period} = 0"


def _inputs(plan: Plan) -> list[list[str]]:
    rows = []
    for c in plan.components:
        fed = sorted(_input_sources(plan, c), key=lambda entry: entry[0].start)
        rows += [[target.name, "<-", source, what] for target, source, what in fed]
        taken = {target.start + i for target, *_ in fed for i in range(target.size)}
        for slot, port in zip(c.inputs, c.component.inputs, strict=True):
            free = [i for i in range(slot.size) if slot.start + i not in taken]
            if free:
                value = c.start.get(slot.port) or port.default or (0.0,)
                held = " ".join(f"{value[i % len(value)]:g}" for i in free)
                whole = len(free) == slot.size
                name = slot.name if whole else ", ".join(slot.scalars()[i] for i in free)
                rows.append([name, "<-", "nothing", f"keeps {held} [{slot.unit}]"])
    return rows


def _input_sources(plan: Plan, step: Step) -> list[tuple[Slot, str, str]]:
    """(input, what feeds it, what of it is there) of everything that reaches a component."""
    edges: list[Wire | Link] = [*plan.wires, *plan.links]
    fed = [(e.target, e.source.name, _samples(plan, e, step)) for e in edges]
    ages = [(x.age, x.name) for x in plan.links if x.age is not None]
    fed += [(age, name, "age of what this link holds [s]") for age, name in ages]
    for player in plan.players:
        facts = player.source.facts()
        origin, what = (
            (f"edge {facts['edge']}", "weight of the edge at t_k")
            if "edge" in facts
            else (facts.get("from", "values over time"), "value at t_k")
        )
        fed.append((player.target, origin, what))
    return [entry for entry in fed if entry[0].component == step.name]


def _samples(plan: Plan, edge: Wire | Link, step: Step) -> str:
    from cosim.schedule.parts import Link

    hold = f", holds it {step.period * plan.h:g} s"
    if isinstance(edge, Link):
        return f"the sample its link holds at t_k{hold}"
    plain = (edge.gain, edge.offset) == (1.0, 0.0)
    factor = "" if plain else f", x {edge.gain:g} + {edge.offset:g}"
    source = plan.component(edge.source.component)
    line = step.extrapolate and edge.target.port not in step.discrete
    if line and source.kind == "continuous":
        how = "value and slope" if edge.target.port in step.sloped else "the mean"
        hold = f", as {how} of a line through the last two over {step.period * plan.h:g} s"
    group = _group(plan, step) if plan.groups else None
    if group is not None and edge in group.wires:
        if edge.target.port in step.discrete:
            return f"value at the start of each macro step{factor}"
        return f"mean of the values at both ends of each macro step{factor}"
    return f"{_available_value(plan, source, step)}{factor}{hold}"


def _available_value(plan: Plan, source: Step, step: Step) -> str:
    """The value of `source` that is available when `step` is due at tick k."""
    aligned_ = step.period % source.period == 0
    if source.name in plan.order:
        return "computed in this tick" if aligned_ else f"computed when last due, {_due(source)}"
    if plan.algorithm == "gauss-seidel" and step.name in plan.later:
        earlier = plan.later.index(source.name) < plan.later.index(step.name)
        return "the newest, computed before it steps" if earlier else "value at t_k"
    if source.component.kind == "sampled":  # jacobi
        return f"computed {source.period * plan.h:g} s before, from what was known then"
    return "value at t_k" if aligned_ else f"value at the last t_k with {_due(source)}"


def _links(plan: Plan) -> list[list[str]]:
    rows = []
    for x in plan.links:
        facts = x.table.facts()
        law = facts.get("delay", {})
        least = x.table.minimum_delay_ticks
        wire = "; orders like a wire" if least == 0 else ""
        rule = str(facts.get("semantics", "stored table"))
        rows.append([x.name, rule, _law_text(law), f"at least {least} ticks old{wire}"])
    return rows


def _law_text(facts: Mapping[str, object]) -> str:
    """A law and its values; what is in it has its own law."""
    parts = []
    for key, value in facts.items():
        if isinstance(value, Mapping):
            parts.append(f"({key}: {_law_text(value)})")
        else:
            parts.append(str(value) if key == "law" else f"{key}={value}")
    return " ".join(parts)


def _emulated(plan: Plan) -> list[list[str]]:
    """Each link as arguments of ``tc netem``, and what these do not tell."""
    lines = [(x.name, _netem(plan, x)) for x in plan.links]
    return [[name if i == 0 else "", line] for name, text in lines for i, line in enumerate(text)]


def _netem(plan: Plan, link: Link) -> list[str]:
    """The closest settings of the kernel's network emulator for a link; none for a stored table."""
    from cosim.base.errors import ScenarioError
    from cosim.links.netem import netem
    from cosim.links.table import DrawnTable

    if not isinstance(link.table, DrawnTable):
        return []
    period = plan.component(link.source.component).period * plan.h
    try:
        return netem(link.table.law, period=period).splitlines()
    except ScenarioError as error:
        return [f"nothing ({error})"]
