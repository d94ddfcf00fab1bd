"""Scenario documents made from one: its controllers, operator and links replaced.

What stays is everything else: the arms, what surrounds them, step, length and seed of the run.
Links that end at a replaced controller, or start at one, go with it. Both ways of an exchange are
channels called after the roles, ``master->slave``, whatever is sent: the same seed and channel
give the same delays whichever controller uses them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.base import toml
from cosim.base.copies import replace
from cosim.base.errors import CosimError, ScenarioError
from cosim.base.toml import change
from cosim.comparison.variants import (
    ComparisonSelection,
    Controller,
    LinkLaw,
    Operator,
    Role,
    Variants,
)
from cosim.loading.files import read_document
from cosim.mujoco import PREFIX, scene_path
from cosim.scenario.assemble import assemble
from cosim.scenario.connect import unknown
from cosim.scenario.spec import Scenario, build
from cosim.schedule.plan import Plan

Document = dict[str, Any]
#: Keys of a delay law that name files.
_FILES = ("file",)


@dataclass(frozen=True, slots=True)
class Case:
    """One run: names of variants, and the seed of the links."""

    controller: str
    operator: str
    link: str
    seed: int

    @property
    def name(self) -> str:
        """``paper/light/pd-seed0``: by link law and operator."""
        return f"{self.link}/{self.operator}/{self.controller}-seed{self.seed}"


@dataclass(frozen=True, slots=True)
class Base:
    """The scenario from which cases are made: its file, and its content after all settings."""

    path: Path
    document: Mapping[str, Any]

    @property
    def seed(self) -> int:
        """Seed of the run, default 0."""
        return int(self.document["run"].get("seed", 0))


def read_base(path: str | Path, variants: Variants, settings: Sequence[str] = ()) -> Base:
    """Read a scenario; changed by the variants file, then by `settings` (``path=value``).

    Raises ScenarioError, also where a role names a component that the scenario has not.
    """
    path = Path(path)
    ssp = path.suffix == ".ssp"
    document = read_document(path) if ssp else toml.read(path, "a scenario file")
    for number, setting in enumerate(variants.settings):
        try:
            change(document, setting)
        except ScenarioError as error:
            place = f"{variants.path} at set[{number}]"
            raise ScenarioError(str(error).removeprefix("--set "), place) from None
    for setting in settings:
        change(document, setting)
    known = build(document, path).components
    for name, role in variants.roles.items():
        for key, component in (("arm", role.arm), ("controller", role.controller)):
            if component not in known:
                where = f"{variants.path} at roles.{name}.{key}"
                raise ScenarioError(f"{path} has {unknown(component, known, 'component')}", where)
    return Base(path, document)


def scenario(base: Base, variants: Variants, case: Case) -> Scenario:
    """The scenario of a case. Raises ScenarioError for what makes none."""
    return build(case_document(base, variants, case), base.path)


def case_document(base: Base, variants: Variants, case: Case) -> Document:
    """The scenario of a case, as a file has it; its last links are those of the link law."""
    document = deepcopy(dict(base.document))
    for key in ("metrics", "figures", "require"):
        document.pop(key, None)
    signals = sorted({signal for signal, _ in signals_read(variants)})
    document["run"] |= {"seed": case.seed, "record": {"signals": signals}}
    controller = variants.controllers[case.controller]
    _hold(document, variants.operators[case.operator], variants)
    law = variants.links[case.link]
    _control(document, controller, variants, law, variants.operators[case.operator].control)
    replaced = tuple(f"{role.controller}." for role in variants.roles.values())
    kept = [x for x in document.get("links", []) if not _touches(x, replaced)]
    made = _links(controller, law, variants)
    document["links"] = [*kept, *made]
    return document


def signals_read(variants: Variants) -> Iterator[tuple[str, str]]:
    """(signal, place in the variants file) of all that columns, verdict and figure read, whole."""
    s = variants.stability
    for place, names in (
        *((f"columns.{c.name}", c.metric.signals) for c in variants.columns),
        ("stable.position", s.position),
        ("stable.velocity", s.velocity),
        ("figure.y", variants.picture.y),
    ):
        for name in names:
            yield name.partition("[")[0], f"{variants.path} at {place}"


def check(base: Base, variants: Variants, chosen: ComparisonSelection) -> list[Plan]:
    """Refuse what cannot be assembled, before anything runs: each variant once; their plans.

    Raises ScenarioError that starts with the place of the variant, or of all that were tried
    together where it may be any of them.
    """
    first = Case(chosen.controllers[0], chosen.operators[0], chosen.links[0], base.seed)
    together = f"controllers.{first.controller}, operators.{first.operator}, links.{first.link}"
    cases = {together: first}
    cases |= {f"controllers.{x}": replace(first, controller=x) for x in chosen.controllers[1:]}
    cases |= {f"operators.{x}": replace(first, operator=x) for x in chosen.operators[1:]}
    cases |= {f"links.{x}": replace(first, link=x) for x in chosen.links[1:]}
    plans = []
    for name, case in cases.items():
        plans.append(_assembled(base, variants, case, name))
        slots = plans[-1].slots()
        for signal, place in signals_read(variants):
            if signal not in slots:
                sentence = f"with {name}, {unknown(signal, slots, 'signal')}"
                raise ScenarioError(sentence, place)
    return plans


def _assembled(base: Base, variants: Variants, case: Case, name: str) -> Plan:
    """The plan of a case; errors mention `name`."""
    try:
        return assemble(scenario(base, variants, case))
    except CosimError as error:
        text = f"does not fit into the scenario: {error}"
        raise ScenarioError(text, f"{variants.path} at {name}") from None


# ---- what is replaced ---------------------------------------------------------------------------


def _hold(document: Document, operator: Operator, variants: Variants) -> None:
    """Give the arms the operator's values, whichever table of theirs has had them before.

    Its components come in as well. Raises ScenarioError where the scenario has one of that name.
    """
    roles, components = variants.roles, document["components"]
    for name, values in operator.values.items():
        arm = components[roles[name].arm]
        for table in ("parameters", "start"):
            arm[table] = {k: v for k, v in arm.get(table, {}).items() if k not in values}
        arm["parameters"] |= values
    for name, given in operator.components.items():
        if name in components:
            place = f"{variants.path} at operators.{operator.name}.components"
            raise ScenarioError(f"the scenario has a component {name!r} already", place)
        inputs = {port: _arm_of(end, roles) for port, end in given.get("inputs", {}).items()}
        model = _model(str(given.get("model", "")), variants.path.parent)
        components[name] = {**given, "model": model, "inputs": inputs}
    for name, fed in operator.feeds.items():
        arm = components[roles[name].arm]
        arm["inputs"] = {**arm.get("inputs", {}), **fed}
        arm["start"] = {k: v for k, v in arm.get("start", {}).items() if k not in fed}


def _arm_of(end: Any, roles: Mapping[str, Role]) -> Any:
    """``ROLE.port`` as the port of that role's arm; any other end as it is."""
    name, dot, port = str(end).partition(".")
    return f"{roles[name].arm}.{port}" if dot and name in roles else end


