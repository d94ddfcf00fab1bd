"""``cosim compare``: controllers × operators × links, side by side over the same recorded links."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cosim.base.convert import Struct, field
from cosim.cli.options import (
    PROCESSORS,
    Folders,
    Jobs,
    PartOptions,
    Plot,
    Png,
    ResultOptions,
    Strict,
)

if TYPE_CHECKING:
    from cosim.comparison.comparison import Comparison
    from cosim.comparison.variants import ComparisonSelection, MetricColumn, Variants
    from cosim.schedule.plan import Plan
    from cosim.study.parts import StudyPart


class Selection(Struct, frozen=True):
    """The names that are compared, where they are defined, and changes of the scenario."""

    controllers: Annotated[
        str, typer.Option(metavar="LIST", help="Names of controllers, e.g. paper,pd; or all.")
    ] = ""
    operators: Annotated[str, typer.Option(metavar="LIST", help="Names of operators; or all.")] = ""
    links: Annotated[str, typer.Option(metavar="LIST", help="Names of link laws; or all.")] = ""
    columns: Annotated[str, typer.Option(metavar="LIST", help="Names of columns; or all.")] = ""
    variants: Annotated[
        Path | None,
        typer.Option(
            help="File with the variants to compare.",
            show_default="the file in compare/ next to the scenario",
        ),
    ] = None
    seeds: Annotated[int, typer.Option(min=1, help="Number of seeds, starting at run.seed.")] = 1
    set_: Annotated[
        list[str],
        typer.Option(
            "--set",
            metavar="PATH=VALUE",
            help="Change the scenario, or a link law by links.LAW.KEY; repeatable.",
        ),
    ] = field(default_factory=list)

    @property
    def lists(self) -> tuple[str, str, str]:
        """The lists of controllers, operators and links."""
        return self.controllers, self.operators, self.links


class ComparisonOptions(Struct, frozen=True):
    """The folder of a comparison, and what is made of its runs."""

    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the results.", show_default="runs/compare-SCENARIO-DATE-TIME"
        ),
    ] = None
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier comparison.")] = False
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue the unfinished comparison in the folder.")
    ] = False
    keep: Annotated[bool, typer.Option("--keep", help="Keep the run folder of every run.")] = False
    jobs: Jobs = PROCESSORS
    plot: Plot = True
    png: Png = False
    live: Annotated[
        bool,
        typer.Option(
            "--live", help="Let readers of report.html move delays and run all controllers again."
        ),
    ] = False
    list_: Annotated[
        bool, typer.Option("--list", help="List the variants, without running them.")
    ] = False
    strict: Strict = False


def compare(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml or .ssp).")],
    selection: Selection,
    options: ComparisonOptions,
    parts: PartOptions,
    result: ResultOptions,
    folders: Folders = None,
) -> None:
    """Compare controllers: run each with every operator and link law, and print one table."""
    from functools import partial

    from cosim.base.clock import stopwatch
    from cosim.cli.check import report_unconnected_inputs
    from cosim.cli.summary import this_command
    from cosim.cli.sweep import watched
    from cosim.comparison import comparison as compared
    from cosim.comparison import divided, live_part, report
    from cosim.comparison.documents import check, read_base
    from cosim.comparison.kept import KeptResults
    from cosim.comparison.requirement_columns import with_requirements
    from cosim.comparison.variants_file import of_laws, read, variants_path
    from cosim.record import held_folder

    part = _asked(options, parts, folders or [])
    laws, settings = of_laws(selection.set_)
    known = read(selection.variants or variants_path(scenario), laws)
    if options.list_:
        typer.echo("\n".join(_listing(known)))
        return
    base = read_base(scenario, known, settings)
    known = with_requirements(known, base).with_columns(_names(selection.columns))
    chosen = known.select(*map(_names, selection.lists))
    folder = options.out or _folder(scenario, part)
    plans = check(base, known, chosen)  # before there is a folder
    report_unconnected_inputs(plans, strict=options.strict, quiet=result.quiet)
    made = live_part.live_cases(base, known, chosen) if options.live and not part else None
    watch, same = stopwatch(), _same(plans)
    runs, seeds = folder / report.RUNS if options.keep else None, selection.seeds
    title, count = _title(known, chosen, scenario, seeds), range(base.seed, base.seed + seeds)
    listed = partial(compared.tasks, base, known, chosen, count)
    ready = divided.merged(listed, same, folders or []) if parts.merge else None
    with held_folder(folder):
        _claim(folder, options, part)
        with (
            watched(result.quiet, folder, title, "runs") as observer,
            ready or KeptResults(folder, same, runs) as kept,
        ):
            if part:
                n = divided.run_part(listed, part, folder, kept, options.jobs, observer)
                _end_part(part, n, folder, result)
                return
            found = compared.compare(
                base, known, chosen, count, jobs=options.jobs, kept=kept, observer=observer
            )
        command = this_command(folders or [])
        live = "" if made is None else live_part.section(found, made, _again(scenario, selection))
        paths = _written(found, folder, options, live, command)
    result.save("compare", report.as_data(found, command))
    ending = f"{len(found.outcomes)} runs in {watch():.1f} s; {', '.join(map(str, paths))}"
    result.say("\n".join([*report.text(found), ending]))


def _asked(options: ComparisonOptions, parts: PartOptions, folders: list[Path]) -> StudyPart | None:
    """The part that is asked for. Raises ScenarioError for options that do not fit together."""
    from cosim.base.errors import ScenarioError

    if options.live and not options.plot:
        raise ScenarioError("found --live with --no-plot; expected one of them")
    if options.keep and parts.merge:
        raise ScenarioError("found --keep with --merge; expected --keep with each part")
    return parts.asked("cosim compare", folders)


def _folder(scenario: Path, part: StudyPart | None) -> Path:
    """The folder of a comparison, a new one, or of a part, which may be continued."""
    from cosim.base.clock import stamp
    from cosim.study.parts import folder_of

    whole = Path("runs") / f"compare-{scenario.stem}"
    return folder_of(part, whole) if part else whole.with_name(f"{whole.name}-{stamp()}")


def _claim(folder: Path, options: ComparisonOptions, part: StudyPart | None) -> None:
    """Take the folder. Raises ScenarioError if it has something else, or another part."""
    from cosim.comparison import report
    from cosim.study.parts import refuse_other_part
    from cosim.study.store import read_state

    if options.resume:
        refuse_other_part(folder, read_state(folder), part)
    report.claim(folder, force=options.force, resume=options.resume)


def _same(plans: Sequence[Plan]) -> str:
    """The facts that all results follow from besides their tasks: versions and FMUs."""
    from cosim.engine.simulate import versions
    from cosim.study.runner import fingerprint_of

    return fingerprint_of(repr(versions()).encode(), plans)


def _end_part(part: StudyPart, runs: int, folder: Path, result: ResultOptions) -> None:
    """Seal the folder of a part, and print what it has."""
    from cosim.record import seal

    seal(folder, anew=True)
    result.save("compare", {"folder": str(folder), "part": str(part), "runs": runs})
    result.say(f"{part}: {runs} runs; {folder}")


def _again(scenario: Path, given: Selection) -> str:
    """The command that makes the same comparison in another folder."""
    lists = {"controllers": given.controllers, "operators": given.operators, "links": given.links,
             "columns": given.columns, "variants": given.variants}  # fmt: skip
    words = [word for key, x in lists.items() if x for word in (f"--{key}", str(x))]
    if given.seeds > 1:
        words += ["--seeds", str(given.seeds)]
    words += [word for setting in given.set_ for word in ("--set", setting)]
    return shlex.join(["cosim", "compare", str(scenario), *words, "--live"])


def _written(
    found: Comparison, folder: Path, wanted: ComparisonOptions, live: str, command: str
) -> list[Path]:
    """Write the results into the folder; the path of each, the page first.

    `live`: the part of the page that computes runs, or ""; `command`: that makes the same.
    """
    from cosim.comparison import page, report
    from cosim.record import seal

    paths = list(report.write(found, folder, command))
    if wanted.png:
        from cosim.comparison import figure

        paths.insert(0, figure.draw(found, folder / report.FIGURE))
    if wanted.plot:
        try:
            paths.insert(0, page.write(found, folder, command, live))
        except page.PageSizeError as error:
            typer.echo(f"warning: {error}", err=True)
            paths.insert(0, page.write(found, folder, command))
    seal(folder, anew=True)
    return paths


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _title(known: Variants, chosen: ComparisonSelection, scenario: Path, seeds: int) -> str:
    return (
        f"{known.title}\n{scenario}, {known.path}: {len(chosen.controllers)} controllers x "
        f"{len(chosen.operators)} operators x {len(chosen.links)} link laws x {seeds} "
        f"seed{'s' if seeds > 1 else ''}"
    )


def _listing(known: Variants) -> list[str]:
    """The available variants: names and titles, signals that controllers send, conditions."""
    from cosim.cli.show import aligned

    lines = [known.title]
    shown = [
        [name, c.title, f"sends {', '.join(c.sends)}", c.condition]
        for name, c in known.controllers.items()
    ]
    lines += ["", "controllers", *aligned(shown)]
    for title, names in (("operators", known.operators), ("links", known.links)):
        lines += ["", title, *aligned([[name, x.title] for name, x in names.items()])]
    shown = [[x.name, x.label, _said(x, known)] for x in known.columns]
    return [*lines, "", "columns (* shown by default)", *aligned(shown)]


def _said(column: MetricColumn, known: Variants) -> str:
    """The source of a column, and whether it is one of the default columns."""
    kind = getattr(column.metric, "kind", "error")
    return f"{kind}{' *' if column.name in known.default_columns else ''}"
