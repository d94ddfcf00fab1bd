"""A variants file: what is put in the place of a scenario's controllers, operator and links.

::

    extends = "other.toml"                  # see cosim.comparison.extends
    set = ["run.step=5 ms"]                 # changes to the scenario before anything else

    [roles.master]                          # two or more: which components of the scenario they are
    arm = "master"
    controller = "master_control"
    hears = "slave"                         # whose signals it receives; of two roles the other's
                                            # or ["a", "b"]: `neighbours` = 2, a row of inputs each

    [wiring]                                # of every controller, unless it says otherwise
    inputs = { q = "arm.q", dq = "arm.dq" } # its inputs, from its own arm
    drives = { tau = "controller.tau" }     # inputs of its arm

    [controllers.pd]                        # a component, and what it gets from the other side
    title = "Plain PD"
    model = "fmus.models.pd"
    preset = "PD(10,4)"
    receives = { q_j = "arm.q", dq_j = "arm.dq" }
    [controllers.wave.master]               # a role's own keys, where the two sides differ
    [controllers.slow.components.servo]     # a component of each side besides: drives and inputs
    model = "fmus.models.servo"             # may name it, as in drives = { tau = "servo.tau" }
    inputs = { q = "arm.q", dq_c = "controller.dq_c" }

    [operators.tight]                       # values of a role's arm
    master = { k_p = 200.0, k_d = 2.0 }
    [operators.person.components.intent]    # a component besides; a role in `inputs` is its arm
    [operators.person.control]              # values of every controller, as tau_max = 60.0
    [operators.person.feeds]                # inputs of arms that it feeds
    master = { q_h = "intent.q_h" }

    [links.constant]                        # both ways, each way one channel
    delay = { law = "constant", delay = "750 ms" }

    [links.wifi.slave]                      # what differs on the way on which a role receives
    [links.chain.hears]                     # another graph: whom each role hears
    [columns.effort]                        # a metric (cosim.measure.metrics), or a part of one
    kind = "norm"
    of = ["master.tau_h"]

    [port]                                  # see cosim.comparison.port_columns
    [stable]                                # see cosim.comparison.verdict
    [figure]                                # see cosim.comparison.figure
    [default]                               # what is compared if nobody says
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast, get_args

from cosim.base.errors import ScenarioError
from cosim.comparison.aligned import KIND, aligned_error
from cosim.comparison.extends import document
from cosim.comparison.port_columns import port_bench, port_measure
from cosim.comparison.roles_file import heard_roles, read_roles
from cosim.comparison.toml import Section
from cosim.comparison.variants import (
    ComparisonSelection,
    Controller,
    ControllerSide,
    LinkLaw,
    MetricColumn,
    Operator,
    Picture,
    PortBench,
    PortMeasure,
    Role,
    Stability,
    Variants,
    choose,
)
from cosim.measure.metrics import Distance, metric
from cosim.scenario.connect import unknown

_NAME = re.compile(r"[\w.+-]+$")
_ENDPOINT = re.compile(r"(\w+)\.(\w[\w.]*(?:\[[\d, ]+\])*)$")
_TOP = ("title", "set", "roles", "wiring", "controllers", "operators", "links", "columns",
        "stable", "figure", "port", "default")  # fmt: skip
_COMPONENT = ("model", "fmi", "sizes", "options", "preset", "period", "parameters", "start")
_WIRING = ("inputs", "drives", "receives")
_LINK = ("delay", "semantics", "playout", "loss")
_METRIC = ("kind", "of", "target", "within", "window", "contact", "norm", "label")


def variants_path(scenario: str | Path) -> Path:
    """The variants file of a scenario, in the folder ``compare`` next to it: the one with its name,
    or the only one that has no other scenario's name.

    Raises ScenarioError if there is none, or several.
    """
    scenario = Path(scenario)
    folder = scenario.parent / "compare"
    found = sorted(folder.glob("*.toml"))
    others = [path for path in found if not (scenario.parent / path.name).exists()]
    found = [path for path in found if path.stem == scenario.stem] or others
    if len(found) == 1:
        return found[0]
    what = f"found {', '.join(p.name for p in found)}" if found else "there is none"
    raise ScenarioError(
        f"expected one variants file, {what}; choose one with --variants FILE", str(folder)
    )


def read(path: str | Path) -> Variants:
    """Read a variants file. Raises ScenarioError with the place of what is wrong."""
    path = Path(path)
    top = Section(document(path), path)
    top.only(*_TOP)
    _check_names(top)
    roles = read_roles(top)
    controllers = {name: _controller(name, t, top, roles) for name, t in top.tables("controllers")}
    operators = {name: _operator(name, t, roles) for name, t in top.tables("operators")}
    links = {name: _link(name, t, roles) for name, t in top.tables("links")}
    arms = {name: role.arm for name, role in roles.items()}
    bench = port_bench(top.table("port"), arms)
    columns = tuple(_column(name, t, operators, arms) for name, t in top.tables("columns"))
    _check_without(top, operators, columns)
    _check_port(top, columns, bench)
    given = top.table("default")
    given.only("controllers", "operators", "links", "columns")
    default = ComparisonSelection(
        _known_names(given, "controllers", controllers, "controller"),
        _known_names(given, "operators", operators, "operator"),
        _known_names(given, "links", links, "link"),
    )
    return Variants(
        path, top.text("title", path.stem), top.texts("set", ()), roles, controllers, operators,
        links, columns, _stability(top.table("stable")), _picture(top.table("figure")), default,
        _known_names(given, "columns", {c.name: c for c in columns}, "column"), bench,
    )  # fmt: skip


# ---- parts of the file --------------------------------------------------------------------------


def _check_names(top: Section) -> None:
    """Names end up in lists between commas and in paths."""
    for key in ("controllers", "operators", "links"):
        for name in top.table(key).data:
            if not _NAME.match(name):
                expected = "letters, digits and any of . + - _"
                raise ScenarioError(f"the name {name!r}: expected {expected}", top.place(key))


def _controller(name: str, table: Section, top: Section, roles: Mapping[str, Role]) -> Controller:
    own = ("title", "condition", "constant_delay")
    table.only(*own, *_COMPONENT, *_WIRING, "components", *roles)
    wiring = top.table("wiring")
    wiring.only("inputs", "drives")
    return Controller(
        name,
        table.text("title", name),
        table.text("condition", ""),
        table.flag("constant_delay"),
        {role: _side(table, table.table(role), wiring) for role in roles},
    )


def _side(shared: Section, own: Section, wiring: Section) -> ControllerSide:
    """A role's own keys before those of both sides; parameters and start values are joined."""
    own.only(*_COMPONENT, *_WIRING)
    component = {key: (own if key in own else shared).data.get(key) for key in _COMPONENT}
    for key in ("sizes", "options", "parameters", "start"):
        component[key] = shared.mapping(key) | own.mapping(key)
    component["model"] = (own if "model" in own else shared).text("model")
    further = dict(shared.tables("components")) if "components" in shared else {}
    owners = ("arm", "controller", *further)
    wires = {}
    for key in _WIRING:
        table = next((t for t in (own, shared, wiring) if key in t), shared)
        wires[key] = _wires(table.table(key), owners)
    parts = {name: _part(part, owners) for name, part in further.items()}
    made = {k: v for k, v in component.items() if v not in (None, {})}
    return ControllerSide(made, **wires, parts=parts)


