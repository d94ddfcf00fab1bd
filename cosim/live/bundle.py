"""The bundle of a scenario: everything that a page needs to compute its runs, as plain data."""

from __future__ import annotations

import base64
import zlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.errors import CosimError
from cosim.base.parts import part
from cosim.base.toml import change
from cosim.engine.initialization import exits
from cosim.live.image import LiveError
from cosim.live.keys import Movable, movable
from cosim.live.layout import layout
from cosim.live.plan_image import PlanImage, fmu_of, plan_image
from cosim.loading import one_fmu
from cosim.loading.files import read_document
from cosim.native import structs
from cosim.native.enums import LOG_LINES, LOG_WIDTH
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario, as_data, build
from cosim.schedule.parts import Step

#: Of bundles: a page and its data belong together.
FORMAT = 1
_STRUCTS = {
    "engine": structs.EngineStruct, "start": structs.StartStruct, "units": structs.UnitStruct,
    "links": structs.LinkStruct, "players": structs.PlayerStruct, "tables": structs.TableStruct,
}  # fmt: skip


def script() -> str:
    """The text of ``engine.js``, which computes a bundle."""
    return (Path(__file__).parent / "assets" / "engine.js").read_text(encoding="utf-8")


def bundle(scenario: Scenario, settings: Sequence[str] = ()) -> dict[str, Any]:
    """The bundle of a scenario, to be written as JSON.

    `settings`: ``path=value``, with which it was read from its file. Raises LiveError with a
    sentence for one that a page cannot compute.
    """
    recorded = scenario.run.record.signals
    document = _document(scenario, settings)
    if document is None:
        found = Movable(plan_image(assemble(scenario), recorded))
    else:
        found = movable(document, scenario.path, recorded)
    return _bundle(scenario, found)


def bundle_of(document: Mapping[str, Any], path: Path, only: str = "") -> dict[str, Any]:
    """The bundle of a scenario, given as a file has it; `path`: to which its paths are relative.

    `only`: how the keys begin that can be moved. Raises LiveError as :func:`bundle`.
    """
    scenario = build(deepcopy(dict(document)), path)
    return _bundle(scenario, movable(document, path, scenario.run.record.signals, only))


def _bundle(scenario: Scenario, found: Movable) -> dict[str, Any]:
    made = found.image
    plan = made.plan
    return {
        "format": FORMAT,
        "title": scenario.title,
        "h": plan.h,
        "start": plan.start,
        "ticks": plan.ticks,
        "every": scenario.run.record.every,
        **found.facts(),
        **_recorded(made),
        **_memory(made),
        **_tables(made),
        "components": [_component(step) for step in plan.components],
        "order": exits(plan),
        "links": [link.name for link in plan.links],
        "engine": packed(_engine()),
        "modules": _modules(plan.components),
        "layouts": {
            name: {"size": layout(kind).size,
                   "members": {k: m.offset for k, m in layout(kind).fields.items()}}
            for name, kind in _STRUCTS.items()
        },
        "log": {"size": layout(structs.LogStruct).size, "lines": LOG_LINES, "width": LOG_WIDTH,
                "line": layout(structs.LogStruct).fields["line"].offset},
    }  # fmt: skip


def _document(scenario: Scenario, settings: Sequence[str]) -> dict[str, Any] | None:
    """The file of a scenario with these settings; None if that is not the scenario (any more)."""
    try:
        if scenario.path.suffix == ".fmu":
            document = one_fmu.document(scenario.path, settings)
        else:
            document = read_document(scenario.path)
            for setting in settings:
                change(document, setting)
        read = build(deepcopy(document), scenario.path)
    except CosimError:
        return None
    return document if as_data(read) == as_data(scenario) else None


def packed(data: bytes) -> str:
    """A block of a bundle: compressed by zlib, in base64."""
    return base64.b64encode(zlib.compress(data, 9)).decode()


def _recorded(made: PlanImage) -> dict[str, Any]:
    """The signals that are recorded, by port, and where their entries are."""
    signals: dict[str, dict[str, Any]] = {}
    for column in made.columns:
        name = column.name.partition("[")[0]
        signals.setdefault(name, {"name": name, "unit": column.unit, "names": []})
        signals[name]["names"].append(column.name)
    return {"columns": [c.index for c in made.columns], "signals": [*signals.values()]}


def _memory(made: PlanImage) -> dict[str, Any]:
    """The image, and what has to be filled in."""
    image = made.image
    by_name = defaultdict[tuple[str, str], list[int]](list)
    for place, module, name in image.functions:
        by_name[module, name].append(place)
    functions = [
        {"module": module, "name": name, "places": places}
        for (module, name), places in by_name.items()
    ]
    return {
        "image": packed(image.content()),
        "inside": packed(np.array(image.inside, "<u4").tobytes()),
        "functions": functions,
        "instances": image.instances,
        "values": image.values,
        "logs": image.logs,
        "copies": made.copies,
        "places": made.places,
        "n_signals": made.plan.n_signals,
    }


def _tables(made: PlanImage) -> dict[str, Any]:
    links = made.plan.links
    return {
        "frozen": [
            {"link": i, "rows": packed(np.asarray(rows, "<i4").tobytes())}
            for i, rows in made.frozen.items()
        ],
        "drawn": [
            {"link": i, "name": links[i].name, "rows": made.hits(links[i].target.component)}
            for i in made.drawn
        ],
        "played": [packed(np.asarray(values, "<f8").tobytes()) for values in made.played],
    }


def _component(step: Step) -> dict[str, Any]:
    fmu = fmu_of(step)
    return {
        "name": step.name,
        "module": fmu.description.token,
        "fmi": int(fmu.description.fmi[0]),
        "token": fmu.description.token,
        "outputs": [
            {"signal": s.name, "at": s.start, "size": s.size, "names": s.scalars()}
            for s in step.outputs
        ],
    }


def _modules(steps: Sequence[Step]) -> dict[str, str]:
    """The models of components, each once, by the tokens of their FMUs."""
    one_of = {fmu_of(step).description.token: step for step in steps}
    return {token: packed(_code(step)) for token, step in one_of.items()}


def _code(step: Step) -> bytes:
    """The model of a component as WebAssembly. Raises LiveError."""
    fmu = fmu_of(step)
    try:
        found: bytes | None = part("wasm").module(fmu.archive.path, fmu.description.token)
    except CosimError as error:
        raise LiveError(f"{step.name}: {error}") from error
    if found is None:
        raise LiveError(
            f"{step.name}: {fmu.archive.path.name} is not built from a model of this project, of"
            " which a page needs the sources"
        )
    return found


@cache
def _engine() -> bytes:
    """The engine as WebAssembly. Raises LiveError."""
    path = Path(__file__).parents[1] / "_engine.wasm"
    if not path.is_file():
        raise LiveError(f"{path} is missing: install the project (pip install .), which builds it")
    return path.read_bytes()
