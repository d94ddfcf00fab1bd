"""``cosim doctor --deploy``: the steps from a deployment to a first run with real drives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import typer

from bridge.cli.options import BusOptions
from bridge.commission.drive_line import DriveLine
from bridge.commission.interfaces import StepFinding, check_interfaces
from bridge.commission.line_drives import LineDrive, line_drives
from bridge.commission.steps import Question, drive_steps
from bridge.deployment import spec as deployments
from bridge.deployment.spec import Deployment
from cosim.base.errors import ScenarioError

_MARKS = {"good": "✓", "limited": "!", "missing": "✗"}
#: Share of the torque in a first run.
FIRST = 0.05


def check_deployment(path: Path, buses: BusOptions, yes: bool) -> Iterator[StepFinding]:
    """The findings of all steps; each is printed as it comes.

    `yes`: nobody is asked. Raises ScenarioError for a deployment without drives of a profile.
    """
    changes = buses.settings(deployments.load(path))
    d = deployments.load(path, [text.removeprefix("deploy.") for text in changes])
    drives = line_drives(d)
    if not drives:
        text = "no message carries torque to a drive with a profile; nothing to check"
        raise ScenarioError(text, str(path))
    good = True
    for found in _steps(d, drives, yes):
        good &= found.state != "missing"
        _print(found)
        yield found
    if good:
        typer.echo(first_run(d, drives))


def _steps(d: Deployment, drives: list[LineDrive], yes: bool) -> Iterator[StepFinding]:
    interfaces = list(check_interfaces(d, tuple({drive.foreign.bus: 0 for drive in drives})))
    yield from interfaces
    if any(found.state == "missing" for found in interfaces):
        return
    with DriveLine(d, drives) as line:
        yield from drive_steps(line, drives, _asker(yes), alone=yes)


def _asker(yes: bool) -> Question:
    """A person is asked, unless `yes`."""
    return lambda question: yes or typer.confirm(question)


def _print(found: StepFinding) -> None:
    typer.echo(f"{_MARKS[found.state]} {found.name}: {found.found}")
    if found.state != "good" and found.cure:
        typer.echo(f"    cure: {found.cure}")


def first_run(d: Deployment, drives: Sequence[LineDrive]) -> str:
    """The command to run next: the controllers with 5 % of the torque of each drive.

    Guards hold the limit, and controllers that the deployment tells theirs know it.
    """
    limits: dict[str, list[float]] = {}
    told: dict[str, float] = {}
    for drive in drives:
        limit = round(FIRST * drive.limit, 4)
        limits.setdefault(drive.host, []).append(limit)
        known = f"components.{drive.joint.partition('.')[0]}.parameters.tau_max"
        if known in d.set:
            told[known] = min(told.get(known, limit), limit)
    sets = [f"deploy.nodes.{node}.guard.tau_max={values}" for node, values in limits.items()]
    sets += [f"{name}={value}" for name, value in told.items()]
    return (
        "next: a first run with 5 % of the torque, cosim monitor in another terminal:\n"
        f"  cosim rehearse SCENARIO --deploy {d.path} --nodes {','.join(limits)} --hardware "
        + " ".join(f"--set '{setting}'" for setting in sets)
    )
