"""An SSP that was read, written again: what is in the archive stays, what was changed is added.

Nested systems, parameter sets, units, dictionaries, geometry and annotations of other tools are
kept as they are. Values that differ become one more binding of the outermost system, which takes
precedence (SSP 1.0, clause 4.5.1), and what SSP cannot express an annotation.
"""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from cosim.fmi.component import FmuComponent
from cosim.fmi.components import facts, is_text
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario, as_data, build
from cosim.schedule.plan import Plan
from cosim.ssp import annotation
from cosim.ssp.archive import ROOT, pack
from cosim.ssp.document import load, read_structure
from cosim.ssp.parameters import SSC, SSD, Entry, binding, values_of
from cosim.ssp.structure import Structure

#: Children of the root and of a system in the order of the schema, as far as they may be added.
_ROOT_ORDER = ("System", "Enumerations", "Units", "DefaultExperiment", "MetaData", "Signature",
               "Annotations")  # fmt: skip
_SYSTEM_FIRST = ("MetaData", "Signature", "Connectors", "ElementGeometry", "ParameterBindings")


def rewrite(scenario: Scenario, plan: Plan, out: Path) -> list[str] | None:
    """Write the SSP that `scenario` was read from, with its changes; returns what is to be said.

    None, and nothing is written, if its components or connections were changed: these are no
    additions. Raises ScenarioError if a file cannot be written.
    """
    source = scenario.path
    made, structure, names = read_structure(source)
    before = build({**made, "run": as_data(scenario)["run"]}, source)
    changed = _changed((before, assemble(before)), (scenario, plan))
    if changed is None:
        return None
    with zipfile.ZipFile(source) as archive:
        files = {n: archive.read(n) for n in archive.namelist() if not n.endswith("/")}
    original = build({**made, "run": made["run"] | _missing(made, scenario)}, source)
    if not changed and as_data(original) == as_data(scenario):
        pack(files, out)
        return []
    entries = _entries(scenario, structure, names, changed)
    if entries is None:
        return None
    files[ROOT] = _described(files[ROOT], scenario, plan, entries, files)
    with tempfile.TemporaryDirectory(prefix="ssp-") as scratch:
        pack(files, trial := Path(scratch) / out.name)
        again = load(trial)
        if not _same((again, assemble(again)), (scenario, plan)):
            return None
    pack(files, out)
    return _notes(made, scenario, plan)


def _missing(made: Mapping[str, Any], scenario: Scenario) -> dict[str, Any]:
    """The step and stop where the SSP does not say them; then they are additions."""
    return {k: -1.0 for k in ("step", "stop") if k not in made["run"]}


def _notes(made: Mapping[str, Any], scenario: Scenario, plan: Plan) -> list[str]:
    said = made["run"].get("step")
    step = None if said is None else scenario.seconds(said, "run", "step")
    if step == plan.h:
        return []
    theirs = "no step" if step is None else f"a step of {step:g} s"
    return [f"other tools find {theirs} in the file, not {plan.h:g} s"]


# ---- what was changed -----------------------------------------------------------------------

#: Numbers and texts by port; by component.
Given = dict[str, Any]
Changed = dict[str, Given]


def _changed(before: tuple[Scenario, Plan], after: tuple[Scenario, Plan]) -> Changed | None:
    """Values that differ, by component and port; None if the structure does."""
    old, new = before[1], after[1]
    if _wires(old) != _wires(new) or _sums(old) != _sums(new):
        return None
    found: Changed = {}
    for name, (mine, theirs) in _pairs(_values(*before), _values(*after)):
        if set(mine) - set(theirs):
            return None
        differ = {k: v for k, v in theirs.items() if mine.get(k) != v}
        if differ:
            found[name] = differ
    return found


def _pairs(one: Changed, other: Changed) -> Iterator[tuple[str, tuple[Given, Given]]]:
    return ((name, (one[name], other[name])) for name in one)


