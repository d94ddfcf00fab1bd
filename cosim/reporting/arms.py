"""The robots of a run that can be drawn: what their models say of their shape."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.component import Drawing, SharedBase
from cosim.base.copies import replace
from cosim.base.errors import CosimError
from cosim.base.names import counted
from cosim.record import Run
from cosim.reporting.many import ARMS

Array = NDArray[np.float64]


class DrawnArm(NamedTuple):
    """A component with the shape of its model, its `options`, and the `folder` of its scenario.

    Arms of one `workspace` (a number from 0) stand together, each on its `base`.
    """

    name: str
    drawing: Drawing
    options: Mapping[str, Any]
    folder: Path
    workspace: int = 0
    base: SharedBase = SharedBase()

    def data(self) -> dict[str, Any]:
        """The data that a page reads."""
        base = self.base.data()
        return {"name": self.name, **self.drawing.data(), "workspace": self.workspace, "base": base}


def first_arms(run: Run) -> tuple[list[DrawnArm], str]:
    """The arms of a picture, ARMS at the most, and a sentence if there are others ("": none)."""
    found = list(islice(drawn_arms(run), ARMS + 1))
    note = f"Only the first {ARMS} arms are drawn." if len(found) > ARMS else ""
    return in_workspaces(found[:ARMS], run.metadata), note


def drawn_arms(run: Run) -> Iterator[DrawnArm]:
    """The components of a run whose model can be drawn and whose positions were recorded.

    In the order of their names, in which numbers count.
    """
    scenario = run.metadata.get("scenario", {})
    folder = Path(scenario.get("path", ".")).parent
    components = scenario.get("components", {})
    for name in sorted(components, key=counted):
        spec = components[name]
        options = spec.get("options") or {}
        drawing = drawing_of(str(spec.get("model", "")), options, folder)
        if drawing is not None and recorded(run, f"{name}.{drawing.position}", drawing.joints):
            yield DrawnArm(name, drawing, options, folder)


def owners(arms: Sequence[str], facts: Mapping[str, Any]) -> dict[str, int]:
    """The number of the arm that a component is of: that it is, or the only one that feeds it."""
    found = {name: number for number, name in enumerate(arms)}
    for name, spec in _components(facts).items():
        sources = {str(wire).partition(".")[0] for wire in (spec.get("inputs") or {}).values()}
        fed = [number for number, arm in enumerate(arms) if arm in sources]
        if name not in found and len(fed) == 1:
            found[name] = fed[0]
    return found


def curve_colours(names: Sequence[str], of: Mapping[str, int]) -> tuple[int, ...]:
    """The numbers of the colours of curves, where each is of another arm; () for any others.

    `names`: of their signals; `of`: the arm of each component, as :func:`owners` has it.
    """
    found = [of.get(name.partition(".")[0], -1) for name in names]
    return tuple(found) if len({*found}) == len(found) and -1 not in found else ()


def in_workspaces(arms: Sequence[DrawnArm], facts: Mapping[str, Any]) -> list[DrawnArm]:
    """The arms, those in one workspace that are meant to agree. `facts`: ``run.json``.

    Arms are meant to agree if a metric of kind ``error`` compares them, or a link joins components
    of theirs. They stand together if the model of a controller of each tells where its base is in
    common coordinates, or if all are alike: then on the same base. Else each stands by itself.
    """
    of = owners([arm.name for arm in arms], facts)
    group = list(range(len(arms)))
    for names in _tied(facts):
        together = {group[of[name]] for name in names if name in of}
        group = [min(together) if g in together else g for g in group]
    bases: dict[int, SharedBase] = {}
    for name, spec in _components(facts).items():
        number = of.get(name, -1)
        base = None if number < 0 else _base_of(spec, arms[number].folder)
        if base is not None:
            bases[number] = base
    keys = []
    for number, arm in enumerate(arms):
        kind: Any = "common" if number in bases else arm.drawing
        keys.append((group[number], kind))
    numbers = {key: k for k, key in enumerate(dict.fromkeys(keys))}
    return [
        _placed(arm, numbers[key], bases.get(number) if keys.count(key) > 1 else None)
        for number, (arm, key) in enumerate(zip(arms, keys, strict=True))
    ]


def _placed(arm: DrawnArm, workspace: int, base: SharedBase | None) -> DrawnArm:
    if base is None:
        return arm._replace(workspace=workspace)
    drawing = replace(arm.drawing, tip=base.tip or arm.drawing.tip)
    return arm._replace(workspace=workspace, base=base, drawing=drawing)


def _components(facts: Mapping[str, Any]) -> Mapping[str, Any]:
    found: Mapping[str, Any] = facts.get("scenario", {}).get("components") or {}
    return found


def _tied(facts: Mapping[str, Any]) -> Iterator[list[str]]:
    """Components that the scenario compares or joins by a link."""
    for metric in (facts.get("scenario", {}).get("metrics") or {}).values():
        if metric.get("kind") == "error":
            target = metric.get("target")
            signals = [*metric.get("of", ()), *([target] if isinstance(target, str) else [])]
            yield [signal.partition(".")[0] for signal in signals]
    for link in facts.get("links") or {}:
        yield [end.partition(".")[0] for end in link.split("->")]


def _base_of(spec: Mapping[str, Any], folder: Path) -> SharedBase | None:
    given = (spec.get("options") or {}, spec.get("parameters") or {})
    found = _told(str(spec.get("model", "")), "shared_base", *given, folder)
    return found if isinstance(found, SharedBase) else None


def recorded(run: Run, signal: str, joints: int) -> bool:
    """True if a signal of so many entries was recorded."""
    return run.has(signal) and len(run.entries(signal)) == joints


def arm_signals(run: Run, arm: DrawnArm) -> dict[str, tuple[str, ...]]:
    """The names of the scalars that move a drawn arm: ``q``, and ``torque`` where it has one."""
    torque, joints = f"{arm.name}.{arm.drawing.torque}", arm.drawing.joints
    forced = arm.drawing.torque and recorded(run, torque, joints)
    return {
        "q": run.entries(f"{arm.name}.{arm.drawing.position}"),
        "torque": run.entries(torque) if forced else (),
    }


def drawing_of(model: str, options: Mapping[str, Any], folder: Path) -> Drawing | None:
    """The shape that a model's module gives; None: it has none, or cannot say."""
    found = _told(model, "drawing", options, folder)
    return found if isinstance(found, Drawing) else None


