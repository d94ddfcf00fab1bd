"""``cosim replay``: a rehearsal or a hardware run, computed again from its journals."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from cosim.base.units import time_text
from cosim.cli.options import Json, Verify, write_json

if TYPE_CHECKING:
    from bridge.deployment.system import System
    from bridge.records.node_lives import Life
    from bridge.replay.from_log import ControllerReplay
    from bridge.replay.replay import ReplayReport
    from bridge.wiring.wiring import Rows


def replay(
    run: Annotated[Path, typer.Argument(help="Run folder of a rehearsal, or a bus log.")],
    scenario: Annotated[
        Path | None, typer.Option(help="Scenario file. Default: the path recorded in the run.")
    ] = None,
    deploy: Annotated[
        str | None,
        typer.Option("--deploy", help="Deployment file. Default: the path recorded in the run."),
    ] = None,
    from_log: Annotated[
        bool,
        typer.Option("--from-log", help="RUN is a bus log: run the controllers on its frames."),
    ] = False,
    offline: Annotated[
        bool,
        typer.Option(
            "--offline",
            help="Compare with one offline run over the recorded network instead.",
        ),
    ] = False,
    check: Verify = True,
    json: Json = None,
) -> None:
    """Recompute a recorded run offline, and compare every signal of every node.

    Exit status 1 if a signal differs (the first difference is printed), or if a node received
    samples that their recorded sender did not send. With --offline the scenario runs without nodes,
    as by `cosim run`, into RUN/offline: links use the recorded samples, and inputs that drives or
    buses changed are given their recorded values. Exit status 1 if the result differs.
    """
    from tempfile import TemporaryDirectory

    from bridge.replay import replay as again
    from cosim.base.clock import stopwatch
    from cosim.record import verify
    from cosim.record.folder import NODES

    if from_log:
        _from_log(run, scenario, deploy)
        return
    if check:
        verify(run)
    system = recorded_system(run, scenario, deploy)
    rows = again.load(run / NODES)
    if offline:
        _offline(system, run, rows)
    watch = stopwatch()
    with TemporaryDirectory() as scratch:
        found = again.replay(system, rows, again.received_by_life(run / NODES), Path(scratch))
    if json is not None:
        write_json(json, "replay", _data(found))
    seconds = max(len(r) * system.nodes[life.node].h for life, r in rows.items())
    _print(found, f"{time_text(watch(), 3)} for {time_text(seconds)}")
    if found.first is not None or found.altered:
        raise typer.Exit(1)


def _print(found: ReplayReport, time: str) -> None:
    """Print the outcome of a replay, with the `time` that it took."""
    from cosim.measure.metric_result import summary_line

    for life, slots in found.slots.items():
        typer.echo(summary_line(str(life), f"{slots} slots"))
    for message in found.alone:
        text = "not completely compared with its sender, which was not recorded"
        typer.echo(summary_line(message, text))
    for altered in found.altered:
        typer.echo(summary_line("altered", str(altered)))
    typer.echo(summary_line("time", time))
    if found.first is None:
        typer.echo(summary_line("difference", "exactly 0 in every signal"))
    else:
        typer.echo(summary_line("difference", f"up to {found.greatest:.6g}; first: {found.first}"))


def _data(found: ReplayReport) -> dict[str, Any]:
    """The outcome of a replay, as plain data."""
    return {
        "exact": found.first is None and not found.altered,
        "slots": {str(life): slots for life, slots in found.slots.items()},
        "greatest": found.greatest,
        "first": None if found.first is None else str(found.first),
        "altered": [str(sample) for sample in found.altered],
        "not_compared": list(found.alone),
    }


def recorded_system(run: Path, scenario: Path | None = None, deploy: str | None = None) -> System:
    """The scenario and deployment of a run folder, by their recorded paths unless given.

    Raises ScenarioError.
    """
    from bridge.deployment.system import load_system
    from cosim.base.errors import ScenarioError
    from cosim.record.folder import read_metadata

    if not run.is_dir():
        raise ScenarioError("there is no such run folder", str(run))
    facts = read_metadata(run).get("deployment")
    if not facts and (scenario is None or deploy is None):
        raise ScenarioError(
            "no deployment in run.json; expected the folder of a rehearsal, or --scenario and "
            "--deploy for one that was cut short",
            str(run),
        )
    facts = facts or {"settings": []}
    return load_system(
        scenario or Path(facts["scenario"]), deploy or facts["path"], facts.get("settings", [])
    )


def _offline(system: System, run: Path, rows: Mapping[Life, Rows]) -> NoReturn:
    from bridge.cli.diff import lines
    from bridge.replay.diff import compare_runs
    from bridge.replay.page import write_diff_page
    from bridge.results.offline import recorded_inputs, run_offline
    from cosim.measure.metric_result import summary_line
    from cosim.record import seal
    from cosim.record.folder import REPORT

    given = ", ".join(inlet.target.name for _, inlet in recorded_inputs(system, rows)) or "no input"
    given += "; links whose samples all match use their tables"
    typer.echo(summary_line("recorded inputs", given))
    again = run_offline(system, run, rows)
    found = compare_runs(run, again, whole=False)  # a recording that stopped early ends sooner
    typer.echo("\n".join(lines(found)))
    page = write_diff_page(found, again / REPORT)
    seal(again, changed=[REPORT])
    typer.echo(summary_line("report", str(page)))
    raise typer.Exit(found.exit_code)


def _from_log(log: Path, scenario: Path | None, deploy: str | None) -> None:
    """Print how each controller's messages, computed again, differ from those in the log.

    `log`: a file, or a folder of one file a bus. Exits with 1 where they differ.
    """
    from bridge.deployment.system import load_system
    from bridge.replay.from_log import replay_log
    from cosim.base.errors import ScenarioError

    if scenario is None or deploy is None:
        raise ScenarioError("--from-log needs --scenario and --deploy", str(log))
    files = sorted(log.glob("*.log")) if log.is_dir() else [log]
    found = replay_log(load_system(scenario, deploy), files)
    for node in found.nodes:
        typer.echo("\n".join(_lines(node)))
    for remark in found.remarks:
        typer.echo(remark)
    typer.echo("difference: exactly 0 in every frame" if found.exact else "difference: see above")
    raise typer.Exit(int(not found.exact))


def _lines(node: ControllerReplay) -> list[str]:
    """The lines of the summary of one controller."""
    from cosim.cli.show import aligned

    head = f"{node.node}: {node.compared} frames in {node.slots} slots from slot {node.first}"
    if node.unheard:
        head += f", {node.unheard} slots without a frame"
    if node.stopping:
        head += f", {node.stopping} frames of other states than active not compared"
    rows = [["value", "RMS", "largest", "at", "frames that differ", "unit"]]
    for v in node.values:
        differ = f"{v.differ}, first in slot {v.first}" if v.differ else "0"
        rows.append([v.name, f"{v.rms:.3g}", f"{v.largest:.3g}", f"{v.t:g} s", differ, v.unit])
    return [head, *aligned(rows)]
