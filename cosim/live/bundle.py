"""The bundle of a scenario: everything that a page needs to compute its runs, as plain data."""

from __future__ import annotations

import base64
import zlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.archive import cache_folder
from cosim.base.errors import CosimError, RunError
from cosim.base.files import write_file
from cosim.base.parts import part
from cosim.base.toml import change
from cosim.engine.initialization import exits
from cosim.live.image import LiveError
from cosim.live.keys import TRIES, movable
from cosim.live.layout import layout
from cosim.live.movable import Movable
from cosim.live.plan_image import PlanImage, effort, fmu_of, plan_image, refuse
from cosim.loading import one_fmu
from cosim.loading.files import read_document
from cosim.native import structs
from cosim.native.enums import LOG_LINES, LOG_WIDTH
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario, as_data, build
from cosim.schedule.parts import Step
from cosim.schedule.plan import Plan

#: Of bundles: a page and its data belong together.
FORMAT = 1
#: Effort of a bundle that was not asked for (half a second, see :func:`effort`), and plans that it
#: takes at least to find out what can be moved.
EFFORT, LEAST_TRIES = 256, 8
_STRUCTS = {
    "engine": structs.EngineStruct, "start": structs.StartStruct, "units": structs.UnitStruct,
    "links": structs.LinkStruct, "players": structs.PlayerStruct, "tables": structs.TableStruct,
}  # fmt: skip


def script() -> str:
    """The text of ``engine.js``, which computes a bundle."""
    return (Path(__file__).parent / "assets" / "engine.js").read_text(encoding="utf-8")


def bundle(
    scenario: Scenario,
    settings: Sequence[str] = (),
    plan: Plan | None = None,
    *,
    asked: bool = True,
) -> dict[str, Any]:
    """The bundle of a scenario, to be written as JSON.

    `settings`: ``path=value``, with which it was read from its file; `plan`: of the scenario, if
    there is one. `asked`: False if it has to be made fast, or not at all. Raises LiveError with a
    sentence for a scenario that a page cannot compute, CosimError for one that does not start.
    """
    plan = assemble(scenario) if plan is None else plan
    refuse(plan)
    tries = TRIES if asked else _affordable(plan)
    modules = _modules(plan.components, build=asked)
    recorded = scenario.run.record.signals
    document = _document(scenario, settings)
    if document is None:
        found = Movable(plan_image(assemble(scenario), recorded))
    else:
        found = movable(document, scenario.path, recorded, tries)
    if not (asked or found.keys):
        raise LiveError("none of its values can be moved")
    return _bundle(scenario, found, modules)


def bundle_of(document: Mapping[str, Any], path: Path, only: str = "") -> dict[str, Any]:
    """The bundle of a scenario, given as a file has it; `path`: to which its paths are relative.

    `only`: how the keys begin that can be moved. Raises LiveError as :func:`bundle`.
    """
    scenario = build(deepcopy(dict(document)), path)
    found = movable(document, path, scenario.run.record.signals, only=only)
    return _bundle(scenario, found, _modules(found.image.plan.components, build=True))


def _bundle(scenario: Scenario, found: Movable, modules: Mapping[str, str]) -> dict[str, Any]:
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
        "engine": _engine()[0],
        "modules": modules,
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


def _affordable(plan: Plan) -> int:
    """Plans that a report which was not asked for may make. Raises LiveError if they are few."""
    found = min(TRIES, EFFORT // effort(plan))
    if found < LEAST_TRIES:
        raise LiveError(
            f"{len(plan.components)} components and their tables take long to prepare; --live does"
            " it in any case"
        )
    return found


def packed(data: bytes) -> str:
    """A block of a bundle: compressed by zlib, in base64."""
    return base64.b64encode(zlib.compress(data)).decode()


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


def _modules(steps: Sequence[Step], *, build: bool) -> dict[str, str]:
    """The models of components, packed, each once, by the tokens of their FMUs.

    `build`: True to compile those that are not. Raises LiveError.
    """
    one_of = {fmu_of(step).description.token: step for step in steps}
    return {token: _module(step, build=build) for token, step in one_of.items()}


def _module(step: Step, *, build: bool) -> str:
    """The model of a component, packed; the cache keeps it, since archives are slow to read."""
    version = _engine()[1]
    kept = cache_folder() / "wasm" / f"{fmu_of(step).archive.sha256[:32]}-{version}"
    with suppress(OSError, zlib.error):
        found = kept.read_bytes()
        zlib.decompress(found)  # it may be damaged
        return base64.b64encode(found).decode()
    code = packed(_code(step, build=build))
    with suppress(OSError, RunError):
        kept.parent.mkdir(parents=True, exist_ok=True)
        write_file(kept, base64.b64decode(code))
    return code


def _code(step: Step, *, build: bool) -> bytes:
    """The model of a component as WebAssembly. Raises LiveError."""
    fmu = fmu_of(step)
    try:
        found: bytes | None = part("wasm").module(
            fmu.archive.path, fmu.description.token, build=build
        )
    except CosimError as error:
        raise LiveError(f"{step.name}: {error}") from error
    if found is None:
        raise LiveError(
            f"{step.name}: {fmu.archive.path.name} is not built from a model of this project, of"
            " which a page needs the sources"
        )
    return found


@cache
def _engine() -> tuple[str, str]:
    """The engine as WebAssembly, packed, and a digest of it. Raises LiveError."""
    path = Path(__file__).parents[1] / "_engine.wasm"
    if not path.is_file():
        raise LiveError(f"{path} is missing: install the project (pip install .), which builds it")
    code = path.read_bytes()
    return packed(code), sha256(code).hexdigest()[:16]