def _sums(plan: Plan) -> list[tuple[str, str]]:
    """Components and the checksums of their FMUs."""
    return [(c.name, (facts(c.component) or {}).get("sha256", "")) for c in plan.components]


def _wires(plan: Plan) -> list[tuple[str, str, float, float]]:
    return [(w.source.name, w.target.name, w.gain, w.offset) for w in plan.wires]


def _values(scenario: Scenario, plan: Plan) -> Changed:
    found = {}
    for step in plan.components:
        spec = scenario.components[step.name]
        texts = {
            k: v for k, v in {**spec.parameters, **spec.start}.items() if is_text(step.component, k)
        }
        found[step.name] = {**step.values, **step.start, **texts}
    return found


def _same(one: tuple[Scenario, Plan], other: tuple[Scenario, Plan]) -> bool:
    """True if two scenarios have the same components, values and wires, and the same step (s)."""
    mine, theirs = (
        ([(c.name, c.kind, c.period) for c in p.components], _wires(p), p.h, p.ticks, _values(s, p))
        for s, p in (one, other)
    )
    return mine == theirs


def _entries(
    scenario: Scenario,
    structure: Structure,
    names: Mapping[tuple[str, ...], str],
    changed: Changed,
) -> list[Entry] | None:
    """Changed values with the hierarchical names of the outermost system; None if one has none."""
    found: list[Entry] = []
    for path, name in names.items():
        if name not in changed:
            continue
        fmu = FmuComponent(scenario.components[name].model, name)
        numbers = {k: v for k, v in changed[name].items() if not fmu.is_text(k)}
        texts = {k: v for k, v in changed[name].items() if fmu.is_text(k)}
        for variable, kind, text in values_of(fmu, numbers, texts):
            full = ".".join((*path, variable))
            if structure.elements[()].connector(full) != (path, variable):
                return None
            found.append((full, kind, text))
    return found


# ---- the description ------------------------------------------------------------------------


def _described(
    text: bytes,
    scenario: Scenario,
    plan: Plan,
    entries: list[Entry],
    files: dict[str, bytes],
) -> bytes:
    """The description with these values, the end of the run, and our annotation."""
    root = _parsed(text)
    system = next(x for x in root if _tag(x) == "System")
    if entries:
        bindings = _child(system, "ParameterBindings", _SYSTEM_FIRST, system.tag)
        bindings.append(binding(entries))
    experiment = _child(root, "DefaultExperiment", _ROOT_ORDER, root.tag)
    if plan.start or experiment.get("startTime"):
        experiment.set("startTime", repr(plan.start))
    experiment.set("stopTime", repr(plan.end))
    notes = _child(root, "Annotations", _ROOT_ORDER, root.tag)
    for old in [x for x in notes if x.get("type") == annotation.TYPE]:
        notes.remove(old)
    annotation.write(notes, annotation.content(scenario, files), SSC)
    written: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return written


def _parsed(text: bytes) -> Element:
    """The root, with comments; prefixes of namespaces are written as they were read."""
    builder = ElementTree.TreeBuilder(insert_comments=True, insert_pis=True)
    parser = ElementTree.XMLParser(target=builder)
    root = ElementTree.fromstring(text, parser=parser)
    known = {"ssc": SSC, "ssd": SSD, "cosim": annotation.NAMESPACE}
    read = ElementTree.iterparse(io.BytesIO(text), events=("start-ns",))
    for prefix, uri in (*known.items(), *(found for _, found in read)):
        with suppress(ValueError):  # ns0 and the like are not for us to give
            ElementTree.register_namespace(prefix, uri)
    return root


def _tag(element: Element) -> str:
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def _child(parent: Element, name: str, order: tuple[str, ...], like: str) -> Element:
    """The child of that name, which is put where the schema has it if there is none."""
    for child in parent:
        if _tag(child) == name:
            return child
    before = order[: order.index(name)]
    at = max((i + 1 for i, x in enumerate(parent) if _tag(x) in before), default=0)
    made = Element(f"{like.rpartition('}')[0]}}}{name}")
    parent.insert(at, made)
    return made
