"""A flattened SSP as the document of a scenario: what ``cosim run system.ssp`` runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cosim.base.errors import ScenarioError
from cosim.base.toml import change
from cosim.scenario.connect import unknown
from cosim.scenario.spec import Scenario, build
from cosim.ssp import annotation
from cosim.ssp.archive import unpack
from cosim.ssp.parts import SspPart, components
from cosim.ssp.structure import Structure, read
from cosim.ssp.values import SspValue
from cosim.ssp.wires import feed

#: Where an SSP says how long a step of the master is: local names of elements, and an attribute.
#: The first are of OMSimulator and early OSP, the last of the Open Simulation Platform.
_STEPS = {
    "FixedStepMaster": "stepSize",
    "FixedStepSolver": "stepSize",
    "DefaultExperiment": "stepSize",
    "FixedStepAlgorithm": "baseStepSize",
}


def load(path: str | Path, settings: Sequence[str] = ()) -> Scenario:
    """Read an SSP as a scenario and apply ``path=value`` settings. Raises ScenarioError.

    Its algorithm is jacobi, as in other tools, unless our annotation says otherwise. Nested systems
    are flattened: ``outer.arm`` becomes the component ``outer_arm``.
    """
    path = Path(path)
    made = document(path)
    for setting in settings:
        change(made, setting)
    for key, hint in (("step", "1 ms"), ("stop", "10 s")):
        if key not in made["run"]:
            message = f"the SSP does not say {key}; say --set run.{key}='\"{hint}\"'"
            raise ScenarioError(message, str(path))
    return build(made, path)


def document(path: str | Path) -> dict[str, Any]:
    """An SSP as the document of a scenario; `run` may lack step and stop.

    Raises ScenarioError if the SSP cannot be read.
    """
    return read_structure(Path(path))[0]


def ignored(path: str | Path) -> list[str]:
    """Sentences about values of an SSP that no FMU has a variable for. Raises ScenarioError."""
    return read_structure(Path(path))[1].ignored


def read_structure(
    path: Path,
) -> tuple[dict[str, Any], Structure, dict[tuple[str, ...], str]]:
    """The document of an SSP, its structure, and the names of components by those in the SSD.

    Raises ScenarioError.
    """
    folder = unpack(path)
    structure = read(folder, str(path))
    parts = components(structure)
    run: dict[str, Any] = {"algorithm": "jacobi"}
    experiment = structure.root.child("DefaultExperiment")
    if experiment is not None:
        if start := experiment.number("startTime", 0.0):
            run["start"] = start
        if experiment.get("stopTime"):
            run["stop"] = experiment.number("stopTime")
    step = _step(structure, parts)
    if step is not None:
        run["step"] = step
    made: dict[str, Any] = {
        "title": structure.root.get("name") or path.stem,
        "run": run,
        "components": {part.name: part.table() for part in parts.values()},
    }
    fed = {target for target in structure.edges if feed(structure, parts, target)}
    for (owner, name), value in structure.values.items():
        if owner in parts and (owner, name) not in fed:
            _set(structure, parts[owner], name, value)
    structure.ignored += [sentence for part in parts.values() for sentence in part.ignored]
    said = annotation.read(structure.root)
    made = annotation.apply(said, made, folder) if said is not None else made
    return made, structure, {path: part.name for path, part in parts.items()}


def _set(structure: Structure, part: SspPart, name: str, value: SspValue) -> None:
    """Set a value; one that the FMU has no variable for is ignored (SSP 1.0, clause 4.5.1)."""
    if part.has(name):
        part.set(name, value)
    else:
        said = unknown(name, part.names, f"variable of {part.name}")
        structure.ignored.append(f"{said}: its value is ignored")


def _step(structure: Structure, parts: Mapping[tuple[str, ...], SspPart]) -> float | None:
    """The step in the SSP (s), or else the shortest step that its FMUs propose."""
    for element in structure.root.element.iter():
        tag = element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""
        text = element.get(_STEPS.get(tag, ""), "")
        if text:
            try:
                return float(text)
            except ValueError:
                message = f"{_STEPS[tag]} {text!r} is no number"
                raise ScenarioError(message, structure.root.place) from None
    steps = [p.fmu.description.default_step for p in parts.values()]
    return min((s for s in steps if s), default=None)
