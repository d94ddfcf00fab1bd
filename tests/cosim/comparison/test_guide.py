"""Every controller is in docs/controllers.md; the tables of the evidence are as printed."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from cosim.comparison.variants_file import read
from tests.cosim.comparison.parts import ROOT, VARIANTS
from tests.cosim.comparison.test_command import call

GUIDE = ROOT / "docs" / "controllers.md"
_TABLE = re.compile(r"<!-- table: (.*) -->\n.*\n\n((?:\|.*\n)+)<!-- end -->")


def test_every_controller_is_in_the_guide() -> None:
    guide = GUIDE.read_text(encoding="utf-8")
    for name in read(VARIANTS).controllers:
        assert f"`{name}`" in guide, name


@pytest.mark.slow
def test_tables_of_the_guide_are_what_their_commands_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = ROOT / "docs" / "evidence" / "controllers.md"
    tables = _TABLE.findall(page.read_text(encoding="utf-8"))
    assert len(tables) == 4
    monkeypatch.chdir(ROOT)
    for i, (command, expected) in enumerate(tables):
        _, _, *arguments = shlex.split(command)
        call(*arguments, "--out", tmp_path / str(i), "--no-plot", "--quiet", "--jobs", "1")
        lines = (tmp_path / str(i) / "table.md").read_text(encoding="utf-8").splitlines()
        assert [x for x in lines if x.startswith("|")] == expected.splitlines()
