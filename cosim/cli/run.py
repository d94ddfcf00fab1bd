"""``cosim run``: a scenario, offline, as fast as the machine allows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from cosim.scenario import Scenario
    from cosim.simulate import Outcome


def run(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml).")],
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="PATH=VALUE",
            help="Change a value, e.g. components.master_control.parameters.lambda_M=1; repeatable.",
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the links (run.seed).")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Run folder [default: runs/SCENARIO-DATE-TIME].")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing run folder.")] = False,
    csv: Annotated[bool, typer.Option("--csv", help="Also write trajectories.csv.")] = False,
    plot: Annotated[bool, typer.Option("--plot/--no-plot", help="Draw the figures.")] = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """Run a scenario and write a run folder: trajectories, metadata, link tables, figures."""
    from cosim.cli.summary import figures, header, summary
    from cosim.record import Run, new_folder
    from cosim.scenario import load
    from cosim.simulate import simulate

    settings = [*(set_ or []), *([f"run.seed={seed}"] if seed is not None else [])]
    loaded = load(scenario, settings)
    plan = _plan(loaded)
    say = (lambda text: None) if quiet else typer.echo
    say(header(loaded, plan))
    folder = new_folder(out, loaded.name, force=force)
    with _progress(quiet) as progress:
        outcome = simulate(loaded, folder, progress, plan)
    result = Run.open(folder)
    for line in summary(loaded, result, outcome):
        say(line)
    if csv:
        result.to_csv(folder / "trajectories.csv")
    if plot:
        for path in figures(loaded, result, folder):
            say(f"figure       {path}")
    say(f"run folder   {folder}")
