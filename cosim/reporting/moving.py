"""The arms of a run as an animated GIF, drawn as in the report: planar ones from above.

Their names, the time, and whether there are more of them stand below the drawing.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import RunError, ScenarioError
from cosim.base.extras import require
from cosim.record import Run
from cosim.record.piecewise import RunRows, rows_at
from cosim.record.signals import Signals
from cosim.reporting.arms import DrawnArm, first_arms, in_workspace, points
from cosim.reporting.figures import COLOURS

Array = NDArray[np.float64]
#: Pictures a second, and how many at the most.
RATE, MOST = 15.0, 600
#: Width and height of the drawing, height of a line of text below it, gap between names; pixels.
SIZE, LINE, GAP = 400, 14, 12
#: Directions from which arms in space are seen, rad: about the vertical, and above the horizon.
_YAW, _PITCH = -0.6, 0.4


def write_gif(run: Run, path: Path) -> Path:
    """Draw the arms of a run, RATE pictures a second; of a long run fewer, at its speed.

    Raises ScenarioError where no arm can be drawn or Pillow is missing, RunError if the file cannot
    be written.
    """
    require("PIL")
    from PIL import Image, ImageDraw

    found, note = first_arms(run)
    if not found:
        raise ScenarioError("no arm of this run can be drawn", str(run.path))
    begin, end = run.span
    period = max(1.0 / RATE, (end - begin) / MOST)
    rows = rows_at(run, np.arange(begin, end + 1e-9, period))
    names = [x for arm in found for x in run.entries(f"{arm.name}.{arm.drawing.position}")]
    shown = RunRows(run, names, rows)
    flat = all(arm.drawing.planar for arm in found)
    tracks = [_track(shown, arm, flat=flat) for arm in found]
    places, scale = _layout(tracks, [arm.workspace for arm in found], flat=flat)
    labels = _name_places([arm.name for arm in found])
    height = SIZE + labels[-1][1] + 2 * LINE + 4
    pictures = []
    for i, t in enumerate(shown.t):
        picture = Image.new("RGB", (SIZE, height), "white")
        pen = ImageDraw.Draw(picture)
        pen.text((8, height - LINE - 4), f"{t:.2f} s  {note}", fill="#555555")
        for j, (arm, track) in enumerate(zip(found, tracks, strict=True)):
            colour = COLOURS[j % len(COLOURS)]
            line = [tuple(p) for p in pixels(track[i] - places[j], scale)]
            pen.line(line, fill=colour, width=5 if j % 2 == 0 else 3, joint="curve")
            for x, y in line[:-1]:
                pen.ellipse((x - 4, y - 4, x + 4, y + 4), fill="white", outline=colour, width=2)
            pen.text((8 + labels[j][0], SIZE + labels[j][1]), arm.name, fill=colour)
        pictures.append(picture.quantize(32))
    try:
        pictures[0].save(
            path, save_all=True, append_images=pictures[1:], duration=round(1e3 * period), loop=0
        )
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror or error}") from error
    return path


def _name_places(names: Sequence[str]) -> list[tuple[int, int]]:
    """The place of each name below the drawing, (x, y) pixels: as many in a line as fit."""
    from PIL import ImageFont

    places, x, y = [], 0, 0
    for name in names:
        width = ceil(ImageFont.load_default().getlength(name))
        if x > 0 and x + width > SIZE - 16:
            x, y = 0, y + LINE
        places.append((x, y))
        x += width + GAP
    return places


def pixels(seen: Array, scale: float) -> Array:
    """Places (m, 2) m in pixels, y down."""
    return SIZE / 2 + np.array([1.0, -1.0]) * seen * scale


def _track(run: Signals, arm: DrawnArm, *, flat: bool) -> Array:
    """The points of an arm as seen at each row, (rows, points, 2) m."""
    q = run.array(f"{arm.name}.{arm.drawing.position}")
    where = [in_workspace(arm.base, points(arm.drawing, row)) for row in q]
    return np.stack([_seen(x, flat=flat) for x in where])


def _seen(where: Array, *, flat: bool) -> Array:
    """Points (m, 3) as seen, (m, 2) m: planar arms from above."""
    if flat:
        return where[:, :2]
    x = np.cos(_YAW) * where[:, 0] - np.sin(_YAW) * where[:, 1]
    y = np.sin(_YAW) * where[:, 0] + np.cos(_YAW) * where[:, 1]
    return np.stack([x, np.cos(_PITCH) * where[:, 2] + np.sin(_PITCH) * y], axis=1)


def _layout(
    tracks: Sequence[Array], workspaces: Sequence[int], *, flat: bool
) -> tuple[list[Array], float]:
    """The offset of the points of each arm, (2,) m, and pixels per m: workspaces stand in rows.

    In the middle of one `flat` workspace is the base.
    """
    numbers = range(max(workspaces) + 1)
    if flat and len(numbers) == 1:
        reach = max(float(np.abs(track).max()) for track in tracks)
        return [np.zeros(2)] * len(tracks), 0.45 * SIZE / max(reach, 1e-6)
    parts = [
        np.concatenate([
            track.reshape(-1, 2)
            for track, mine in zip(tracks, workspaces, strict=True)
            if mine == number
        ])
        for number in numbers
    ]  # fmt: skip
    boxes = [(part.min(axis=0), part.max(axis=0)) for part in parts]
    columns = ceil(sqrt(len(boxes)))
    rows = ceil(len(boxes) / columns)
    cell = 1.15 * np.max([high - low for low, high in boxes], axis=0)
    places = [
        (low + high) / 2 - cell * (k % columns - (columns - 1) / 2, (rows - 1) / 2 - k // columns)
        for k, (low, high) in enumerate(boxes)
    ]
    scale = 0.95 * SIZE / max(columns * cell[0], rows * cell[1], 1e-6)
    return [places[k] for k in workspaces], scale
