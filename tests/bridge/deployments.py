"""Deployments of the scenarios in configs/ for tests: as they are, changed, or made of a dict."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bridge.deployment.motors import expand
from bridge.deployment.spec import load
from bridge.deployment.system import System, load_system, make_system
from bridge.records.node_lives import ByLife
from bridge.replay import replay, twin
from bridge.wiring.wiring import Rows
from cosim.base.toml import read
from cosim.engine.simulate import simulate
from cosim.loading.files import load as load_scenario
from cosim.record import Run

CONFIGS = Path(__file__).parents[2] / "configs"
TELEOPERATION = CONFIGS / "teleoperation.toml"
MANY = CONFIGS / "many.toml"
NETWORK = CONFIGS / "network.toml"
OPENARM = CONFIGS / "openarm.toml"
SIX_AXIS = CONFIGS / "six_axis.toml"
SIX_AXIS_POSITION = CONFIGS / "six_axis_position.toml"
SHORT = "run.stop=2"


def toml(value: Any) -> str:
    """A value as TOML on one line."""
    if isinstance(value, Mapping):
        inside = ", ".join(f"{_text(k)} = {toml(v)}" for k, v in value.items())
        return "{" + inside + "}"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml, value)) + "]"
    return _text(value) if isinstance(value, str) else repr(value)


def _text(text: str) -> str:
    return f'"{text}"'


def document(name: str = "can") -> dict[str, Any]:
    """A deployment of configs/deploy as messages, its DBC files with their full paths."""
    path = CONFIGS / "deploy" / f"{name}.toml"
    found = read(path)
    expand(found, path)
    for bus in found["buses"].values():
        if "dbc" in bus:
            bus["dbc"] = str((CONFIGS / "deploy" / bus["dbc"]).resolve())
    return found


def written(found: Mapping[str, Any], folder: Path) -> Path:
    """A document as a file."""
    path = folder / "test.toml"
    path.write_text("\n".join(f"{k} = {toml(v)}" for k, v in found.items()))
    return path


def system_of(
    found: Mapping[str, Any], folder: Path, *settings: str, scenario: Path = TELEOPERATION
) -> System:
    """Scenario and document, cut."""
    deployment = load(written(found, folder))
    loaded = load_scenario(scenario, [*deployment.settings(), *settings])
    return make_system(loaded, deployment)


def scenario_of(name: str) -> Path:
    """The scenario of a deployment of configs/deploy: its name begins with the scenario's."""
    known = (MANY, NETWORK, OPENARM, SIX_AXIS_POSITION, SIX_AXIS)
    others = (path for path in known if name.startswith(path.stem))
    return next(others, TELEOPERATION)


def named(name: str, *settings: str) -> System:
    """A deployment of configs/deploy with its scenario, as a user would name it."""
    return load_system(scenario_of(name), name, settings)


def run_twin(system: System, folder: Path) -> ByLife[Rows]:
    """Rows by life."""
    folder.mkdir(exist_ok=True)
    twin.simulate(system, folder)
    return replay.load(folder)


def offline(scenario: Path, folder: Path, *settings: str) -> Run:
    """The same without a deployment."""
    simulate(load_scenario(scenario, settings), folder)
    return Run.open(folder)


def signal(system: System, rows: ByLife[Rows], node: str, name: str) -> Any:
    """A port of a component over the slots of its node, (slots, entries)."""
    slot = system.nodes[node].plan.slots()[name]
    return rows[node]["signals"][:, slot.start : slot.start + slot.size]


def one_node(components: list[str]) -> dict[str, Any]:
    """Everything in one node; a bus and no message."""
    return {
        "buses": {"none": {"dbc": str(CONFIGS / "can" / "link_fd2.dbc")}},
        "nodes": {"all": {"components": components, "number": 1}},
        "messages": {},
    }