def _part(
    table: Section, owners: Sequence[str]
) -> tuple[Mapping[str, Any], Mapping[str, tuple[str, str]]]:
    """A further component of a side: its keys, and its wires."""
    table.only(*_COMPONENT, "inputs")
    table.text("model")
    keys = {key: table.data[key] for key in _COMPONENT if key in table}
    return keys, _wires(table.table("inputs"), owners)


def _wires(table: Section, owners: Sequence[str]) -> dict[str, tuple[str, str]]:
    found = {}
    for port in table.data:
        match = _ENDPOINT.match(table.text(port))
        if match is None or match[1] not in owners:
            expected = " or ".join(f"'{owner}.PORT'" for owner in owners)
            raise ScenarioError(f"{table.text(port)!r}: expected {expected}", table.place(port))
        found[port] = (match[1], match[2])
    return found


def _operator(name: str, table: Section, roles: Mapping[str, Role]) -> Operator:
    table.only("title", "without", "components", "feeds", "control", *roles)
    values = {role: table.mapping(role) for role in roles if role in table}
    fed = table.table("feeds")
    fed.only(*roles)
    feeds = {role: fed.mapping(role) for role in roles if role in fed}
    title, without = table.text("title", name), table.texts("without", ())
    components, control = table.mapping("components"), table.mapping("control")
    return Operator(name, title, values, without, components, feeds, control)


