"""The examples of docs/bus.md run, one after the other."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[3] / "docs/bus.md"


def test_the_examples_of_the_page_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    examples = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    scope: dict[str, object] = {}
    for example in examples:
        exec(example, scope)
    assert len(examples) == 4
    assert "0x100: 99 % within" in capsys.readouterr().out
    assert (tmp_path / "bus.png").stat().st_size > 10_000
