"""Output of ``cosim run``: header, progress, summary and figures."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Timer
from typing import TYPE_CHECKING, Any

from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.base.units import time_text

if TYPE_CHECKING:
    from cosim.cli.options import OutputOptions
    from cosim.engine.simulate import RunOutcome
    from cosim.measure.robustness import Robustness
    from cosim.record import Column, Run
    from cosim.scenario.spec import Scenario
    from cosim.schedule.plan import Plan

#: Links whose ages are printed one by one.
MANY_LINKS = 24
#: After so long it is said what is being done, s.
PATIENCE = 1.0


def header(scenario: Scenario, plan: Plan) -> str:
    """The header of the summary: the planned run."""
    from cosim.fmi.components import fmus_in, is_simulator

    fmus = fmus_in(c.component for c in plan.components)
    scenes = sum(is_simulator(c.component) for c in plan.components)
    parts = [
        f"{n} {what}{'s' if n > 1 else ''}"
        for n, what in (
            (fmus, "FMU"),
            (scenes, "MuJoCo scene"),
            (len(plan.components) - fmus - scenes, "Python component"),
            (len(plan.links), "link"),
        )
        if n
    ]
    begin = f" from {time_text(plan.start)} on" if plan.start else ""
    return (
        f"{scenario.title}\n"
        f"{scenario.path}: {', '.join(parts)}, {plan.ticks} ticks of {time_text(plan.h)}{begin}, "
        f"algorithm {plan.algorithm}, seed {scenario.run.seed}"
    )


@contextmanager
def progress_bar(quiet: bool) -> Iterator[Callable[[int, int], None]]:
    """A bar on a terminal's standard error; elsewhere, and when quiet, nothing."""
    if quiet or not sys.stderr.isatty():
        yield lambda done, ticks: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (BarColumn(), TextColumn("{task.percentage:>3.0f} %"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("run")
        yield lambda done, ticks: bar.update(task, completed=done, total=ticks)


@contextmanager
def live_line(quiet: bool) -> Iterator[Callable[[str], None]]:
    """A line that is written anew on a terminal's standard error; elsewhere, nothing."""
    if quiet or not sys.stderr.isatty():
        yield lambda text: None
        return
    try:
        yield lambda text: print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)
    finally:
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)


@contextmanager
def announced(quiet: bool, text: str) -> Iterator[None]:
    """Say `text` on a terminal's standard error once a block has taken :data:`PATIENCE` seconds.

    The line is removed at the end of the block; elsewhere, and when quiet, nothing is written.
    """
    if quiet or not sys.stderr.isatty():
        yield
        return
    with live_line(quiet) as say:
        timer = Timer(PATIENCE, say, [text])
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            timer.join()


def check(scenario: Scenario, recorded: Sequence[Column]) -> None:
    """Refuse metrics, requirements and figures that what will be recorded does not fit.

    Raises ScenarioError with the place: an unknown signal, sizes or units that do not match.
    """
    from cosim.measure import declared_metrics
    from cosim.measure.declared_metrics import Preview
    from cosim.measure.metrics import evaluate
    from cosim.measure.requirements import requirements

    preview = Preview({c.name: c.unit for c in recorded})
    for metric in declared_metrics.metrics(scenario):
        try:
            evaluate([metric], preview)
        except ScenarioError as error:
            message = str(error).removeprefix(f"metrics.{metric.name}: ")
            raise ScenarioError(message, scenario.place("metrics", metric.name)) from None
    requirements(scenario, {c.name: c.unit for c in recorded})
    for name, spec in scenario.figures.items():
        for i, panel in enumerate(spec.panels):
            references = [r for r in panel.reference if isinstance(r, str)]
            try:
                for signal in (*panel.y, *references):
                    preview.entries(signal)
            except ScenarioError as error:
                place = scenario.place("figures", name, "panels", i)
                raise ScenarioError(str(error), place) from None


def summary(
    scenario: Scenario, run: Run, outcome: RunOutcome, judged: Sequence[Robustness] = ()
) -> list[str]:
    """The facts of a run, and the results of its requirements, a line each."""
    from cosim.measure.metric_result import summary_line

    facts = metric_facts(scenario, run)
    facts += [("requirement", result.line) for result in judged]
    facts += [("link age", text) for text in _ages(outcome)]
    if outcome.macro_steps:
        from cosim.reporting.macro_steps import macro_lines

        facts += macro_lines(outcome.macro_steps)
    facts.append(wall_time(outcome.wall, outcome.seconds))
    return [summary_line(*fact) for fact in facts]


def metric_facts(scenario: Scenario, run: Run) -> list[tuple[str, str]]:
    """Label and text of each fact that the metrics of a scenario find in a run."""
    from cosim.measure import declared_metrics
    from cosim.measure.metrics import evaluate

    return [fact for r in evaluate(declared_metrics.metrics(scenario), run) for fact in r.facts]


def wall_time(wall: float, seconds: float) -> tuple[str, str]:
    """Label and text of the time, s, that `seconds` of simulated time took."""
    ratio = seconds / wall
    speed = f"{ratio:.0f}" if ratio >= 10 else f"{ratio:.2g}"
    return (
        "wall time",
        f"{time_text(wall, 3)} for {time_text(seconds)}: {speed} times real time",
    )


