"""Runs for other tools: CSV, Parquet, MATLAB's ``.mat``, and MCAP and GIF with moving arms."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.base.component import Drawing
from cosim.base.errors import RunError, ScenarioError
from cosim.base.files import written_aside
from cosim.base.names import signal_of
from cosim.record import Run
from cosim.reporting.arms import DrawnArm, drawn_arms, link_frames, recorded
from cosim.reporting.moving import write_gif
from cosim.scenario.exposed import matching

Array = NDArray[np.float64]
#: Largest rate of transforms and joint states, Hz.
RATE = 100.0


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


def _values(run: Run, entries: Sequence[str]) -> Array:
    """(n,) of a scalar, else (n, m)."""
    columns = [run.column(name) for name in entries]
    return columns[0] if "[" not in entries[0] else np.stack(columns, axis=1)


# ---- tables -----------------------------------------------------------------------------------


def _csv(run: Run, path: Path, names: Sequence[str]) -> None:
    run.to_csv(path, names)


def _parquet(run: Run, path: Path, names: Sequence[str]) -> None:
    run.to_parquet(path, names)


def _mat(run: Run, path: Path, names: Sequence[str]) -> None:
    """``t`` (n, 1), a struct for each component with its signals (n, m), and ``units``."""
    try:
        from scipy.io import savemat
    except ImportError:
        raise ScenarioError("SciPy is not installed; expected cosim-bridge[fit]") from None
    found: dict[str, Any] = {"t": run.t[:, None]}
    units: dict[str, Any] = {"t": "s"}
    for signal, entries in _signals(names).items():
        *above, last = (_matlab_name(part) for part in signal.split("."))
        place, unit = found, units
        for part in above:
            place, unit = place.setdefault(part, {}), unit.setdefault(part, {})
        values = _values(run, entries)
        place[last] = values.reshape(len(run), -1)
        unit[last] = run.units[entries[0]]
    savemat(path, {**found, "units": units}, long_field_names=True)


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
    t_ns = np.rint(run.t * 1e9).astype(np.int64)
    arms = list(drawn_arms(run))
    moving = [_moving(run, arm, context) for arm in arms]
    topics = [*_topics(run, names, foxglove, context)]
    every = max(1, round(1.0 / (RATE * _step(run.t))))
    try:
        with foxglove.open_mcap(path, allow_overwrite=True, context=context) as file:
            for text, data in _attached(run, arms):
                file.attach(
                    log_time=0, create_time=0, name=text, media_type="text/plain", data=data
                )
            for k, at in enumerate(t_ns.tolist()):
                for log in (*topics, *(moving if k % every == 0 else ())):
                    log(k, at)
    except RuntimeError as error:  # its own errors, with those of the system in them
        raise RunError(f"cannot write {path}: {error}") from error


def _step(t: Array) -> float:
    return float(np.median(np.diff(t))) if len(t) > 1 else 1.0


def _attached(run: Run, arms: Sequence[DrawnArm]) -> Iterator[tuple[str, bytes]]:
    yield "run.json", json.dumps(run.metadata, indent=1).encode()
    files = {arm.folder / str(arm.options["urdf"]) for arm in arms if "urdf" in arm.options}
    for file in sorted(files):
        if file.is_file():
            yield file.name, file.read_bytes()


Log = Callable[[int, int], None]


def _topics(run: Run, names: Sequence[str], sdk: Any, context: Any) -> Iterator[Log]:
    """Functions (row, log time in ns) that write the signals of a component."""
    parts: dict[str, dict[str, list[str]]] = {}
    for signal, entries in _signals(names).items():
        component, _, port = signal.partition(".")
        parts.setdefault(component, {})[port or component] = entries
    for component, ports in parts.items():
        yield _topic(run, component, ports, sdk, context)


def _topic(run: Run, component: str, ports: Mapping[str, list[str]], sdk: Any, context: Any) -> Log:
    values = {port: _values(run, entries) for port, entries in ports.items()}
    number = {"type": ["number", "null"]}
    fields = {
        port: {
            **(number if x.ndim == 1 else {"type": "array", "items": number}),
            "description": run.units[ports[port][0]],
        }
        for port, x in values.items()
    }
    schema = json.dumps({"type": "object", "properties": fields}).encode()
    channel = sdk.Channel(
        f"/{component}",
        message_encoding="json",
        context=context,
        schema=sdk.Schema(name=component, encoding="jsonschema", data=schema),
    )

    def log(k: int, at: int) -> None:
        row = {port: _plain(x[k]) for port, x in values.items()}
        channel.log(json.dumps(row, allow_nan=False).encode(), log_time=at)

    return log


def _plain(x: Any) -> Any:
    """Numbers for JSON, null where there is none."""
    found = [v if np.isfinite(v) else None for v in np.ravel(x).tolist()]
    return found if np.ndim(x) else found[0]


def _moving(run: Run, arm: DrawnArm, context: Any) -> Log:
    """Joint states and frames of an arm; its links are lines in their frames, written once."""
    from foxglove import channels, messages

    q = run.array(f"{arm.name}.{arm.drawing.position}")
    speed = f"{arm.name}.dq"
    dq = run.array(speed) if recorded(run, speed, arm.drawing.joints) else None
    joints = arm.drawing.names or tuple(f"joint{i + 1}" for i in range(arm.drawing.joints))
    states = channels.JointStatesChannel(f"/{arm.name}/joint_states", context=context)
    frames = channels.FrameTransformsChannel("/tf", context=context)
    scene = channels.SceneUpdateChannel(f"/{arm.name}/scene", context=context)

    def log(k: int, at: int) -> None:
        stamp = messages.Timestamp(at // 10**9, at % 10**9)
        if k == 0:
            scene.log(messages.SceneUpdate(entities=_lines(arm, stamp)), log_time=at)
        each = zip(joints, q[k].tolist(), joints if dq is None else dq[k].tolist(), strict=True)
        found = [
            messages.JointState(name=n, position=x, velocity=None if dq is None else v)
            for n, x, v in each
        ]
        states.log(messages.JointStates(timestamp=stamp, joints=found), log_time=at)
        moved = _transforms(arm.name, arm.drawing, q[k], stamp)
        frames.log(messages.FrameTransforms(transforms=moved), log_time=at)

    return log


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
