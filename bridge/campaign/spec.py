"""A campaign: fault scripts to be run one after the other, and what has to come of each.

::

    title = "..."
    scenario = "../teleoperation.toml"
    deploy = "can"
    settings = ["run.stop='8 s'"]
    [[run]]
    script = "corrupt.toml"
    ends = "finished"           # or "stopped", "any"
    sees = ["crc"]              # counters of receivers that are not 0 at the end
    [[run]]
    script = "kill.toml"
    ends = "stopped"
    node = "slave_control"      # who has stopped
    because = ["stale", "peer"] # by one of these

Whatever a script says, no frame that was corrupted may have been accepted (docs/faults.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from bridge.faults.load import load
from bridge.faults.script import FaultScript
from bridge.native import message as messages
from bridge.native.safety import Why
from cosim.base import toml
from cosim.base.convert import convert
from cosim.base.errors import ScenarioError

#: Reasons a node can have stopped for, and counters of a receiver, by their names here.
REASONS = tuple((why.name or "").lower() for why in Why)
COUNTERS = messages.COUNTERS[1:]  # without `ok`


class CampaignRunSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One run: the script, relative to the campaign, and what has to come of it.

    `ends`: of the run; `node`: which node stopped, "": any; `because`: reasons of which it has
    one at least; `sees`: counters that are not 0 at one receiver at least; `times`: how often.
    """

    script: str
    ends: Literal["finished", "stopped", "any"] = "any"
    node: str = ""
    because: tuple[str, ...] = ()
    sees: tuple[str, ...] = ()
    times: Annotated[int, msgspec.Meta(ge=1)] = 1


class CampaignSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The whole file, as read; see the module."""

    title: str = ""
    scenario: str
    deploy: str
    settings: tuple[str, ...] = ()
    run: tuple[CampaignRunSpec, ...]


@dataclass(frozen=True, slots=True)
class Campaign:
    """A campaign, as read: runs and their scripts, in the order of the file."""

    path: Path
    title: str
    scenario: Path
    deploy: str
    settings: tuple[str, ...]
    runs: tuple[tuple[CampaignRunSpec, FaultScript], ...]


def load_campaign(path: str | Path) -> Campaign:
    """Read a campaign and its scripts. Raises ScenarioError that names the file and the place."""
    path = Path(path)
    spec = convert(toml.read(path), CampaignSpec, path)
    for index, run in enumerate(spec.run):
        _check(run, f"{path} at run.{index}")
    return Campaign(
        path=path,
        title=spec.title or path.stem,
        scenario=path.parent / spec.scenario,
        deploy=spec.deploy,
        settings=spec.settings,
        runs=tuple(
            (run, load(path.parent / run.script)) for run in spec.run for _ in range(run.times)
        ),
    )


def _check(run: CampaignRunSpec, place: str) -> None:
    for key, names, known in (
        ("because", run.because, REASONS),
        ("sees", run.sees, COUNTERS),
    ):
        for name in names:
            if name not in known:
                raise ScenarioError(
                    f"unknown {name!r}; expected one of {', '.join(known)}", f"{place}.{key}"
                )
    if (run.because or run.node) and run.ends != "stopped":
        raise ScenarioError(
            f'node and because describe a stop; expected ends = "stopped", not "{run.ends}"',
            f"{place}.ends",
        )
