"""compatibility.md is what its script writes, and the tests that it names exist."""

from __future__ import annotations

import ast
import re

import pytest

from docs.evidence import compatibility as page

WRITTEN = page.PAGE.read_text(encoding="utf-8").split(page.BEGIN)[1].split(page.END)[0]


def versions() -> dict[str, str]:
    """The versions that the page names; one of each package."""
    found: dict[str, str] = {}
    for name in {one.package for one in page.TESTED}:
        (found[name],) = set(re.findall(rf"\| {re.escape(name)} ([\w.]+) \|", WRITTEN))
    return found


def test_the_page_is_current() -> None:
    assert page.tables(versions()) == WRITTEN, "python docs/evidence/compatibility.py"


@pytest.mark.parametrize("one", page.TESTED, ids=lambda one: f"{one.kind}-{one.package}")
def test_a_row_is_a_test_that_uses_the_tool(one: page.Tested) -> None:
    path, _, function = one.test.partition("::")
    text = (page.ROOT / path).read_text(encoding="utf-8")
    names = {n.name for n in ast.walk(ast.parse(text)) if isinstance(n, ast.FunctionDef)}
    assert function in names
    spoken = {one.package, one.package.replace("-", "_"), one.tool, one.tool.lower()}
    assert any(word in text for word in spoken), f"{path} does not speak of {one.tool}"


def test_versions_are_at_least_those_that_the_project_asks_for() -> None:
    import tomllib

    project = tomllib.loads((page.ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    texts = [*project["dependencies"], *extras["test"], *extras["oracles"]]
    asked = dict(text.split(">=") for text in texts if ">=" in text)
    for name, found in versions().items():
        least = asked[name].split(",")[0]
        assert [*map(int, found.split("."))] >= [*map(int, least.split("."))], name
