"""Facts of a run folder: scenario, periods, messages, and internal signals."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from bridge.can import dbc
from bridge.can.layout import find
from bridge.deployment import spec as deploy
from bridge.deployment.spec import Deployment
from cosim.base.errors import CosimError, ScenarioError
from cosim.base.names import signal_of
from cosim.record import Run
from cosim.record.piecewise import first_step
from cosim.scenario.spec import Scenario, build


def stored_scenario(run: Run) -> Scenario:
    """The scenario of ``run.json``. Raises ScenarioError."""
    data = run.metadata.get("scenario")
    if not isinstance(data, Mapping):
        raise ScenarioError("no scenario in run.json", str(run.path.parent))
    document = {key: value for key, value in data.items() if key != "path"}
    return build(document, Path(str(data.get("path", "scenario.toml"))))


def period(run: Run, remarks: list[str]) -> float:
    """The slowest period of a component, s; without a scenario, that of the rows."""
    step = first_step(run, 0.0)
    try:
        scenario = stored_scenario(run)
        periods = [
            scenario.seconds(spec.period, "components", name, "period")
            for name, spec in scenario.components.items()
            if spec.period is not None
        ]
    except CosimError as error:
        remarks.append(f"period of the rows: {error}")
        return step
    return max([*periods, step])


def is_compared(run: Run) -> Callable[[str], bool]:
    """True if a scalar is a plant's, or goes somewhere; everything without a scenario."""
    try:
        scenario = stored_scenario(run)
    except CosimError:
        return lambda name: True
    ends = [e for x in scenario.links for e in (x.source, x.target)]
    wired = [w for c in scenario.components.values() for w in c.inputs.values()]
    ends += [w if isinstance(w, str) else w.source for w in wired]
    ports = {signal_of(end) for end in ends}
    plants = {name for name, c in scenario.components.items() if c.period is None}
    return lambda name: name.partition(".")[0] in plants or signal_of(name) in ports


def quanta(run: Run, remarks: list[str]) -> dict[str, float]:
    """LSB of the signals that messages of the run's deployment carry, by scalar, in their units."""
    said = run.metadata.get("deployment")
    if not isinstance(said, Mapping) or "path" not in said:
        return {}
    try:
        found = deploy.load(Path(str(said["path"])))
        return {
            entry: lsb
            for name in found.messages
            for entry, lsb in _carried(found, name, run).items()
        }
    except CosimError as error:
        remarks.append(f"no quantisation in the bounds: {error}")
        return {}


def _carried(d: Deployment, name: str, run: Run) -> dict[str, float]:
    message = d.messages[name]
    bus = d.buses[message.bus]
    if bus.kind != "can" or message.profile:
        return {}
    layout = find(dbc.load(d.file(bus.dbc)), message.name or name)
    found: dict[str, float] = {}
    for text in message.carries:
        known = text in run.units or any(n.startswith(f"{text}[") for n in run.names)
        for i, entry in enumerate(run.entries(text) if known else ()):
            port = signal_of(text.partition(".")[2])
            for signal in layout.signals:
                if signal.name in (port, f"{port}{i + 1}"):
                    found[entry] = abs(signal.scale)
    return found
