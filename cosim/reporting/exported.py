"""Runs for other tools: CSV, Parquet, MATLAB's ``.mat``, and MCAP and GIF with moving arms."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.component import Drawing
from cosim.base.errors import RunError, ScenarioError
from cosim.base.files import written_aside
from cosim.base.names import signal_of
from cosim.record import Run
from cosim.record.run import RunPiece
from cosim.reporting import matlab
from cosim.reporting.arms import DrawnArm, drawn_arms, link_frames, recorded
from cosim.reporting.moving import write_gif
from cosim.scenario.exposed import matching

Array = NDArray[np.float64]
Piece: TypeAlias = Run | RunPiece
#: Largest rate of transforms and joint states, Hz.
RATE = 100.0
#: Rows whose messages are made together.
ROWS = 1 << 12


def export_run(run: Run, path: Path, patterns: Sequence[str] = ()) -> Path:
    """Write a run to a file of the format that its suffix names; replaces an existing file.

    `patterns`: of the signals to write, such as ``master.*``; none: all. Raises ScenarioError for
    another suffix, a pattern without a signal or a missing library, RunError if it cannot be
    written.
    """
    write = FORMATS.get(path.suffix.lower())
    if write is None:
        raise ScenarioError(f"found {path.name!r}, expected a file ending in {', '.join(FORMATS)}")
    names = _chosen(run, patterns)
    with written_aside(path) as part:
        write(run, part, names)
    return path


def _chosen(run: Run, patterns: Sequence[str]) -> list[str]:
    """Names of the scalars that a pattern names, by themselves or by their signal."""
    if not patterns:
        return list(run.names)
    found: list[str] = []
    for pattern in patterns:
        names = {**dict.fromkeys(run.names), **dict.fromkeys(map(signal_of, run.names))}
        for name in matching(pattern, names) or [pattern]:
            found += run.entries(name)  # says which are near
    return [name for name in run.names if name in set(found)]


def _signals(names: Sequence[str]) -> dict[str, list[str]]:
    """Scalars by signal."""
    found: dict[str, list[str]] = {}
    for name in names:
        found.setdefault(signal_of(name), []).append(name)
    return found


# ---- tables -----------------------------------------------------------------------------------


def _csv(run: Run, path: Path, names: Sequence[str]) -> None:
    run.to_csv(path, names)


def _parquet(run: Run, path: Path, names: Sequence[str]) -> None:
    run.to_parquet(path, names)


def _mat(run: Run, path: Path, names: Sequence[str]) -> None:
    """``t`` (n, 1), a struct for each component with its signals (n, m), and ``units``."""
    tree: dict[str, Any] = {"t": _matrix(run, ["t"])}
    units: dict[str, Any] = {"t": matlab.text("s")}
    for signal, entries in _signals(names).items():
        *above, last = (_matlab_name(part) for part in signal.split("."))
        place, unit = tree, units
        for part in above:
            place, unit = place.setdefault(part, {}), unit.setdefault(part, {})
        place[last] = _matrix(run, entries)
        unit[last] = matlab.text(run.units[entries[0]])
    found = {name: _variable(one) for name, one in tree.items()}
    matlab.write(path, {**found, "units": _variable(units)})


def _variable(given: Any) -> matlab.Matrix:
    """A matrix, or a struct of those in a dictionary."""
    if isinstance(given, matlab.Matrix):
        return given
    return matlab.struct({name: _variable(one) for name, one in given.items()})


def _matrix(run: Run, entries: Sequence[str]) -> matlab.Matrix:
    """The rows of scalars side by side, (n, m)."""

    def parts() -> Iterator[bytes]:
        for name in entries:
            for piece in run.pieces([name]):
                yield piece.column(name).astype("<f8", copy=False).tobytes()

    return matlab.numbers((len(run), len(entries)), parts)


def _matlab_name(part: str) -> str:
    """A name that MATLAB takes: letters, digits and underscores, a letter first."""
    name = re.sub(r"\W", "_", part, flags=re.ASCII)
    return name if name[:1].isalpha() else f"x{name}"


# ---- MCAP -------------------------------------------------------------------------------------


def _mcap(run: Run, path: Path, names: Sequence[str]) -> None:
    """A topic for each component, and for each arm joint states, frames and a line along it.

    Log time is that of the run. ``run.json`` and the robots' files are attached.
    """
    try:
        import foxglove
    except ImportError:
        raise ScenarioError(
            "the Foxglove SDK is missing; expected cosim-bridge[foxglove]"
        ) from None
    context = foxglove.Context()
    topics = list(_topics(run, names, foxglove, context))
    arms = list(drawn_arms(run))
    moving = [_Moving(run, arm, context) for arm in arms]
    needed = [*names, *(signal for arm in moving for signal in arm.signals)]
    every = max(1, round(1.0 / (RATE * _step(run))))
    try:
        with foxglove.open_mcap(path, allow_overwrite=True, context=context) as file:
            for text, data in _attached(run, arms):
                file.attach(
                    log_time=0, create_time=0, name=text, media_type="text/plain", data=data
                )
            at = 0
            for piece in run.pieces(needed):
                _log(piece, at, topics, moving, every)
                at += len(piece.t)
    except RuntimeError as error:  # its own errors, with those of the system in them
        raise RunError(f"cannot write {path}: {error}") from error


def _step(run: Run) -> float:
    """The median time between the first rows, s."""
    t = next(iter(run.pieces(()))).t[:ROWS]
    return float(np.median(np.diff(t))) if len(t) > 1 else 1.0


def _log(
    piece: Piece, begin: int, topics: Sequence[_Topic], moving: Sequence[_Moving], every: int
) -> None:
    """Write the rows of a piece, of which the first is row `begin`; arms in each `every`-th one."""
    t_ns = np.rint(piece.t * 1e9).astype(np.int64).tolist()
    positions = [arm.rows(piece) for arm in moving]
    for first in range(0, len(t_ns), ROWS):
        rows = slice(first, first + ROWS)
        texts = [topic.texts(piece, rows) for topic in topics]
        for k, at in enumerate(t_ns[rows], first):
            for topic, text in zip(topics, texts, strict=True):
                topic.channel.log(next(text), log_time=at)
            if (begin + k) % every == 0:
                for arm, (q, dq) in zip(moving, positions, strict=True):
                    arm.log(begin + k, at, q[k], None if dq is None else dq[k])


def _attached(run: Run, arms: Sequence[DrawnArm]) -> Iterator[tuple[str, bytes]]:
    yield "run.json", json.dumps(run.metadata, indent=1).encode()
    files = {arm.folder / str(arm.options["urdf"]) for arm in arms if "urdf" in arm.options}
    for file in sorted(files):
        if file.is_file():
            yield file.name, file.read_bytes()


def _topics(run: Run, names: Sequence[str], sdk: Any, context: Any) -> Iterator[_Topic]:
    """The topics of the components that have signals."""
    parts: dict[str, dict[str, list[str]]] = {}
    for signal, entries in _signals(names).items():
        component, _, port = signal.partition(".")
        parts.setdefault(component, {})[port or component] = entries
    for component, ports in parts.items():
        yield _Topic(run, component, ports, sdk, context)


@final
class _Topic:
    """The messages of a component: an object with its ports, null where there is no number.

    All are made from one text, into which the numbers of a row are put: an encoder of each
    message took most of the time.
    """

    def __init__(
        self, run: Run, component: str, ports: Mapping[str, list[str]], sdk: Any, context: Any
    ) -> None:
        number = {"type": ["number", "null"]}
        fields = {
            port: {
                **({"type": "array", "items": number} if _is_array(entries) else number),
                "description": run.units[entries[0]],
            }
            for port, entries in ports.items()
        }
        schema = json.dumps({"type": "object", "properties": fields}).encode()
        self.channel = sdk.Channel(
            f"/{component}",
            message_encoding="json",
            context=context,
            schema=sdk.Schema(name=component, encoding="jsonschema", data=schema),
        )
        self._entries = [name for entries in ports.values() for name in entries]
        places = [
            f"{json.dumps(port).replace('%', '%%')}: {_places(entries)}"
            for port, entries in ports.items()
        ]
        self._text = "{" + ", ".join(places) + "}"

    def texts(self, piece: Piece, rows: slice) -> Iterator[bytes]:
        """The messages of some rows of a piece."""
        columns = [_texts(piece.column(name)[rows]) for name in self._entries]
        return ((self._text % row).encode() for row in zip(*columns, strict=True))


def _is_array(entries: Sequence[str]) -> bool:
    return "[" in entries[0]


def _places(entries: Sequence[str]) -> str:
    places = ", ".join("%s" for _ in entries)
    return f"[{places}]" if _is_array(entries) else places


def _texts(x: Array) -> list[str]:
    """Numbers (n,) as JSON has them, null where there is none."""
    found = list(map(repr, x.tolist()))
    for row in np.flatnonzero(~np.isfinite(x)).tolist():
        found[row] = "null"
    return found


@final
class _Moving:
    """Joint states and frames of an arm; its links are lines in their frames, written once."""

    def __init__(self, run: Run, arm: DrawnArm, context: Any) -> None:
        from foxglove import channels

        position, speed = f"{arm.name}.{arm.drawing.position}", f"{arm.name}.dq"
        moves = recorded(run, speed, arm.drawing.joints)
        self.signals = (position, speed) if moves else (position,)
        self._arm = arm
        self._joints = arm.drawing.names or tuple(
            f"joint{i + 1}" for i in range(arm.drawing.joints)
        )
        self._states = channels.JointStatesChannel(f"/{arm.name}/joint_states", context=context)
        self._frames = channels.FrameTransformsChannel("/tf", context=context)
        self._scene = channels.SceneUpdateChannel(f"/{arm.name}/scene", context=context)

    def rows(self, piece: Piece) -> tuple[Array, Array | None]:
        """Positions and, where they were recorded, velocities of its joints in a piece, (n, m)."""
        q, *dq = (piece.array(name) for name in self.signals)
        return q, dq[0] if dq else None

    def log(self, k: int, at: int, q: Array, dq: Array | None) -> None:
        """Write row `k`, at a log time, ns: positions `q` and velocities `dq` (m,)."""
        from foxglove import messages

        stamp = messages.Timestamp(at // 10**9, at % 10**9)
        if k == 0:
            self._scene.log(messages.SceneUpdate(entities=_lines(self._arm, stamp)), log_time=at)
        speeds = [None] * len(q) if dq is None else dq.tolist()
        found = [
            messages.JointState(name=name, position=x, velocity=v)
            for name, x, v in zip(self._joints, q.tolist(), speeds, strict=True)
        ]
        self._states.log(messages.JointStates(timestamp=stamp, joints=found), log_time=at)
        moved = _transforms(self._arm.name, self._arm.drawing, q, stamp)
        self._frames.log(messages.FrameTransforms(transforms=moved), log_time=at)


def _transforms(name: str, drawing: Drawing, q: Array, stamp: Any) -> list[Any]:
    from foxglove import messages

    found, parent = [], name
    for i, (R, r) in enumerate(link_frames(drawing, q)):
        x, y, z, w = quaternion(R)
        child = f"{name}/{i + 1}"
        found.append(
            messages.FrameTransform(
                timestamp=stamp,
                parent_frame_id=parent,
                child_frame_id=child,
                translation=messages.Vector3(x=float(r[0]), y=float(r[1]), z=float(r[2])),
                rotation=messages.Quaternion(x=x, y=y, z=z, w=w),
            )
        )
        parent = child
    return found


def quaternion(R: Array) -> tuple[float, float, float, float]:
    """The unit quaternion x, y, z, w (pure numbers) of a rotation matrix (3, 3), w >= 0."""
    K = np.array(
        [
            [R[0, 0] - R[1, 1] - R[2, 2], 0.0, 0.0, 0.0],
            [R[1, 0] + R[0, 1], R[1, 1] - R[0, 0] - R[2, 2], 0.0, 0.0],
            [R[2, 0] + R[0, 2], R[2, 1] + R[1, 2], R[2, 2] - R[0, 0] - R[1, 1], 0.0],
            [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], R.trace()],
        ]
    )  # Bar-Itzhack 2000: the eigenvector of the largest eigenvalue
    vector = np.linalg.eigh(K)[1][:, -1]
    x, y, z, w = (vector if vector[3] >= 0 else -vector).tolist()
    return x, y, z, w


def _lines(arm: DrawnArm, stamp: Any) -> list[Any]:
    """A line from the origin of each link to that of the next, in its frame."""
    from foxglove import messages

    ends = [*arm.drawing.origins, arm.drawing.tip]
    found = []
    for i, end in enumerate(ends):
        x, y, z = end
        line = messages.LinePrimitive(
            type=messages.LinePrimitiveLineType.LineStrip,
            thickness=4.0,
            scale_invariant=True,
            points=[messages.Point3(), messages.Point3(x=x, y=y, z=z)],
            color=messages.Color(r=0.13, g=0.4, b=0.73, a=1.0),
        )
        frame = f"{arm.name}/{i}" if i else arm.name
        found.append(
            messages.SceneEntity(
                timestamp=stamp, frame_id=frame, id=f"{arm.name}/{i}", frame_locked=True,
                lines=[line],
            )
        )  # fmt: skip
    return found


def _gif(run: Run, path: Path, names: Sequence[str]) -> None:
    """The arms of the run in motion; `names` are not shown."""
    write_gif(run, path)


FORMATS: Mapping[str, Callable[[Run, Path, Sequence[str]], None]] = {
    ".csv": _csv, ".parquet": _parquet, ".mat": _mat, ".mcap": _mcap, ".gif": _gif,
}  # fmt: skip