def requirement_lines(judged: Sequence[Robustness]) -> list[str]:
    """The results of requirements, a line each."""
    from cosim.measure.metric_result import summary_line

    return [summary_line("requirement", result.line) for result in judged]


def exit_unless_passed(judged: Sequence[Robustness]) -> None:
    """End the command with exit code 1 unless every requirement has passed."""
    import typer

    if any(result.verdict != "passed" for result in judged):
        raise typer.Exit(1)


def as_data(
    scenario: Scenario, run: Run, outcome: RunOutcome, judged: Sequence[Robustness] = ()
) -> dict[str, Any]:
    """The numbers of a run as plain data; ages in s."""
    from cosim.measure import requirements

    found = requirements.as_data(judged)
    return {
        "folder": str(run.path.parent),
        "seconds": outcome.seconds,
        "wall_s": outcome.wall,
        "ended": str(outcome.ended) if outcome.ended is not None else None,
        "metrics": metrics_as_data(scenario, run),
        "link_ages": {
            name: {"mean_s": s.age_mean, "p95_s": s.age_p95, "max_s": s.age_maximum}
            for name, s in outcome.ages.items()
        },
        "macro_steps": list(outcome.macro_steps),
        **({"requirements": found} if found else {}),
    }


def metrics_as_data(scenario: Scenario, run: Run) -> dict[str, Any]:
    """The metrics of a scenario by name: value, unit, parts; without those of missing signals."""
    from cosim.measure import declared_metrics

    found = {}
    for metric in declared_metrics.metrics(scenario):
        with suppress(ScenarioError):
            r = metric.evaluate(run)
            parts = dict(r.parts)
            found[r.name] = {"label": r.label, "value": r.value, "unit": r.unit, "parts": parts}
    return found


def late_ticks(outcome: RunOutcome) -> list[str]:
    """Late ticks of the clocks of FMUs, one line per FMU."""
    return [
        f"{name}: clocks ticked late {n} times, by up to {time_text(most)}: it takes no shorter "
        "steps, so they wait for the next one; a smaller period makes that less"
        for name, (n, most) in outcome.late_clock_ticks.items()
    ]


def _ages(outcome: RunOutcome) -> list[str]:
    """Mean and p95 of the age of what each link held, or of many links together."""
    if len(outcome.ages) > MANY_LINKS:
        return _ages_together(outcome)
    lines = []
    for name, s in outcome.ages.items():
        if s.age_mean != s.age_mean:
            lines.append(f"nothing arrived  {name}")
            continue
        mean, p95, most = (time_text(x, 3) for x in (s.age_mean, s.age_p95, s.age_maximum))
        lines.append(f"{mean} on average, 95 % below {p95}, at most {most}  {name}")
    return lines


def _ages_together(outcome: RunOutcome) -> list[str]:
    ages = {name: s for name, s in outcome.ages.items() if s.age_mean == s.age_mean}
    if not ages:
        return [f"nothing arrived on {len(outcome.ages)} links"]
    mean = sum(s.age_mean for s in ages.values()) / len(ages)
    oldest = max(ages, key=lambda name: ages[name].age_p95)
    return [
        f"{time_text(mean, 3)} on average over {len(ages)} links, 95 % below "
        f"{time_text(ages[oldest].age_p95, 3)} on each ({oldest} has the oldest), at most "
        f"{time_text(max(s.age_maximum for s in ages.values()), 3)}",
        *([f"nothing arrived on {n} links"] if (n := len(outcome.ages) - len(ages)) else []),
    ]


def pictures(
    scenario: Scenario,
    run: Run,
    wanted: OutputOptions,
    report: Callable[[Run], Path] | None = None,
) -> Iterator[tuple[str, Path]]:
    """Write the report and the scenario's figures into the run folder: what it is, and its file.

    `report` writes the report; by default it is one that cannot compute.
    """
    if wanted.plot:
        from cosim.reporting.run_report import write_report

        yield "report", (report or write_report)(run)
    yield from draw_figures(scenario, run, png=wanted.png, pdf=wanted.pdf)


def draw_figures(
    scenario: Scenario, run: Run, *, png: bool, pdf: bool, width: float | None = None
) -> Iterator[tuple[str, Path]]:
    """Draw the scenario's figures into the run folder: what it is, and its file.

    `width`: of the figures, m.
    """
    forms = [f for f, wanted in (("png", png), ("pdf", pdf)) if wanted]
    if not forms:
        return
    from cosim.reporting.declared import figure_specs
    from cosim.reporting.figures import draw

    for form in forms:
        for name, figure in figure_specs(scenario, run).items():
            if width is not None:
                figure = replace(figure, width=width / 0.0254)
            yield "figure", draw(figure, run, run.path.parent / f"{name}.{form}")


def this_command(merged: Sequence[Path] = ()) -> str:
    """The command as it was typed, for whoever wants to repeat it.

    If it has `merged` the folders of parts: the one that makes the same without parts.
    """
    left_out = {"--merge", *map(str, merged)} if merged else set[str]()
    return shlex.join(["cosim", *(x for x in sys.argv[1:] if str(Path(x)) not in left_out)])
