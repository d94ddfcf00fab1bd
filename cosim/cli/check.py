"""``cosim check``: a scenario before it runs, with what to change."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cosim.base.convert import Struct
from cosim.base.parts import part
from cosim.cli.options import Json, Set, finite, write_json

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cosim.checks import Finding
    from cosim.scenario.spec import Scenario
    from cosim.schedule.plan import Plan


#: What lines of a check begin with while something else is done.
MARK = "check: "


class LayoutOptions(Struct, frozen=True):
    """The bus of the messages of a .dbc file."""

    bitrate: Annotated[
        float, typer.Option(callback=finite, min=1.0, help="Bit rate for a .dbc file, bit/s.")
    ] = 1e6
    data_bitrate: Annotated[
        float | None,
        typer.Option(
            callback=finite, min=1.0, help="Bit rate of the data phase for a .dbc file, bit/s."
        ),
    ] = None
    fd: Annotated[
        bool, typer.Option("--fd", help="Send all messages of a .dbc file as CAN FD frames.")
    ] = False


class CertifyOptions(Struct, frozen=True):
    """Certificates."""

    certify: Annotated[
        bool,
        typer.Option(
            "--certify",
            help="Prove instead that the linear loop is stable for all delays of its links, "
            "however they vary, and write the proof.",
        ),
    ] = False
    verify: Annotated[
        Path | None,
        typer.Option(
            "--verify",
            metavar="CERTIFICATE",
            help="Check instead, in integers, that this certificate holds for the scenario.",
        ),
    ] = None
    delays: Annotated[
        str,
        typer.Option(
            "--delays",
            metavar="LOW,HIGH",
            help="With --certify: ages of what all links hold, s.",
            show_default="those that the links allow",
        ),
    ] = ""
    map_: Annotated[
        float | None,
        typer.Option(
            "--map",
            callback=finite,
            min=0.0,
            metavar="HIGH",
            help="With --certify: map what is certified, unknown or broken over the least and the "
            "greatest delay, up to this, s.",
            show_default="no map",
        ),
    ] = None
    falsified: Annotated[
        Path | None,
        typer.Option(
            "--falsified",
            metavar="FOLDER",
            help="With --map: mark the failure that cosim falsify wrote into this folder.",
        ),
    ] = None
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="With --certify: folder for the proof.",
            show_default="runs/NAME-certified",
        ),
    ] = None

    @property
    def chosen(self) -> bool:
        """True if a certificate is asked for. Raises ScenarioError for options that do not fit."""
        from cosim.base.errors import ScenarioError

        if self.certify and self.verify is not None:
            raise ScenarioError("found --certify and --verify; expected one of them")
        if not self.certify and (self.delays or (self.out, self.map_) != (None, None)):
            raise ScenarioError("found --delays, --map or --out; expected --certify with it")
        if self.falsified is not None and self.map_ is None:
            raise ScenarioError("found --falsified without --map; expected both")
        return self.certify or self.verify is not None


def check(
    scenario: Annotated[
        Path, typer.Argument(help="Scenario file (.toml), or messages of a CAN bus (.dbc).")
    ],
    layout: LayoutOptions,
    proof: CertifyOptions,
    set_: Set = None,
    deploy: Annotated[
        str | None,
        typer.Option("--deploy", help="Check the buses of this deployment as well."),
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit with status 1 for warnings as well.")
    ] = False,
    json: Json = None,
) -> None:
    """Check a scenario: stability of its loop, links, wiring, predictions.

    For a DBC file: the load of the bus, the response time of each message by analysis and on the
    simulated bus, and the control rate that the messages of the shortest period can reach.

    Exit status 1 if there is an error, or with --strict a warning; with --certify, if no
    certificate was found.
    """
    from cosim.base.errors import ScenarioError

    if proof.chosen:
        if scenario.suffix == ".dbc" or deploy is not None or json is not None:
            raise ScenarioError(
                "found --certify or --verify with a .dbc file, --deploy or --json; expected a "
                "scenario alone"
            )
        _prove(scenario, set_ or [], proof)
        return
    if scenario.suffix == ".dbc":
        if deploy is not None or set_:
            raise ScenarioError("found --deploy or --set besides a .dbc file; expected neither")
        found = tuple(
            part("twin").layout_findings(scenario, layout.bitrate, layout.data_bitrate, layout.fd)
        )
    else:
        found = _scenario_findings(scenario, set_ or [], deploy)
    for f in found:
        typer.echo("")
        for line in paragraph(f):
            typer.echo(line)
    counts = {s: sum(f.severity == s for f in found) for s in ("error", "warning", "note")}
    typer.echo("\n" + ", ".join(f"{n} {s}{'' if n == 1 else 's'}" for s, n in counts.items()))
    if json is not None:
        findings = [f.as_data() for f in found]
        write_json(json, "check", {"scenario": str(scenario), "findings": findings})
    if counts["error"] or (strict and counts["warning"]):
        raise typer.Exit(1)


def _prove(path: Path, settings: Sequence[str], options: CertifyOptions) -> None:
    """Write a certificate, or verify one. Exit status 1 if none was found."""
    from cosim.certify.steps import certified, verified
    from cosim.cli.summary import announced, live_line
    from cosim.loading.files import load

    scenario = load(path, list(settings))
    folder = options.out or Path("runs") / f"{path.stem}-certified"
    typer.echo(scenario.title)
    if options.verify is not None:
        with announced(False, "checking the certificate"):
            lines = verified(scenario, options.verify)
        proven = True
    else:
        from cosim.certify.page import mapped

        with announced(False, "searching for a certificate"):
            proven, lines = certified(scenario, options.delays, folder)
    typer.echo("\n".join(lines))
    if options.map_ is not None:
        with live_line(False) as say:
            lines = mapped(scenario, options.map_, options.falsified, folder, say)
        typer.echo("\n".join(lines))
    if not proven:
        raise typer.Exit(1)


def _scenario_findings(
    path: Path, settings: Sequence[str], deploy: str | None
) -> tuple[Finding, ...]:
    """The findings of a scenario and of a deployment; prints its title and its buses."""
    from cosim.checks.preflight import check as findings
    from cosim.cli.summary import announced
    from cosim.loading.files import load
    from cosim.scenario.assemble import assemble

    with announced(False, f"reading {path}"):
        loaded = load(path, [s for s in settings if not s.startswith("deploy.")])
        plan = assemble(loaded)
    with announced(False, "checking the scenario"):
        found = findings(loaded, plan)
    typer.echo(loaded.title)
    if deploy is not None:
        more = part("twin").findings(path, deploy, settings)
        found = (*found, *(f for f in more if f not in found))
    return found


def paragraph(finding: Finding) -> list[str]:
    """A finding on two or three lines: what, where; why, with the number; what to change."""
    lines = [f"{finding.severity:<8} {finding.where}  [{finding.rule}]", f"    {finding.reason}"]
    return [*lines, f"    -> {finding.advice}"] if finding.advice else lines


def print_warnings(
    scenario: Scenario, plan: Plan, *, strict: bool, quiet: bool, computed: bool = True
) -> dict[str, Any]:
    """Print errors and warnings of the check before a run to standard error, one line each.

    Without `computed` the scenario is not run for it, and no poles are computed.

    Return what ``run.json`` keeps: these `findings`, and `limits` of joints, where there are some.
    A check that fails is also a line: it does not prevent a run. Raises ScenarioError for all of
    these if `strict`.
    """
    from cosim.checks.preflight import findings
    from cosim.cli.summary import announced
    from cosim.measure.joint_limits import joint_limits
    from cosim.predict.system import system

    limits: Mapping[str, Sequence[float]] = {}
    try:
        with announced(quiet, "checking the scenario"):
            known = system(scenario, plan)
            found = findings(known, notes=False, computed=computed)
            limits = joint_limits(known.arms)
    except Exception as error:  # whatever a check comes across, the run goes on
        found = (_failed(error),)
    lines = [f.line for f in found]
    _print_findings(lines, strict=strict, quiet=quiet)
    kept = {"findings": [f.as_data() for f in found]}
    return {**kept, "limits": limits} if limits else kept


def _failed(error: Exception) -> Finding:
    """The finding that there could have been others."""
    from cosim.checks import Finding

    reason = f"the check failed, so nothing is known: {type(error).__name__}: {error}"
    return Finding(
        rule="check", severity="warning", where="scenario", number=float("nan"), unit="",
        reason=reason,
    )  # fmt: skip


def report_unconnected_inputs(plans: Iterable[Plan], *, strict: bool, quiet: bool) -> None:
    """Print the unconnected inputs, one line each. Raises ScenarioError for any if `strict`."""
    from cosim.checks import merge_findings
    from cosim.checks.wiring import unconnected_inputs

    found = merge_findings(f for plan in plans for f in unconnected_inputs(plan))
    _print_findings([f.line for f in found], strict=strict, quiet=quiet)


def _print_findings(lines: Sequence[str], *, strict: bool, quiet: bool) -> None:
    from cosim.base.errors import ScenarioError

    if strict and lines:
        raise ScenarioError("; ".join(lines), "--strict")
    for line in lines if not quiet else ():
        typer.echo(f"{MARK}{line}", err=True)
