"""The README is short."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def words(text: str) -> int:
    """The words of a page as a reader counts them: without comments and addresses of links."""
    text = re.sub(r"<!--.*?-->|\]\([^)]*\)", " ", text, flags=re.DOTALL)
    return len(text.split())


def test_the_readme_has_few_words_and_commands() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert words(readme) <= 600
    assert len(set(re.findall(r"\bcosim ([a-z]+)", readme))) <= 12


def test_the_pictures_of_the_readme_are_there_and_small() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    pictures = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", readme)
    assert len(pictures) == 3
    assert all(0 < (ROOT / picture).stat().st_size < 1e6 for picture in pictures)
