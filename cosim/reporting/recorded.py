"""The scenario that a run folder holds, and the command that repeats the run."""

from __future__ import annotations

import shlex
from typing import Any

from cosim.base.errors import ScenarioError
from cosim.record import Run
from cosim.scenario.spec import Scenario, build

_KEPT = ("title", "run", "metrics", "figures", "require")


def recorded_scenario(run: Run) -> Scenario:
    """The part of a run's scenario that declares metrics, figures and requirements.

    Raises ScenarioError.
    """
    folder, document = run.path.parent, run.metadata.get("scenario")
    if not document:
        raise ScenarioError("the folder does not say which scenario it ran", str(folder))
    kept = {key: _given(document[key]) for key in _KEPT if key in document}
    return build(kept | {"components": {}}, folder / "run.json")


def _given(value: Any) -> Any:
    """A document without the keys that were not given."""
    if isinstance(value, dict):
        return {key: _given(x) for key, x in value.items() if x is not None}
    return [_given(x) for x in value] if isinstance(value, list) else value


def repeating_command(run: Run) -> str:
    """The command that repeats a run: as it was typed, or one that gives the same result.

    "": there is none, as for a scenario that a program made.
    """
    facts = run.metadata
    if "command" in facts:
        return str(facts["command"])
    if "deployment" in facts:
        return shlex.join(["cosim", "replay", str(run.path.parent)])
    path = facts.get("scenario", {}).get("path")
    return shlex.join(["cosim", "run", path, "--seed", str(facts.get("seed"))]) if path else ""
