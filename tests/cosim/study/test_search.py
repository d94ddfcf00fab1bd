"""The search for a boundary: where it is, and that it is found the same way every time."""

from __future__ import annotations

import csv
import importlib.util
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from math import nan
from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import CosimError
from cosim.base.processes import Pool
from cosim.study.boundary import regions
from cosim.study.execute import check
from cosim.study.run_point import StudyRow, job
from cosim.study.search import Search
from cosim.study.study import Study, load_study
from cosim.study.table import SweepTable
from tests.cli.command import Command
from tests.cosim.study.studies import STUDY, written
from tests.cosim.study.test_sweep import table

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("adaptive") is None, reason="needs the extra adaptive"
)

#: The loop's x shrinks by 1 - gain/100 a step: it grows above 200, whatever the start.
GAIN = STUDY + "uniform = [10, 400]\n[stable]\nrest = 100\n"
ONE = GAIN + "[boundary]\nruns = 40\nbatch = 8\n"
START = "[vary.start]\npath = 'components.plant.start.x'\nloguniform = [1, 100]\n"


def studied(folder: Path, text: str) -> Study:
    return load_study(written(folder, text))


def searched(study: Study, inside: Callable[..., bool], slots: int = 1) -> SweepTable:
    """The table of a search in which runs are inside where a function of their axes says so."""
    search, records = Search(study, "", {}, None), []
    search.use(Pool(ThreadPoolExecutor(), lambda: slots))
    waiting: list = []
    while task := next(search, None) or waiting:
        if task is not waiting:
            waiting += task
            if len(waiting) < 5 * slots:
                continue
        for point in reversed(waiting):  # they are done in any order
            row = StudyRow(point.run, point.cells, (), inside(**point.cells), "", nan, 0.1)
            search.note(row)
            records.append({"run": row.run, "stable": row.stable, "reason": "", **point.cells})
        waiting = []
    order = {point.run: i for i, point in enumerate(search.asked)}
    records.sort(key=lambda r: order[r["run"]])
    return SweepTable(tuple(a.name for a in study.axes), {}, records, search.total)


def test_one_axis(cosim: Command, tmp_path: Path) -> None:
    threads = ("--workers", "threads")
    done = cosim("sweep", written(tmp_path, ONE), *threads, "--out", "here", "--png")
    assert done.code == 0, done
    assert "40 points; 40 to run" in done.out
    (found,) = csv.DictReader((tmp_path / "here" / "boundary.csv").open())
    exact = 100 * (1 + 100 ** (1 / 400))
    assert abs(float(found["gain"]) - exact) <= float(found["gain.within"]) < 0.2
    assert "boundary: 1 places between 40 points, half of them within 0.03% of the" in done.out
    assert (tmp_path / "here" / "boundary.png").stat().st_size > 5000


def test_a_measure_and_its_level(cosim: Command, tmp_path: Path) -> None:
    """|x| at the end is start (1 - gain/100)^400: at most 1/2 below this gain."""
    text = STUDY + "uniform = [0.1, 2]\n" + START + (
        "[boundary]\nof = 'rest'\nlevel = 0.5\nruns = 60\n"
    )  # fmt: skip
    cosim("sweep", written(tmp_path, text), "--workers", "threads", "--out", "here", "--quiet")
    rows = list(csv.DictReader((tmp_path / "here" / "boundary.csv").open()))
    assert len(rows) > 10
    for row in rows:
        gain = 100 * (1 - (0.5 / float(row["start"])) ** (1 / 400))
        assert abs(float(row["gain"]) - gain) < 0.05


def test_any_number_of_workers_and_any_interruption_give_the_same(
    cosim: Command, tmp_path: Path
) -> None:
    text = "seeds = 2\n" + GAIN + "[boundary]\nruns = 30\nbatch = 7\n"
    text = text.replace("[vary.gain]", START + "[vary.gain]")
    study = written(tmp_path, text)
    cosim("sweep", study, "--jobs", 2, "--out", "a", "--no-plot")
    for limit in (1, 9, 20):
        done = cosim(
            "sweep", study, "--workers", "threads", "--jobs", 3, "--out", "b", "--no-plot",
            "--limit", limit, *["--resume"] * (limit > 1),
        )  # fmt: skip
        assert done.code == 0, done
    done = cosim("sweep", study, "--workers", "threads", "--out", "b", "--no-plot", "--resume")
    assert "60 points; 30 there already; 30 to run" in done.out
    a, b = ([{**r, "wall": 0} for r in table(tmp_path / x)] for x in "ab")
    assert len(a) == 60
    assert repr(a) == repr(b)
    done = cosim("sweep", study, "--workers", "threads", "--out", "b", "--no-plot", "--resume")
    assert "60 there already; 0 to run" in done.out


def test_points_gather_at_the_boundary(tmp_path: Path) -> None:
    text = GAIN.replace("uniform = [10, 400]", "uniform = [-1, 1]") + (
        "[vary.b]\npath = 'run.seed'\nuniform = [-1, 1]\n[boundary]\nruns = 200\n"
    )
    study = studied(tmp_path, text)
    found = searched(study, lambda gain, b: gain**2 + b**2 < 0.5)
    assert found == searched(study, lambda gain, b: gain**2 + b**2 < 0.5, slots=3)
    (region,) = regions(study, found)
    at, _ = region.crossings()
    radius = np.hypot(*region.values(at).T)
    assert np.abs(radius - 0.5**0.5).max() < 0.06
    near = np.abs(np.hypot(*region.values(region.at).T) - 0.5**0.5) < 0.1
    assert near.mean() > 0.6  # 28 % of the square


def test_three_axes_and_cases(tmp_path: Path) -> None:
    text = GAIN.replace("uniform = [10, 400]", "loguniform = [0.1, 10]") + (
        "[vary.b]\npath = 'run.seed'\nuniform = [0, 1]\n"
        "[vary.c]\npath = 'run.title'\nuniform = [0, 1]\n"
        "[vary.case.cases]\nlow = []\nnone = []\n[boundary]\nruns = 120\n"
    )
    study = studied(tmp_path, text)
    found = searched(study, lambda gain, b, c, case: case == "low" and np.log10(gain) + b + c < 1)
    assert [len(r.at) for r in regions(study, found)] == [120, 120]
    low, none = regions(study, found)
    assert (low.chosen, none.chosen) == ({"case": "low"}, {"case": "none"})
    values = low.values(low.crossings()[0])
    assert np.median(np.abs(np.log10(values[:, 0]) + values[:, 1] + values[:, 2] - 1)) < 0.15
    assert len(none.crossings()[0]) == 0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (ONE + "[sample]\ncount = 3\n", "at boundary: found [sample] as well"),
        (STUDY + "values = [1, 2]\n[boundary]\n", "found 0 axes with uniform or loguniform"),
        (ONE.replace("uniform", "normal"), "at vary.gain: found the law normal, expected uniform"),
        (ONE + "of = 'nothing'\n", "at boundary.of: no measure 'nothing' (there are: rest, "),
        (ONE + "level = 0\n", "at boundary.level: "),
    ],
)
def test_what_cannot_be_searched_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(CosimError) as error:
        study = studied(tmp_path, text)
        check(study, job(study, None))
    assert said in str(error.value)


def test_without_adaptive_it_is_said_what_to_install(
    cosim: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "adaptive", None)
    said = cosim.refused("sweep", written(tmp_path, ONE), "--workers", "threads")
    assert "pip install 'cosim-bridge[adaptive]'" in said
