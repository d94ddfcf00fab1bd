"""The robots of a run that can be drawn: what their models say of their shape."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.component import Drawing
from cosim.base.errors import CosimError
from cosim.base.names import counted
from cosim.record import Run
from cosim.reporting.many import ARMS

Array = NDArray[np.float64]


class DrawnArm(NamedTuple):
    """A component with the shape of its model, its `options`, and the `folder` of its scenario."""

    name: str
    drawing: Drawing
    options: Mapping[str, Any]
    folder: Path


def first_arms(run: Run) -> tuple[list[DrawnArm], str]:
    """The arms of a picture, ARMS at the most, and a sentence if there are others ("": none)."""
    found = list(islice(drawn_arms(run), ARMS + 1))
    return found[:ARMS], f"Only the first {ARMS} arms are drawn." if len(found) > ARMS else ""


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


def recorded(run: Run, signal: str, joints: int) -> bool:
    """True if a signal of so many entries was recorded."""
    return run.has(signal) and len(run.entries(signal)) == joints


def drawing_of(model: str, options: Mapping[str, Any], folder: Path) -> Drawing | None:
    """The shape that a model's module gives; None: it has none, or cannot say."""
    if not model.replace(".", "").isidentifier() or model.endswith(".fmu"):
        return None
    try:
        hook = vars(importlib.import_module(model)).get("drawing")
        found = None if hook is None else hook(options, folder)
    except (
        CosimError,
        ImportError,
        OSError,
        SystemExit,
    ):  # the file of the robot may be elsewhere by now
        return None
    return found if isinstance(found, Drawing) else None


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
