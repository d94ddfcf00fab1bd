"""``cosim conform``: a participant or a drive judged by numbered rules, from outside."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.cli.conform_drive import DriveConformityOptions, judge_drive, protocol_of
from bridge.cli.options import DeployOptions
from cosim.cli.options import ResultOptions

if TYPE_CHECKING:
    from bridge.conform.rules import ConformityReport, ConformityRule, JudgedRule


class ConformityOptions(ResultOptions, frozen=True):
    """The rules to judge, and the files of the verdicts."""

    rules: Annotated[
        str, typer.Option(metavar="C-03,C-07", help="Judge these rules only. Default: all.")
    ] = ""
    without: Annotated[
        str,
        typer.Option(
            metavar="A,B",
            help="Parts that the participant leaves out (date, epoch-sent, estop-sent, joining, "
            "ranges, watchdogs): their rules do not apply.",
        ),
    ] = ""
    list_: Annotated[
        bool, typer.Option("--list", help="Print the rules and their clauses, and end.")
    ] = False
    junit: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write a test case for each rule, as JUnit XML."),
    ] = None


def conform(
    deploy: DeployOptions,
    result: ConformityOptions,
    drive: DriveConformityOptions,
    scenario: Annotated[
        Path | None, typer.Argument(help="Scenario file (.toml).", show_default=False)
    ] = None,
    command: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="-- COMMAND ...",
            help="Starts the participant; {BUS} in it is the channel of a bus, {BUS.listen} and "
            "{BUS.connect} are endpoints on Zenoh. Default: it runs already.",
            show_default=False,
        ),
    ] = None,
    node: Annotated[
        str, typer.Option("--node", help="Node of the deployment to judge; number of a drive.")
    ] = "",
) -> None:
    """Judge one participant, or with --drive a drive, by numbered rules, from outside.

    The kit joins the buses of the deployment, plays all other nodes, the supervisor and an
    adversary, and starts COMMAND. With -i cosim it serves simulated buses. Rules with times allow
    for the lateness of the kit itself.

    With --drive it asks and listens on one bus, and moves nothing without --may-move.

    Exit status 1 if a rule is broken, 3 if this machine was too slow to tell.
    """
    from bridge.conform.participant import PARTICIPANT_RULES
    from bridge.conform.report import report_lines, write_conformity_junit
    from cosim.base.errors import ScenarioError

    book = protocol_of(drive.drive).book if drive.drive else PARTICIPANT_RULES
    rules = book.selected(result.rules)
    if result.list_:
        typer.echo("\n".join(_listed(rules)))
        return
    if drive.drive and scenario is not None:
        raise ScenarioError(f"found --drive and {scenario}; expected one of them")
    if drive.drive:
        with _progress(len(rules), quiet=result.quiet) as say:
            report = judge_drive(drive, deploy, node, rules, say)
    elif scenario is None or not node:
        raise ScenarioError(
            "found no scenario or no --node; expected cosim conform SCENARIO --node NODE -- COMMAND"
        )
    else:
        report = _judged(scenario, deploy, node, command or (), rules, result)
    result.say("\n".join(report_lines(report)))
    result.save("conform", report.as_data())
    if result.junit is not None:
        write_conformity_junit(report, result.junit)
    if result.quiet and report.exit_code:
        typer.echo(f"error: {report.sentence()}", err=True)
    raise typer.Exit(report.exit_code)


def _listed(rules: Sequence[ConformityRule]) -> list[str]:
    from bridge.conform.report import clause_of
    from cosim.cli.show import aligned

    return aligned([[r.number, r.title, clause_of(r)] for r in rules])


@contextmanager
def _progress(rules: int, *, quiet: bool) -> Iterator[Callable[[JudgedRule], None]]:
    """A bar with a step for each rule: the function to call with a verdict."""
    from cosim.cli.summary import progress_bar

    with progress_bar(quiet) as progress:
        done: list[JudgedRule] = []

        def say(judged: JudgedRule) -> None:
            done.append(judged)
            progress(len(done), rules)

        yield say


def _judged(
    scenario: Path,
    deploy: DeployOptions,
    node: str,
    command: Sequence[str],
    rules: Sequence[ConformityRule],
    result: ConformityOptions,
) -> ConformityReport:
    """The verdicts, with the simulated buses of the deployment served."""
    from bridge.conform.participant import PARTICIPANT_RULES, ParticipantKit, check_judgeable
    from bridge.deployment import spec as deployments
    from bridge.deployment.system import load_system
    from bridge.rehearsal.outside import filled_words
    from bridge.rehearsal.simulated_buses import served

    without = PARTICIPANT_RULES.left_out(result.without)
    path = deployments.find(scenario, deploy.deploy)
    changes = [*deploy.set_, *deploy.settings(deployments.load(path))]
    system = load_system(scenario, str(path), changes)
    check_judgeable(system, node)
    with served(system, []) as channels:
        system = load_system(scenario, str(path), [*changes, *channels])
        words = filled_words(system, node, command, "COMMAND")
        kit = ParticipantKit(system, node, words, without)
        with _progress(len(rules), quiet=result.quiet) as say:
            return kit.judge(rules, say)
