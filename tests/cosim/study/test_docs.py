"""docs/sweep.md lists every key; the studies of the project run."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec
import pytest

from cosim.base.copies import replace
from cosim.study import figures, spec
from cosim.study.design import count, points
from cosim.study.execute import check
from cosim.study.run_point import job, run_point
from cosim.study.study import load_study
from tests.cli.command import options_of
from tests.cosim.study.studies import ROOT

PAGE = (ROOT / "docs" / "sweep.md").read_text(encoding="utf-8")
STUDIES = sorted((ROOT / "configs" / "studies").glob("*.toml"))


@pytest.mark.parametrize(
    "struct", [spec.StudySpec, spec.AxisSpec, spec.SampleSpec, spec.SweepFigureSpec]
)
def test_every_key_of_a_study_is_explained(struct: type[msgspec.Struct]) -> None:
    code = " ".join(re.findall(r"`[^`]*`", re.sub(r"```.*?```", "", PAGE, flags=re.DOTALL)))
    words = set(re.findall(r"\w+", code)) | {"title"}
    assert not {field.encode_name for field in msgspec.structs.fields(struct)} - words


def test_every_option_is_explained() -> None:
    options = options_of("sweep") - {"--plot", "--no-resume", "--help"}
    assert {"--resume", "--force", "--no-plot", "--quiet", "--out", "--jobs"} <= options
    assert all(f"`{option}" in PAGE for option in options)


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_the_studies_that_are_here_can_be_run(path: Path) -> None:
    loaded = load_study(path)
    assert 1 < count(loaded) <= 1000
    common = job(loaded, None)
    _, units = check(loaded, common)
    figures.check(loaded, [axis.name for axis in loaded.axes], units)
    point = next(points(loaded))
    row = run_point(common, replace(point, settings=(*point.settings, "run.stop='0.1 s'")))
    assert not row.reason
    assert set(row.measures) == set(units)


def test_the_study_of_the_page_is_one(tmp_path: Path) -> None:
    text = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)[0]
    scenario = str(ROOT / "configs" / "teleoperation.toml")
    page = tmp_path / "page.toml"
    page.write_text(text.replace("../teleoperation.toml", scenario), encoding="utf-8")
    loaded = load_study(page)
    assert count(loaded) == 50
    check(loaded, job(loaded, None))
