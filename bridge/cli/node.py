"""``cosim node``: one node of a deployment alone, against whatever is on its buses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bridge.cli.rehearse import (
    Bitrate,
    Channel,
    DataBitrate,
    Deploy,
    Fd,
    Interface,
    Set,
    report_findings,
)
from cosim.cli.options import Strict
from cosim.cli.supervise import allow_terminal_input, announce_run_folder

if TYPE_CHECKING:
    from bridge.records.node_lives import Life
    from bridge.records.records import Statement
    from bridge.wiring.wiring import Rows

#: s without a message after which a node that was started by hand stops: a peer that is started
#: again by hand takes about 13 s on a busy machine.
AWAY = 60.0
UNSHARED = (
    "hears of a run on a host whose clock is not known to be this one's, and has not joined it; "
    "let a time server (NTP, PTP) keep the date of both hosts. Over Zenoh it goes on measuring"
)


def node(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml).")],
    name: Annotated[str, typer.Option("--node", help="Node of the deployment to run.")],
    deploy: Deploy = "",
    set_: Set = None,
    interface: Interface = None,
    channel: Channel = None,
    bitrate: Bitrate = None,
    data_bitrate: DataBitrate = None,
    fd: Fd = None,
    now: Annotated[
        bool,
        typer.Option(
            "--now",
            help="Start or join at once. Default: wait for NMT start, or join a running run.",
        ),
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="Run folder to write. Default: a new folder in runs/.")
    ] = None,
    hardware: Annotated[
        bool,
        typer.Option(
            "--hardware", help="Allow frames that can move real drives; asks for confirmation."
        ),
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask for confirmation.")] = False,
    strict: Strict = False,
) -> None:
    """Run one node of a deployment: configure it, wait for the start, run until the end.

    The deployment is checked first, as by `cosim rehearse`; after an error the node does not start.
    If the other nodes are already running, it joins their run at the current time of that run.
    Without --hardware it waits for a peer that is away for 60 s, unless the deployment sets
    `silence`.

    Ctrl-C ramps the torque down and ends the node; a second Ctrl-C ends it at once. Exit status 1
    if the node was stopped before the end.
    """
    import threading

    from bridge.cli.options import bus_settings, unused_folder
    from bridge.deployment import spec as deployments
    from bridge.deployment.system import load_system
    from bridge.node.control import Control
    from bridge.node.drive_enable import disabled_at_the_end, foreign_drives
    from bridge.node.run import NodeOptions, run_node
    from bridge.preflight import deployment
    from bridge.records.node_lives import Life
    from bridge.results.node_alone import begin_node, complete_node
    from cosim.base.clock import stamp
    from cosim.base.errors import RunError, ScenarioError
    from cosim.record.folder import NODES

    path = deployments.find(scenario, deploy)
    changes = [*(set_ or [])]
    changes += bus_settings(
        deployments.load(path), interface, channel or [], bitrate, data_bitrate, fd
    )
    changes += [] if hardware else waiting_for_a_restart(path, changes)
    system = load_system(scenario, str(path), changes)
    if name not in system.nodes:
        raise ScenarioError(f"no node {name!r}; there are: {', '.join(system.nodes)}", str(path))
    report_findings(deployment.check(system), strict=strict, quiet=False)
    if hardware and not yes:
        with allow_terminal_input():
            typer.confirm("Frames of this node may move real drives. Go on?", abort=True)
    folder = out or unused_folder(Path("runs") / f"{name}-{stamp()}")
    announce_run_folder(folder)
    facts = begin_node(system, folder, {"settings": changes, "node": name})

    controls: list[Control] = []
    waited: list[str] = []
    ready, enabled = threading.Event(), threading.Event()

    def say(event: Mapping[str, Any]) -> None:
        if event["event"] == "waiting":
            if event["for"] != waited:
                waited[:] = event["for"]
                typer.echo(f"{name}: has not received from {', '.join(waited)}", err=True)
            return
        if event["event"] == "deaf":
            cure = "the deployment's `silence` (--set deploy.silence=60) lets it wait for longer"
            typer.echo(f"{name}: receives nothing from {', '.join(event['to'])}; {cure}", err=True)
            return
        if event["event"] == "joined":
            typer.echo(f"{name}: joins the run at t = {event['t']:g} s")
            return
        if event["event"] == "unshared":
            typer.echo(f"{name}: {UNSHARED}", err=True)
            return
        if event["event"] == "drives":
            failed = "; ".join(event["failed"])
            if failed and now and not enabled.is_set():
                raise RunError(f"{name}: {failed}")
            typer.echo(f"{name}: {failed or 'all drives are ready'}", err=bool(failed))
            if not failed:
                enabled.set()
            return
        if event["event"] == "refused":
            typer.echo(f"{name}: refused to start or to arm: {event['why']}", err=True)
            for control in controls if now else ():
                control.quit()
            return
        for text in (*event.get("refused", ()), event.get("warning", "")):
            if text:
                typer.echo(f"not granted: {text}", err=True)
        waiting = "starting" if now else "waiting for NMT start on its bus (Ctrl-C ends)"
        typer.echo(f"{name}: ready, {waiting}")
        ready.set()

    def listen(control: Control) -> None:
        controls.append(control)
        if now:
            if not ready.wait(system.deployment.patience):
                wanting = ", ".join(waited)
                raise RunError(f"{name}: not ready: has not received from {wanting}")
            if hardware:
                control.arm()
                if foreign_drives(system, [name]) and not enabled.wait(system.deployment.patience):
                    raise RunError(f"{name}: its drives are not ready")
            control.begin(0.5)

    options = NodeOptions(
        Life(name), folder.absolute() / NODES, real=hardware, warm_up=1.0, alone=True
    )
    with disabled_at_the_end(system, [name] if hardware else []):
        report = run_node(system, options, say, listen)
    rows = complete_node(system, folder, report, facts)
    _say(system, folder, report, rows)


def waiting_for_a_restart(path: Path, changes: Sequence[str]) -> list[str]:
    """The setting with which a node started by hand outlives a peer that is started again by hand.

    None where the deployment in the file, or a change to it, says how long a node waits.
    """
    from cosim.base import toml

    said = "silence" in toml.read(path)
    said |= any(change.startswith("deploy.silence=") for change in changes)
    return [] if said else [f"deploy.silence={AWAY:g}"]


def _say(system: Any, folder: Path, report: Statement, rows: Mapping[Life, Rows]) -> None:
    from bridge.records.records import LifeEnd
    from bridge.results.report import node_reports
    from cosim.record.folder import NODES

    for r in node_reports(system, rows, folder / NODES):
        typer.echo(f"{r.life!s:<16} {r.text()}")
    typer.echo(f"{'end':<16} {report.end} {report.why} {report.error}".rstrip())
    typer.echo(f"{'run folder':<16} {folder}")
    if report.end not in (LifeEnd.FINISHED, LifeEnd.ENDED):
        raise typer.Exit(1)
