"""Options in groups, and options that are no longer there."""

from __future__ import annotations

from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from cosim.base.convert import Struct, field
from cosim.cli.options import flat
from tests.cli.command import CONFIG, Command


class Colours(Struct, frozen=True):
    """Options of one meaning."""

    name: Annotated[str, typer.Option("--name")]
    shades: Annotated[list[str], typer.Option("--shade")] = field(default_factory=list)
    deep: Annotated[bool, typer.Option("--deep")] = False


class More(Colours, frozen=True):
    """The same and one more."""

    kinds: Annotated[list[str], typer.Option("--kind")] = field(default_factory=lambda: ["oil"])


def paint(colours: More, at: Annotated[int, typer.Argument()] = 3) -> None:
    """Paint."""
    typer.echo(f"{colours} {at}")


def called(*words: str) -> tuple[int, str]:
    app = typer.Typer()
    app.command()(flat(paint))
    done = CliRunner().invoke(app, words)
    return done.exit_code, done.output


@pytest.mark.parametrize(
    ("words", "colours"),
    [
        (["--name", "red"], More("red")),
        (["7", "--name", "red", "--deep"], More("red", deep=True)),
        (["--name", "x", "--shade", "a", "--shade", "b"], More("x", ["a", "b"])),
        (["--name", "x", "--kind", "ink"], More("x", kinds=["ink"])),
    ],
)
def test_a_group_is_made_of_its_options(words: list[str], colours: More) -> None:
    at = int(words[0]) if words[0].isdigit() else 3
    assert called(*words) == (0, f"{colours} {at}\n")


def test_an_option_of_a_group_is_needed_if_its_field_is() -> None:
    code, text = called()
    assert code == 2 and "--name" in text


@pytest.mark.parametrize(
    ("words", "instead"),
    [
        (["run", CONFIG, "--estimate-error"], 'algorithm = "adaptive"'),
        (["run", CONFIG, "--tolerance", "1e-5"], "run.adaptive.tolerance"),
        (["monitor", "--plotjuggler", "127.0.0.1:9870"], "--mcap"),
    ],
)
def test_an_option_that_is_gone_names_what_serves_instead(
    cosim: Command, words: list[str], instead: str
) -> None:
    said = cosim.refused(*words)
    assert "no longer there" in said and instead in said
