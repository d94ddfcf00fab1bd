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
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

from cosim.base.convert import convert, convert_each, number
from cosim.base.errors import ScenarioError
from cosim.base.toml import change
from cosim.comparison.aligned import KIND, aligned_error
from cosim.comparison.extends import document
from cosim.comparison.port_columns import port_bench
from cosim.comparison.spec import (
    AlignedSpec,
    ColumnSpec,
    ControllerSpec,
    OperatorSpec,
    PartSpec,
    PortKind,
    PortMeasure,
    RoleSpec,
    SideSpec,
    Table,
    VariantLinkSpec,
    VariantsSpec,
    WaySpec,
    Wires,
    WiringSpec,
    with_roles,
)
from cosim.comparison.variants import (
    ComparisonSelection,
    Controller,
    ControllerSide,
    LinkLaw,
    MetricColumn,
    Operator,
    Role,
    Variants,
    choose,
)
from cosim.measure.metrics import metric
from cosim.scenario.connect import unknown

_NAME = re.compile(r"[\w.+-]+$")
_OF_LAW = re.compile(r"links\.(?!\d+\.)[\w+-]+\.")
_ENDPOINT = re.compile(r"(\w+)\.(\w[\w.]*(?:\[[\d, ]+\])*)$")


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


def of_laws(settings: Iterable[str]) -> tuple[list[str], list[str]]:
    """Settings ``path=value`` of link laws, ``links.LAW.KEY``, and those of the scenario.

    Links of a scenario have numbers instead of names.
    """
    laws, others = list[str](), list[str]()
    for setting in settings:
        (laws if _OF_LAW.match(setting) else others).append(setting)
    return laws, others


def read(path: str | Path, settings: Sequence[str] = ()) -> Variants:
    """Read a variants file, changed by `settings` of link laws (:func:`of_laws`).

    Raises ScenarioError with the place of what is wrong.
    """
    path = Path(path)
    data = document(path)
    for setting in settings:
        _change_law(data, setting, path)
    spec = convert(data, VariantsSpec, path)
    _check_names(spec, path)
    if len(spec.roles) < 2:
        there = ", ".join(spec.roles) or "none"
        raise ScenarioError(f"expected at least two roles, found {there}", f"{path} at roles")
    roles = {name: _role(name, role, spec.roles, path) for name, role in spec.roles.items()}
    controllers = _controllers(spec, roles, path)
    operators = _operators(spec, roles, path)
    links = _links(spec, roles, path)
    arms = {name: role.arm for name, role in roles.items()}
    columns = {
        name: _column(name, table, operators, arms, path) for name, table in spec.columns.items()
    }
    for name, operator in operators.items():
        _known(operator.without, columns, "column", f"{path} at operators.{name}.without")
    given, place = spec.default, f"{path} at default"
    default = ComparisonSelection(
        _known(given.controllers, controllers, "controller", f"{place}.controllers"),
        _known(given.operators, operators, "operator", f"{place}.operators"),
        _known(given.links, links, "link", f"{place}.links"),
    )
    bench = None if spec.port is None else port_bench(spec.port, arms, path)
    measures = [c for c in columns.values() if isinstance(c.metric, PortMeasure)]
    for column in measures if bench is None else ():
        kind = getattr(column.metric, "kind", "")
        raise ScenarioError(
            f"kind {kind!r} needs a table [port]", f"{path} at columns.{column.name}"
        )
    return Variants(
        path, spec.title or path.stem, spec.set, roles, controllers, operators, links,
        tuple(columns.values()), spec.stable, spec.figure,
        default, _known(given.columns, columns, "column", f"{place}.columns"), bench,
    )  # fmt: skip


# ---- parts of the file --------------------------------------------------------------------------


