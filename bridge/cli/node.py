"""``cosim node``: one node of a deployment alone, against whatever is on its buses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bridge.cli.options import DeployOptions, HardwareOptions
from bridge.cli.rehearse import report_findings
from cosim.base.convert import Struct
from cosim.cli.options import Strict, unused_folder
from cosim.cli.supervise import announce_run_folder

if TYPE_CHECKING:
    from bridge.deployment.system import System
    from bridge.node.control import Control
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


class NodeRunOptions(Struct, frozen=True):
    """The node, when it starts, and its folder."""

    name: Annotated[str, typer.Option("--node", help="Node of the deployment to run.")]
    now: Annotated[
        bool,
        typer.Option(
            "--now",
            help="Start or join at once. Default: wait for NMT start, or join a running run.",
        ),
    ] = False
    firmware: Annotated[
        Path | None,
        typer.Option(
            metavar="IMAGE",
            help="Let an image be the node, in QEMU or natively: its frames are copied to the "
            "buses (see docs/firmware.md).",
        ),
    ] = None
    out: Annotated[
        Path | None, typer.Option(help="Run folder to write. Default: a new folder in runs/.")
    ] = None
    strict: Strict = False


def node(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml).")],
    options: NodeRunOptions,
    deploy: DeployOptions,
    hardware: HardwareOptions,
) -> None:
    """Run one node of a deployment: configure it, wait for the start, run until the end.

    The deployment is checked first, as by `cosim rehearse`; after an error the node does not start.
    If the other nodes are already running, it joins their run at the current time of that run.
    Without --hardware it waits for a peer that is away for 60 s, unless the deployment sets
    `silence`.

    Ctrl-C ramps the torque down and ends the node; a second Ctrl-C ends it at once. Exit status 1
    if the node was stopped before the end.
    """
    from bridge.deployment import spec as deployments
    from bridge.deployment.system import load_system
    from bridge.node.drive_enable import disabled_at_the_end
    from bridge.node.run import NodeOptions, run_node
    from bridge.preflight import deployment
    from bridge.records.node_lives import Life
    from bridge.results.node_alone import begin_node, complete_node
    from cosim.base.clock import stamp
    from cosim.base.errors import ScenarioError
    from cosim.record.folder import NODES

    path, name = deployments.find(scenario, deploy.deploy), options.name
    changes = [*deploy.set_, *deploy.settings(deployments.load(path))]
    own = hardware.hardware or options.firmware is not None  # an image has its own tables
    changes += [] if own else waiting_for_a_restart(path, changes)
    system = load_system(scenario, str(path), changes)
    if name not in system.nodes:
        raise ScenarioError(f"no node {name!r}; there are: {', '.join(system.nodes)}", str(path))
    report_findings(deployment.check(system), strict=options.strict, quiet=False)
    hardware.confirm("node")
    if options.firmware is not None:
        _run_image(system, options, real=hardware.hardware)
        return
    folder = options.out or unused_folder(Path("runs") / f"{name}-{stamp()}")
    announce_run_folder(folder)
    facts = begin_node(system, folder, {"settings": changes, "node": name})
    real = hardware.hardware
    started = _StartedNode(system, name, now=options.now, real=real)
    with disabled_at_the_end(system, [name] if real else []):
        report = run_node(
            system,
            NodeOptions(Life(name), folder.absolute() / NODES, real=real, warm_up=1.0, alone=True),
            started.say,
            started.listen,
        )
    rows = complete_node(system, folder, report, facts)
    _say(system, folder, report, rows)


def _run_image(system: System, options: NodeRunOptions, *, real: bool) -> None:
    """Run an image as the node until Ctrl-C, and print what it has sent and received."""
    from bridge.export.firmware import firmware
    from bridge.node.handle import SlotImage
    from bridge.node.image_on_buses import run_image
    from cosim.measure.metric_result import summary_line

    name = options.name
    token = firmware(system, name, "native", real=real).token
    image = SlotImage(str(options.firmware), token.hex())

    def note(text: str) -> None:
        typer.echo(f"{name}: {text}")

    copied = run_image(system, name, image, note, now=options.now)
    typer.echo(summary_line("received", f"{copied.received} frames"))
    typer.echo(summary_line("sent", f"{copied.sent} frames"))
    if copied.damaged:
        typer.echo(summary_line("damaged", f"{copied.damaged} bytes on its serial line"))


class _StartedNode:
    """A node that was started by hand: prints its events, and starts it at once if `now`."""

    def __init__(self, system: System, name: str, *, now: bool, real: bool) -> None:
        self._system, self._name, self._now, self._real = system, name, now, real
        self._controls: list[Control] = []
        self._waited: list[str] = []
        self._ready, self._enabled = Event(), Event()

    def say(self, event: Mapping[str, Any]) -> None:
        """Print an event. Raises RunError if drives are not enabled that `now` needs."""
        match event["event"]:
            case "waiting":
                if event["for"] != self._waited:
                    self._waited[:] = event["for"]
                    self._note(f"has not received from {', '.join(self._waited)}")
            case "deaf":
                cure = (
                    "the deployment's `silence` (--set deploy.silence=60) lets it wait for longer"
                )
                self._note(f"receives nothing from {', '.join(event['to'])}; {cure}")
            case "joined":
                typer.echo(f"{self._name}: joins the run at t = {event['t']:g} s")
            case "unshared":
                self._note(UNSHARED)
            case "drives":
                self._drives("; ".join(event["failed"]))
            case "refused":
                self._note(f"refused to start or to arm: {event['why']}")
                for control in self._controls if self._now else ():
                    control.quit()
            case _:
                self._begin(event)

    def _note(self, text: str) -> None:
        typer.echo(f"{self._name}: {text}", err=True)

    def _drives(self, failed: str) -> None:
        from cosim.base.errors import RunError

        if failed and self._now and not self._enabled.is_set():
            raise RunError(f"{self._name}: {failed}")
        typer.echo(f"{self._name}: {failed or 'all drives are ready'}", err=bool(failed))
        if not failed:
            self._enabled.set()

    def _begin(self, event: Mapping[str, Any]) -> None:
        for text in (*event.get("refused", ()), event.get("warning", "")):
            if text:
                typer.echo(f"not granted: {text}", err=True)
        waiting = "starting" if self._now else "waiting for NMT start on its bus (Ctrl-C ends)"
        typer.echo(f"{self._name}: ready, {waiting}")
        self._ready.set()

    def listen(self, control: Control) -> None:
        """Start the node once it is ready, if `now`. Raises RunError if it does not get ready."""
        from bridge.node.drive_enable import foreign_drives
        from cosim.base.errors import RunError

        self._controls.append(control)
        if not self._now:
            return
        patience = self._system.deployment.patience
        if not self._ready.wait(patience):
            wanting = ", ".join(self._waited)
            raise RunError(f"{self._name}: not ready: has not received from {wanting}")
        if self._real:
            control.arm()
            if foreign_drives(self._system, [self._name]) and not self._enabled.wait(patience):
                raise RunError(f"{self._name}: its drives are not ready")
        control.begin(0.5)


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
    from cosim.measure.metric_result import summary_line
    from cosim.record.folder import NODES

    for r in node_reports(system, rows, folder / NODES):
        typer.echo(summary_line(str(r.life), r.text()))
    typer.echo(summary_line("end", f"{report.end} {report.why} {report.error}".rstrip()))
    typer.echo(summary_line("run folder", str(folder)))
    if report.end not in (LifeEnd.FINISHED, LifeEnd.ENDED):
        raise typer.Exit(1)
