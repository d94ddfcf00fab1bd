"""Code in the pages: tables are TOML, programs compile, commands have the options they show."""

from __future__ import annotations

import ast
import re
import shlex
import tomllib
from pathlib import Path
from textwrap import dedent

import pytest
from click import UsageError
from typer.main import get_command

from cosim.cli.commands import app
from cosim.cli.overview import COMMANDS
from tests.system.runs import ROOT

PAGES = {str(p.relative_to(ROOT)): p for p in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md"))}
_FENCE = re.compile(r"^( *)```(\w+)\n(.*?)^ *```", re.DOTALL | re.MULTILINE)


def code(page: Path, kind: str) -> list[str]:
    """The fenced blocks of a kind."""
    text = page.read_text(encoding="utf-8")
    return [dedent(m[3]) for m in _FENCE.finditer(text) if m[2] == kind]


def commands(page: Path) -> list[list[str]]:
    """The arguments of every ``cosim`` in shell blocks and indented lines."""
    text = page.read_text(encoding="utf-8")
    lines = "\n".join(code(page, "sh")).replace("\\\n", " ").splitlines()
    lines += re.findall(r"^ {4}(cosim .*)$", text, re.MULTILINE)
    found = []
    for line in lines:
        words = shlex.split(line, comments=True)
        for i, word in enumerate(words):
            if word.rpartition("/")[2] == "cosim" and i + 1 < len(words):
                ends = [
                    k for k, x in enumerate(words) if k > i and x in ("&", "&&", "||", "|", ">")
                ]
                found.append(words[i + 1 : ends[0] if ends else None])
                break
    return found


@pytest.mark.parametrize("name", PAGES)
def test_tables_and_programs_of_a_page_are_what_they_are_called(name: str) -> None:
    for text in code(PAGES[name], "toml"):
        tomllib.loads(text.replace("…", ""))
    for text in code(PAGES[name], "python"):
        ast.parse(text)


def test_every_command_of_the_pages_has_the_options_and_arguments_that_it_shows() -> None:
    group = get_command(app)
    checked = 0
    for name, page in PAGES.items():
        for words in commands(page):
            context = group.make_context("cosim", words[:1], resilient_parsing=True)
            try:
                _, command, rest = group.resolve_command(context, list(words))  # type: ignore[attr-defined]
                command.make_context(words[0], rest, parent=context)
            except UsageError as error:
                pytest.fail(f"{name}: cosim {' '.join(words)}: {error.format_message()}")
            checked += 1
    assert checked > 120


@pytest.mark.parametrize("name", PAGES)
def test_the_text_of_a_page_names_only_commands_that_are_there(name: str) -> None:
    named = re.findall(r"`cosim ([a-z][a-z-]*)", PAGES[name].read_text(encoding="utf-8"))
    assert set(named) <= set(COMMANDS)