def _told(model: str, hook: str, *given: Any) -> object:
    """The answer of a function of a model's module; None: it has none, or cannot say."""
    if not model.replace(".", "").isidentifier() or model.endswith(".fmu"):
        return None
    try:
        call = vars(importlib.import_module(model)).get(hook)
        return None if call is None else call(*given)
    except (
        CosimError,
        ImportError,
        OSError,
        SystemExit,
    ):  # the file of the robot may be elsewhere by now
        return None


def points(drawing: Drawing, q: Array) -> Array:
    """The base, the origin of each link's frame, and the tip, in the base's frame, (n + 2, 3) m."""
    R, p = np.eye(3), np.zeros(3)
    found = [p]
    for rotation, origin in link_frames(drawing, q):
        p = p + R @ origin
        R = R @ rotation
        found.append(p)
    return np.array([*found, p + R @ np.asarray(drawing.tip)])


def in_workspace(base: SharedBase, where: Array) -> Array:
    """Points (m, 3) of an arm in the coordinates of its workspace, (m, 3) m."""
    moved = (where - np.asarray(base.origin)) @ np.reshape(base.rotation, (3, 3)).T
    return np.asarray(base.scale * moved, dtype=np.float64)


def link_frames(drawing: Drawing, q: Array) -> Iterator[tuple[Array, Array]]:
    """Rotation (3, 3) and origin (3,), m, of each link's frame in its parent's, at `q`."""
    shapes = zip(drawing.prismatic, drawing.rotations, drawing.origins, q, strict=True)
    for prismatic, rotation, origin, x in shapes:
        R, r = np.reshape(rotation, (3, 3)), np.asarray(origin, dtype=np.float64)
        if prismatic:
            yield R, r + R[:, 2] * x
        else:
            c, s = np.cos(x), np.sin(x)
            yield R @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), r
