"""docs/controllers.md: its examples run, and it lists every preset, study, person and column."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from cosim.comparison.variants_file import read
from cosim.links.presets import PRESETS
from tests.cosim.comparison.parts import CONFIG, ROOT, VARIANTS
from tests.cosim.comparison.test_command import call

PAGE = (ROOT / "docs" / "controllers.md").read_text(encoding="utf-8")
STUDIES = ROOT / "configs" / "compare" / "studies"


def block(language: str, first: str) -> str:
    """The fenced block that begins with a line."""
    found = re.findall(rf"```{language}\n({re.escape(first)}.*?)```", PAGE, re.DOTALL)
    assert len(found) == 1
    return str(found[0])


def test_the_controller_of_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a folder of its own, over one frozen trace, for two seconds; it is P+d."""
    (tmp_path / "coupling.py").write_text(block("python", "# coupling.py"), encoding="utf-8")
    text = block("toml", "# mine.toml").replace('"configs/', f'"{ROOT}/configs/')
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    call(
        CONFIG, "--variants", tmp_path / "mine.toml", "--controllers", "mine,p+d",
        "--operators", "person-felt", "--links", "geo", "--columns", "effort,position-free",
        "--set", "run.stop=2 s", "--jobs", "1", "--out", tmp_path / "out", "--quiet", "--no-plot",
    )  # fmt: skip
    data = json.loads((tmp_path / "out" / "table.json").read_text(encoding="utf-8"))
    mine, theirs = (run["numbers"] for run in data["runs"])
    assert mine == pytest.approx(theirs, rel=1e-9)


def test_the_page_knows_what_there_is() -> None:
    for name in PRESETS:
        stem = re.sub(r"-(up|down|\d|high|medium|low)$", "", name)
        assert f"`{name}`" in PAGE or f"`{stem}-" in PAGE, name
    for path in STUDIES.glob("*.toml"):
        assert path.stem in PAGE
    variants = read(VARIANTS)
    people = [name for name in variants.operators if name.startswith("person")]
    assert people and all(f"`{name}`" in PAGE for name in people)
    columns = PAGE[PAGE.index("## Columns") : PAGE.index("## Published studies")]
    kinds = {str(getattr(c.metric, "kind", "energy")) for c in variants.columns}
    assert all(f"`{kind}`" in columns for kind in kinds)
    assert "(evidence/controllers.md#the-benchmark)" in PAGE
