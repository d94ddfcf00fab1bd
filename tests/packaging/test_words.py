"""The README and the pages are short, and pages do not grow old."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


DOCS = ROOT / "docs"
#: Pages that a user reads; tables that programs write stand in the evidence.
PAGES = sorted({*DOCS.rglob("*.md")} - {*(DOCS / "evidence").rglob("*.md")})
MOST = 3000  # words of a page
#: A date, the load of the machine on that day, the seed of a run.
_MONTHS = "January|February|March|April|May|June|July|August|September|October|November|December"
DIARY = re.compile(
    rf"\b20\d\d-\d\d-\d\d\b|\b\d{{1,2}} (?:{_MONTHS}) 20\d\d|\bseed (?:20\d{{6}}|\d+,)"
    r"|\((?:[^()]*, )?load \d+\)|\bat a load of \d+ (?:to|on|or)|\bload of \d+ on\b"
)


def words(text: str, *, code: bool = True) -> int:
    """The words of a page as a reader counts them: without comments and addresses of links."""
    text = re.sub(r"<!--.*?-->|\]\([^)]*\)", " ", text, flags=re.DOTALL)
    if not code:
        text = re.sub(r"^ *```.*?^ *```", " ", text, flags=re.DOTALL | re.MULTILINE)
    return len(re.findall(r"\w[^\s|]*", text))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_a_page_is_read_in_a_quarter_of_an_hour(page: Path) -> None:
    assert words(page.read_text(encoding="utf-8"), code=False) <= MOST


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_a_page_has_no_dates_loads_and_seeds(page: Path) -> None:
    assert DIARY.findall(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    ("text", "diary"),
    [
        ("A run of 22 November 2026, seed 5, at a load of 10 on two processors.", True),
        ("Measured 2026-11-26 (load 6).", True),
        ("`--seed 1` gives the same run; the bus has a load of 34.5 %.", False),
    ],
)
def test_a_diary_is_recognised(text: str, diary: bool) -> None:
    assert bool(DIARY.search(text)) == diary


def test_the_readme_has_few_words_and_commands() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert words(readme) <= 600
    assert len(set(re.findall(r"\bcosim ([a-z]+)", readme))) <= 12


def test_the_pictures_of_the_readme_are_there_and_small() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    pictures = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", readme)
    assert len(pictures) == 3
    assert all(0 < (ROOT / picture).stat().st_size < 1e6 for picture in pictures)
