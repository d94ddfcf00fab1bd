"""docs/tutorial.md, docs/falsify.md: the commands of a page, in order, in a folder of its own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.site]
ROOT = Path(__file__).resolve().parents[2]
_BLOCK = re.compile(r"(?:<!-- (?P<mark>[^>]+) -->\n)?```(?P<kind>\w+)\n(?P<text>.*?)```", re.DOTALL)


def blocks(page: str) -> list[tuple[str, str, str]]:
    """(comment before it, kind, text) of each block of a page."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return [(m["mark"] or "", m["kind"], m["text"]) for m in _BLOCK.finditer(text)]


@pytest.mark.parametrize(
    ("page", "tested"), [("tutorial.md", "2 passed"), ("falsify.md", "1 xfailed")]
)
def test_its_commands_work_and_print_what_it_says(page: str, tested: str, tmp_path: Path) -> None:
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    printed, shown = "", []
    for mark, kind, text in blocks(page):
        if mark.startswith("file "):
            (tmp_path / mark.removeprefix("file ")).write_text(text, encoding="utf-8")
        elif kind == "text":
            shown += text.splitlines()
        elif kind == "sh" and mark != "install":
            done = subprocess.run(
                ["sh", "-ec", text], cwd=tmp_path, capture_output=True, text=True, timeout=240,
                env=os.environ | {"PATH": path},
            )  # fmt: skip
            assert done.returncode == 0, done.stdout + done.stderr
            printed += done.stdout
    assert shown and all(line in printed for line in shown)
    assert tested in printed  # by pytest
    if page != "tutorial.md":
        return
    assert re.search(r"^verdict +passed", printed, re.MULTILINE)
    assert re.search(r"^verdict +(failed|inconclusive)", printed, re.MULTILINE)  # a busy machine
    assert "exactly 0 in every signal" in printed
    for name in ("first", "slow", "compared", "mine", "gains", "rehearsal", "frozen"):
        assert (tmp_path / "runs" / name / "report.html").is_file(), name


def test_the_chinese_page_has_the_same_commands() -> None:
    """Without what keeps a shell going that stops at errors."""

    def lines(page: str) -> list[str]:
        texts = [text for _, kind, text in blocks(page) if kind == "sh"]
        return [line.removesuffix(" || true") for text in texts for line in text.splitlines()]

    own, translated = lines("tutorial.md"), lines("zh/tutorial.md")
    assert set(translated) <= set(own) and len(translated) > 10