def _change_law(data: dict[str, Any], setting: str, path: Path) -> None:
    """Change a link law, and its title, which is shown with the results."""
    laws, (name, _, rest) = data.get("links", {}), setting.split(".", 1)[1].partition(".")
    if name not in laws:
        raise ScenarioError(unknown(name, laws, "link"), f"--set links.{name}")
    change(data, setting)
    law = laws[name]
    law["title"] = f"{law.get('title', name)}; {rest}"


def _check_names(spec: VariantsSpec, path: Path) -> None:
    """Names end up in lists between commas and in paths."""
    for key in ("controllers", "operators", "links"):
        for name in getattr(spec, key):
            if not _NAME.match(name):
                expected = "letters, digits and any of . + - _"
                raise ScenarioError(f"the name {name!r}: expected {expected}", f"{path} at {key}")


def _role(name: str, spec: RoleSpec, roles: Mapping[str, RoleSpec], path: Path) -> Role:
    """A role. Of two roles each receives from the other; more must name it."""
    hears = spec.hears
    if hears is None and len(roles) > 2:
        raise ScenarioError("the key 'hears' is missing", f"{path} at roles.{name}")
    if hears is None:
        hears = next(other for other in roles if other != name)
    return Role(
        spec.arm, spec.controller, _heard(hears, name, roles, f"{path} at roles.{name}.hears")
    )


def _heard(
    hears: str | Sequence[str], name: str, roles: Iterable[str], place: str
) -> tuple[str, ...]:
    """The roles from which `name` receives: another one, or a list. Raises ScenarioError."""
    heard = (hears,) if isinstance(hears, str) else tuple(hears)
    if not heard:
        raise ScenarioError("empty list; expected the roles from which it receives", place)
    _check_roles(heard, roles, place)
    for i, role in enumerate(heard):
        if role == name:
            raise ScenarioError(f"{name} receives from itself; expected another role", place)
        if role in heard[:i]:
            raise ScenarioError(f"{role} twice; expected each role once", place)
    return heard


def _check_roles(names: Iterable[str], roles: Iterable[str], place: str) -> None:
    for name in names:
        if name not in roles:
            raise ScenarioError(unknown(name, roles, "role"), place)


def _controllers(
    spec: VariantsSpec, roles: Mapping[str, Role], path: Path
) -> dict[str, Controller]:
    kind = with_roles(ControllerSpec, SideSpec, roles)
    return {
        name: Controller(
            name, given.title or name, given.condition, given.constant_delay,
            _sides(given, spec.wiring, roles, path, f"controllers.{name}"),
        )
        for name, given in convert_each(spec.controllers, kind, path, "controllers").items()
    }  # fmt: skip


def _sides(
    spec: ControllerSpec, wiring: WiringSpec, roles: Iterable[str], path: Path, key: str
) -> dict[str, ControllerSide]:
    """The sides of a controller, and the components that each of them has besides."""
    further = convert_each(spec.components, PartSpec, path, f"{key}.components")
    owners, parts = ("arm", "controller", *further), {}
    for name, part in further.items():
        place = f"{path} at {key}.components.{name}"
        if part.model is None:
            raise ScenarioError("the key 'model' is missing", place)
        parts[name] = (part.keys(), _wires(part.inputs, owners, f"{place}.inputs"))
    sides = {}
    for role in roles:
        own: SideSpec = getattr(spec, role) or SideSpec()
        component = {k: v for k, v in _joined(spec.keys(), own.keys()).items() if v != {}}
        if "model" not in component:
            raise ScenarioError("the key 'model' is missing", f"{path} at {key}")
        wires = {}
        for name in ("inputs", "drives", "receives"):
            tables = {f"{key}.{role}": own, key: spec, "wiring": wiring}
            given = [
                (x, t)
                for x, table in tables.items()
                if (t := getattr(table, name, None)) is not None
            ]
            place, table = given[0] if given else ("", {})
            wires[name] = _wires(table, owners, f"{path} at {place}.{name}")
        sides[role] = ControllerSide(component, **wires, parts=parts)
    return sides


