"""The changelog has one line a change, and new lines are files of `changes/`."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CHANGELOG = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
OPTIONS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["towncrier"]
KINDS = [kind["directory"] for kind in OPTIONS["type"]]
MOST = 200  # characters of a line


def problems(folder: Path) -> list[str]:
    """The files of a folder that are no lines for the changelog."""
    wrong = []
    for path in sorted(folder.iterdir()):
        if path.name == "README.md":
            continue
        text = path.read_text(encoding="utf-8").strip()
        if not re.fullmatch(rf"\+[\w-]+\.({'|'.join(KINDS)})\.md", path.name):
            wrong.append(f"{path.name}: expected a name like +some-words.fixed.md")
        elif not text or "\n" in text or len(text) > MOST:
            wrong.append(f"{path.name}: expected one line of at most {MOST} characters")
    return wrong


def test_each_file_of_changes_is_one_line() -> None:
    assert problems(ROOT / OPTIONS["directory"]) == []


def test_files_that_towncrier_would_misread_are_named(tmp_path: Path) -> None:
    (tmp_path / "+right.added.md").write_text("Links accept a delay of 0.\n")
    (tmp_path / "right.added.md").write_text("It has no plus.\n")
    (tmp_path / "+kind.feature.md").write_text("It has no kind.\n")
    (tmp_path / "+long.fixed.md").write_text("Two\nlines.\n")
    assert [line.split(":")[0] for line in problems(tmp_path)] == [
        "+kind.feature.md",
        "+long.fixed.md",
        "right.added.md",
    ]


def test_the_changelog_has_one_line_a_change() -> None:
    body = CHANGELOG.partition("<!-- towncrier release notes start -->\n")[2]
    assert body
    for line in filter(None, body.splitlines()):
        assert re.match(r"## \d+\.\d+\.\d+ \(|### (Added|Changed|Fixed|Removed)$|- ", line), line
        assert len(line) <= MOST, line