def _control(
    document: Document,
    controller: Controller,
    variants: Variants,
    law: LinkLaw,
    values: Mapping[str, Any],
) -> None:
    """Put a controller into its roles, with `values` of the operator over its parameters.

    Where it receives from several roles, its size `neighbours` is their number.
    """
    components = document["components"]
    for name, side in controller.sides.items():
        role = variants.roles[name]
        made = {**side.component, "model": _model(side.component["model"], variants.path.parent)}
        made["parameters"] = {**made.get("parameters", {}), **values}
        if (senders := len(law.senders(name, role))) > 1:
            made["sizes"] = {**made.get("sizes", {}), "neighbours": senders}
        made.setdefault("period", components[role.controller].get("period"))
        made["inputs"] = {port: _end(role, source) for port, source in side.inputs.items()}
        components[role.controller] = {k: v for k, v in made.items() if v is not None}
        for part, (keys, wires) in side.parts.items():
            whole = f"{role.arm}_{part}"
            if whole in components:
                place = f"{variants.path} at controllers.{controller.name}.components.{part}"
                raise ScenarioError(f"the scenario has a component {whole!r} already", place)
            inputs = {port: _end(role, source) for port, source in wires.items()}
            model = _model(keys["model"], variants.path.parent)
            components[whole] = {**keys, "model": model, "inputs": inputs}
        driven = {port: _end(role, source) for port, source in side.drives.items()}
        wired = components[role.arm].get("inputs", {}).items()  # by port, or entry by entry
        kept = {port: wire for port, wire in wired if port.partition("[")[0] not in driven}
        components[role.arm]["inputs"] = kept | driven


def _links(controller: Controller, law: LinkLaw, variants: Variants) -> list[Document]:
    """The signals that each side receives from the others, one channel per direction."""
    made = []
    for here, role in variants.roles.items():
        senders = law.senders(here, role)
        for row, there in enumerate(senders):
            for port, source in controller.sides[here].receives.items():
                target = port if len(senders) == 1 else f"{port.partition('[')[0]}[{row}]"
                ends = {
                    "from": _end(variants.roles[there], source),
                    "to": f"{role.controller}.{target}",
                    "channel": f"{there}->{here}",
                }
                made.append({**ends, **_link_options(law.received_by(here), variants.path.parent)})
    return made


def _end(role: Role, port: tuple[str, str]) -> str:
    owner, name = port
    own = {"arm": role.arm, "controller": role.controller}
    return f"{own.get(owner, f'{role.arm}_{owner}')}.{name}"


def _touches(link: Any, replaced: tuple[str, ...]) -> bool:
    """True if a link of the scenario has an end at a replaced controller."""
    return isinstance(link, dict) and any(
        str(link.get(key, "")).startswith(replaced) for key in ("from", "to")
    )


def _model(model: str, folder: Path) -> str:
    """A model's name; the path of an FMU or a scene is relative to the variants file."""
    if model.startswith(PREFIX):
        return f"{PREFIX}{scene_path(model, folder).absolute()}"
    return str((folder / model).absolute()) if model.endswith(".fmu") else model


def _link_options(options: Mapping[str, Any], folder: Path) -> Document:
    """The options of a link; files of its law are relative to the variants file."""
    delay = options["delay"]
    if not isinstance(delay, dict):
        return dict(options)
    files = {key: str((folder / str(delay[key])).absolute()) for key in _FILES if key in delay}
    return {**options, "delay": delay | files}