def _link(name: str, table: Section, roles: Mapping[str, Role]) -> LinkLaw:
    table.only("title", "hears", *_LINK, *roles)
    graph = table.table("hears")
    graph.only(*roles)
    hears = {role: heard_roles(graph, role, role, roles) for role in graph.data}
    sides = {role: table.table(role) for role in roles if role in table}
    for side in sides.values():
        side.only(*_LINK)
    if "delay" not in table and not all("delay" in sides.get(role, ()) for role in roles):
        raise ScenarioError("missing key 'delay'", table.place())
    options, *own = (
        {key: x.data[key] for key in _LINK if key in x} for x in (table, *sides.values())
    )
    each = dict(zip(sides, own, strict=True))
    return LinkLaw(name, table.text("title", name), options, each, hears)


def _column(
    name: str, table: Section, operators: Mapping[str, Operator], arms: Mapping[str, str]
) -> MetricColumn:
    label = table.text("label", name)
    if table.text("kind") == KIND:
        aligned = aligned_error(name, table, arms)
        return MetricColumn(name, label, table.text("part", ""), aligned, ())
    measure = port_measure(table.text("kind"), table)
    if measure is not None:
        return MetricColumn(name, label, "", measure, ())
    table.only("part", "only", *_METRIC)
    found = metric(
        name,
        table.text("kind"),
        table.texts("of"),
        target=_target(table),
        within=None if "within" not in table else table.quantity("within", "1"),
        window=None if "window" not in table else table.quantity("window", "s"),
        contact=table.texts("contact", ()),
        norm=_norm(table),
        label=label,
        place=table.place(),
    )
    only = _known_names(table, "only", operators, "operator") if "only" in table else ()
    return MetricColumn(name, label, table.text("part", ""), found, only)


def _target(table: Section) -> str | tuple[float, ...] | None:
    """A signal, or a number per entry."""
    if "target" not in table:
        return None
    found = table.data["target"]
    return found if isinstance(found, str) else table.numbers("target")


def _norm(table: Section) -> Distance:
    found, known = table.text("norm", "max"), get_args(Distance)
    if found not in known:
        raise ScenarioError(f"expected {' or '.join(known)}, found {found!r}", table.place("norm"))
    return cast(Distance, found)


def _stability(table: Section) -> Stability:
    table.only("position", "velocity", "position_limit", "velocity_limit", "rest", "window")
    return Stability(
        table.texts("position"),
        table.texts("velocity"),
        table.quantity("position_limit", "rad"),
        table.quantity("velocity_limit", "rad/s"),
        table.quantity("rest", "rad/s"),
        table.quantity("window", "s"),
    )


def _picture(table: Section) -> Picture:
    table.only("y", "reference", "until")
    until = table.quantity("until", "s", float("inf"))
    return Picture(table.texts("y"), table.numbers("reference", ()), until)


def _check_without(
    top: Section, operators: Mapping[str, Operator], columns: Sequence[MetricColumn]
) -> None:
    names = [column.name for column in columns]
    for operator in operators.values():
        for name in operator.without:
            if name not in names:
                place = top.place("operators", operator.name, "without")
                raise ScenarioError(unknown(name, names, "column"), place)


def _check_port(top: Section, columns: Sequence[MetricColumn], bench: PortBench | None) -> None:
    for column in columns:
        if isinstance(column.metric, PortMeasure) and bench is None:
            kind = column.metric.kind
            raise ScenarioError(
                f"kind {kind!r} needs a table [port]", top.place("columns", column.name)
            )


def _known_names(table: Section, key: str, known: Mapping[str, Any], what: str) -> tuple[str, ...]:
    """The names in a list, all of which must exist; all names if there is no list."""
    return choose(table.texts(key, ()), known, tuple(known), what, table.place(key))
