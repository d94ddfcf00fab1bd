"""``cosim analyze``: manipulability, impedance and passivity of a port, in numbers and figures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cosim.base.convert import Struct
from cosim.cli.linearize import LinearOptions, linearize
from cosim.cli.options import Json, Png, Quiet, Set, Verify, finite, write_json

if TYPE_CHECKING:
    from cosim.analysis.analysis import Analysis
    from cosim.analysis.quantity import Quantity


class TestedPortOptions(Struct, frozen=True):
    """The port, the tests that are applied to it, and the figures."""

    port: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="Component that the hand holds.", show_default="the held arm"
        ),
    ] = ""
    tests: Annotated[
        bool | None,
        typer.Option(
            "--tests/--no-tests",
            help="Also apply test forces to the port.",
            show_default="up to 500 components",
        ),
    ] = None
    lowest: Annotated[
        float,
        typer.Option(
            callback=finite, help="Frequency of the slowest test force, rad/s.", min=1e-4, max=10.0
        ),
    ] = 0.03
    png: Png = False
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the figures of --png.",
            show_default="RUN/analysis, runs/SCENARIO-analysis",
        ),
    ] = None
    check: Verify = True


def analyze(
    target: Annotated[Path, typer.Argument(help="Run folder, or scenario file (.toml).")],
    port: TestedPortOptions,
    linear: LinearOptions,
    set_: Set = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Analyze a port: manipulability, felt damping and stiffness, and passivity.

    A scenario is run in memory. For a run folder, the numbers are those of the run, and test forces
    are applied to the scenario of that run. With --linear: the linear model of a scenario, from one
    period of the slowest component to the next, with the delays of links at this time.
    """
    from cosim.analysis.analysis import analyse
    from cosim.analysis.analyzed_port import of_run, of_scenario
    from cosim.base.errors import ScenarioError
    from cosim.record import verify

    if linear.linear:
        if port != TestedPortOptions():
            raise ScenarioError("found options of a port besides --linear; expected none")
        linearize(target, set_ or [], linear, json, quiet)
        return
    if linear != LinearOptions():
        raise ScenarioError("found options of a linear model; expected --linear with them")
    if target.is_dir() and set_:
        raise ScenarioError("--set applies to a scenario, not to a recorded run", str(target))
    if target.is_dir() and port.check:
        verify(target)
    if target.is_dir():
        subject, folder = of_run(target, port.port), target / "analysis"
    else:
        subject = of_scenario(target, set_ or [], port.port)
        folder = Path("runs") / f"{target.stem}-analysis"
    with status() as say:
        found = analyse(subject, tests=port.tests, lowest=port.lowest, progress=say)
    lines = report(found)
    if json is not None:
        write_json(json, "analyze", found.as_data())
        lines.append(f"\n{'numbers':<12} {json}")
    if port.png:
        from cosim.reporting.analysis import draw

        lines += [f"{'figure':<12} {path}" for path in draw(found, port.out or folder)]
    if not quiet:
        typer.echo("\n".join(lines))


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """Print the current test to standard error, if that is a terminal."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda what: None
        return
    with console.status("run") as line:
        yield line.update


def report(found: Analysis) -> list[str]:
    """The numbers, one fact per line, each with its closed form; below, how they came about."""
    footnotes: dict[str, int] = {}
    port = found.port
    force = f"{port.force} + {port.external}" if port.external else port.force
    names = ", ".join(name for name in (force, port.response, port.inject) if name)
    lines = [found.title, f"port {port.arm}: {names}"]
    if found.run:
        lines += ["", "the run", *_facts(found.run, footnotes)]
    if found.tests:
        lines += ["", f"the port, by {'tests' if found.tested else 'closed forms'}"]
        lines += [f"  {words}" for words in _POSTURES]
        lines += _facts(found.tests, footnotes)
    lines += ["", *(f"  [{number}] {text}" for text, number in footnotes.items())]
    lines += [f"note: {remark}" for remark in found.remarks]
    return lines


#: What the words behind the name of a test mean.
_POSTURES = (
    "as it starts: estimates of the scenario, posture of the run's end",
    "M_hat = M: true estimates that stay, heaviest posture",
)


def _facts(quantities: Sequence[Quantity], footnotes: dict[str, int]) -> list[str]:
    """The lines of numbers: each with its footnote, then its closed form and a note."""
    from cosim.cli.show import aligned

    rows = []
    for q in quantities:
        number = footnotes.setdefault(q.how, len(footnotes) + 1)
        rows.append((q.label, f"{q.text}  [{number}]"))
        if q.expected:
            value, _, formula = q.expected_text.partition(" = ")
            formula = formula.removeprefix("closed form").removeprefix(", ")
            rows.append(("  closed form", f"{value}, {formula}" if formula else value))
        if q.note and not q.missing:
            rows.append(("  note", q.note))
    return aligned(rows)
