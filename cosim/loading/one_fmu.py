"""An FMU as a scenario of its own: one component, stepped as its DefaultExperiment says."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import ceil, floor, log10
from pathlib import Path
from typing import Any

from cosim.base.convert import number
from cosim.base.errors import CosimError, ScenarioError
from cosim.base.names import signal_of
from cosim.base.toml import change
from cosim.fmi import FmuComponent
from cosim.fmi.file.description import Description
from cosim.record.recording import Recording
from cosim.scenario.exposed import ALL, is_pattern

#: Stop time (s) and number of steps where the FMU states none.
STOP, STEPS = 1.0, 500
_TABLES = (
    "run",
    "components",
    "links",
    "events",
    "metrics",
    "figures",
    "analysis",
    "require",
    "title",
)


def document(
    path: Path, settings: Sequence[str] = (), table: str | Path | None = None
) -> dict[str, Any]:
    """The scenario of an FMU, as a parsed file would have it, with ``path=value`` settings applied.

    The component has the FMU's model identifier as its name. A setting that does not begin with a
    table of a scenario (``run.``, ``components.`` ...) sets a parameter or start value of the FMU.
    Start, stop and step are those of the DefaultExperiment; the step is shortened where the run is
    not a multiple of it. `table`: a file (:class:`Recording`) whose columns feed the inputs of
    the same name, continuous ones joined by lines. What is recorded and what events set may be
    named without the component. Raises FmuError, ScenarioError.
    """
    fmu = FmuComponent(path.absolute())
    description = fmu.description
    name = _component(fmu)
    component: dict[str, Any] = {"model": str(path.absolute()), "parameters": {}}
    found: dict[str, Any] = {
        "title": description.name,
        "run": {},
        "components": {name: component},
    }
    if table is not None:
        component["inputs"] = _fed(fmu, Path(table).absolute())
    for setting in settings:
        _apply(found, component["parameters"], setting)
    run = found["run"]
    if isinstance(run, dict):
        _complete(run, description, path)
        record = run.get("record")
        if isinstance(record, dict) and isinstance(record.get("signals"), list | str):
            given = record["signals"]
            listed = [given] if isinstance(given, str) else given
            record["signals"] = [_named(x, fmu) for x in listed]
    for event in found.get("events") or ():
        if isinstance(event, dict) and isinstance(event.get("set"), dict):
            event["set"] = {_named(k, fmu): v for k, v in event["set"].items()}
    return found


def _component(fmu: FmuComponent) -> str:
    """The name of the component: the FMU's model identifier, in characters that names have."""
    name = re.sub(r"\W", "_", fmu.description.identifier)
    return f"_{name}" if name[0].isdigit() else name


def _named(signal: Any, fmu: FmuComponent) -> Any:
    """A signal with its component, whose name may be left out where there is only one."""
    name = _component(fmu)
    if not isinstance(signal, str) or signal == ALL or signal.startswith(f"{name}."):
        return signal
    known = signal in fmu.groups or signal_of(signal) in fmu.groups
    return f"{name}.{signal}" if known or is_pattern(signal) else signal


def inputs_among(path: Path, recording: Recording) -> tuple[str, ...]:
    """Inputs of an FMU that are signals of a recording. Raises FmuError."""
    return tuple(_columns(FmuComponent(path.absolute()), recording))


def _columns(fmu: FmuComponent, recording: Recording) -> dict[str, str]:
    """The column of each input, or entry of one, that has one, also as ``component.input``."""
    found: dict[str, str] = {}
    own = _component(fmu)
    for port in fmu.inputs:
        entries = [v.name for v in fmu.groups[port.name].variables]
        for name in [port.name] if len(entries) == 1 else [port.name, *entries]:
            columns = [n for n in (name, f"{own}.{name}") if _all(n, entries, recording)]
            if columns:
                found[name] = columns[0]
                if name == port.name:
                    break
    return found


def _all(column: str, entries: Sequence[str], recording: Recording) -> bool:
    """True if a recording has a column, or an array of that name with all its `entries`."""
    if column in recording.columns:
        return True
    there = [name for name in recording.columns if signal_of(name) == column]
    return bool(there) and len(there) >= len(entries)


def _fed(fmu: FmuComponent, table: Path) -> dict[str, Any]:
    recording = Recording.read(table, jumps=True)
    found = {
        port: {
            "table": str(table),
            "column": column,
            "interpolate": "hold" if port in fmu.discrete else "linear",
        }
        for port, column in _columns(fmu, recording).items()
    }
    if not found:
        raise ScenarioError(
            f"no column is an input of {fmu.archive.path.name}; it has "
            f"{', '.join(p.name for p in fmu.inputs) or 'no inputs'}, the file has "
            f"{', '.join(recording.columns)}",
            str(table),
        )
    return found


def _apply(found: dict[str, Any], parameters: Mapping[str, Any], setting: str) -> None:
    if setting.partition(".")[0] in _TABLES or setting.partition("=")[0] in _TABLES:
        change(found, setting)
        return
    key, equals, value = setting.partition("=")
    change({"parameters": parameters}, f'parameters."{key.strip()}"{equals}{value}')


def _complete(run: dict[str, Any], said: Description, path: Path) -> None:
    """Add start, stop and step as the DefaultExperiment says, where the run has none."""
    if said.default_start:
        run.setdefault("start", said.default_start)
    start = _seconds(run.get("start", 0.0), f"{path} at run.start", 0.0)
    run.setdefault("stop", said.default_stop or start + STOP)
    if "step" not in run:
        length = _seconds(run["stop"], f"{path} at run.stop", start + STOP) - start
        run["step"] = _step(length, said.default_step)


def _seconds(given: Any, place: str, otherwise: float) -> float:
    try:
        return number(given, "s", place)
    except CosimError:  # whoever reads the scenario says so
        return otherwise


def _step(length: float, wanted: float | None) -> float:
    """A step (s) near the wanted one, or of about 1/500 of the `length` (s), that divides it."""
    if not length > 0.0:
        return wanted or STOP / STEPS
    step = _round(length / STEPS) if wanted is None else min(wanted, length)
    if abs(round(length / step) * step - length) <= 1e-9 * length:
        return step
    return length / ceil(length / step)


def _round(step: float) -> float:
    """The greatest of 1, 2, 5 times a power of ten that is not above `step`."""
    power = 10.0 ** floor(log10(step))
    return next(power * f for f in (5.0, 2.0, 1.0) if power * f <= step * (1 + 1e-9))