def _joined(shared: Table, own: Table) -> Table:
    """A role's own keys before those of both sides; tables are joined."""
    joined = shared | own
    for key in shared.keys() & own.keys():
        if isinstance(shared[key], dict) and isinstance(own[key], dict):
            joined[key] = shared[key] | own[key]
    return joined


def _wires(table: Wires, owners: Sequence[str], place: str) -> dict[str, tuple[str, str]]:
    wires = {}
    for port, end in table.items():
        match = _ENDPOINT.match(end)
        if match is None or match[1] not in owners:
            expected = " or ".join(f"'{owner}.PORT'" for owner in owners)
            raise ScenarioError(f"{end!r}: expected {expected}", f"{place}.{port}")
        wires[port] = (match[1], match[2])
    return wires


def _operators(spec: VariantsSpec, roles: Mapping[str, Role], path: Path) -> dict[str, Operator]:
    kind = with_roles(OperatorSpec, dict[str, Any], roles)
    operators = {}
    for name, given in convert_each(spec.operators, kind, path, "operators").items():
        _check_roles(given.feeds, roles, f"{path} at operators.{name}.feeds")
        values = {role: x for role in roles if (x := getattr(given, role)) is not None}
        operators[name] = Operator(
            name, given.title or name, values, given.without, given.components, given.feeds,
            given.control,
        )  # fmt: skip
    return operators


def _links(spec: VariantsSpec, roles: Mapping[str, Role], path: Path) -> dict[str, LinkLaw]:
    kind = with_roles(VariantLinkSpec, WaySpec, roles)
    laws = {}
    for name, given in convert_each(spec.links, kind, path, "links").items():
        place = f"{path} at links.{name}"
        _check_roles(given.hears, roles, f"{place}.hears")
        hears = {r: _heard(x, r, roles, f"{place}.hears.{r}") for r, x in given.hears.items()}
        sides = {r: x.keys() for r in roles if (x := getattr(given, r)) is not None}
        options = given.keys()
        if "delay" not in options and not all("delay" in sides.get(r, ()) for r in roles):
            raise ScenarioError("the key 'delay' is missing", place)
        laws[name] = LinkLaw(name, given.title or name, options, sides, hears)
    return laws


def _column(
    name: str,
    table: Table,
    operators: Mapping[str, Operator],
    arms: Mapping[str, str],
    path: Path,
) -> MetricColumn:
    key, kind = f"columns.{name}", table.get("kind")
    if kind == KIND:
        aligned = convert(table, AlignedSpec, path, key)
        error = aligned_error(name, aligned, arms, f"{path} at {key}")
        return MetricColumn(name, aligned.label or name, aligned.part, error, ())
    if kind in get_args(PortKind):
        port = convert(table, PortMeasure, path, key)
        if port.environment is not None and port.kind != "passivity":
            what = "the key 'environment' is of kind 'passivity'"
            raise ScenarioError(what, f"{path} at {key}.environment")
        return MetricColumn(name, port.label or name, "", port, ())
    spec, place = convert(table, ColumnSpec, path, key), f"{path} at {key}"
    measured = metric(
        name,
        spec.kind,
        spec.of,
        target=spec.target,
        within=None if spec.within is None else number(spec.within, "1", f"{place}.within"),
        window=None if spec.window is None else number(spec.window, "s", f"{place}.window"),
        contact=spec.contact,
        norm=spec.norm,
        label=spec.label or name,
        place=place,
    )
    only = _known(spec.only, operators, "operator", f"{place}.only") if "only" in table else ()
    return MetricColumn(name, spec.label or name, spec.part, measured, only)


def _known(
    names: Sequence[str], known: Mapping[str, Any], what: str, place: str
) -> tuple[str, ...]:
    """The names in a list, all of which must exist; all names if there is no list."""
    return choose(names, known, tuple(known), what, place)
