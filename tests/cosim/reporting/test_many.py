"""Reports and figures of many robots: quantiles in place of lines, and lists that end."""

import json
import re
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.record import Run
from cosim.reporting import moving
from cosim.reporting.declared import figure_specs
from cosim.reporting.figures import draw
from cosim.reporting.many import AGES, ARMS, LINKS, QUANTILES, quantile_lines
from cosim.reporting.moving import SIZE, write_gif
from cosim.reporting.run_report import write_report
from tests.bridge.zenoh.rehearsed import CONFIGS
from tests.cosim.reporting.test_report import data as page_data


def test_quantiles_are_those_over_the_columns() -> None:
    values = np.arange(20.0).reshape(2, 10)
    values[1, 0] = np.nan
    lines = dict(quantile_lines(np.vstack([values, np.full(10, np.inf)])))
    assert list(lines) == [name for name, _ in QUANTILES]
    np.testing.assert_array_equal(lines["least"], [0, 11, np.nan])
    np.testing.assert_array_equal(lines["median"], [4.5, 15, np.nan])
    np.testing.assert_allclose(lines["90 %"][0], 8.1)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("many") / "run"
    simulate(load(CONFIGS / "many.toml", ("graphs.net.n=40", "run.stop=2")), folder)
    return Run.open(folder)


def test_a_report_of_many_robots_has_quantiles_and_some_of_each_list(run: Run) -> None:
    page = write_report(run).read_text()
    data = page_data(page)
    first = data["panels"][0]
    assert [line["label"] for line in first["series"]] == [name for name, _ in QUANTILES]
    assert all(line["name"] in data["signals"] for line in first["series"])
    assert [arm["name"] for arm in data["arms"]] == [f"robot{i + 1}" for i in range(ARMS)]
    assert f"Only the first {ARMS} arms are drawn." in page
    assert sum(p["place"] == "ages" for p in data["panels"]) == AGES
    senders = re.findall("<td>control(\\d+)[.]xi → [^<]*</td>", page)
    assert len(senders) == LINKS and senders == sorted(senders, key=int)
    components = re.findall("<td>(?:robot|control)(\\d+)</td>", page)
    assert components == [*[str(i) for i in range(1, 41)] * 2]
    assert f"{160 - LINKS} further links are in the run folder only." in page
    assert "Age of the sample" in page and page.count("<tr>") < 300


def test_diagrams_that_are_not_declared_are_those_of_the_first_robots(run: Run) -> None:
    """In a run folder of a scenario that is not known: robot2, not robot10, follows robot1."""
    known = run.metadata
    (run.path.parent / "run.json").write_text(json.dumps({**known, "texts": {}, "scenario": {}}))
    try:
        panels = page_data(write_report(run).read_text())["panels"]
    finally:
        (run.path.parent / "run.json").write_text(json.dumps(known))
    titles = [panel["title"] for panel in panels if panel["place"] == "panels"]
    assert titles[:4] == ["robot1.q", "robot1.tau_h", "robot2.q", "robot3.q"]


def test_links_that_can_be_listed_are_all_drawn(tmp_path: Path) -> None:
    scenario = load(CONFIGS / "many.toml", ("graphs.net.n=6", "run.stop=0.5"))
    simulate(scenario, tmp_path / "run")
    page = write_report(Run.open(tmp_path / "run")).read_text()
    data = page_data(page)
    assert "arms are drawn" not in page
    assert sum(p["place"] == "ages" for p in data["panels"]) == LINKS


def test_names_of_many_arms_stand_below_what_moves(run: Run, tmp_path: Path) -> None:
    """Of the first arms only; and the pixels of the drawing are within its square."""
    from PIL import Image

    with Image.open(write_gif(run, tmp_path / "a.gif")) as found:
        picture = np.asarray(found.convert("L"))
        assert found.width == SIZE
    corner = picture[: SIZE // 8, : SIZE // 8]  # no arm reaches it
    assert corner.min() > 240
    lines = (picture[SIZE:] < 240).any(axis=1).reshape(-1)
    assert np.count_nonzero(np.diff(lines.astype(int)) == 1) == 3  # two of names, one of the time


def test_arms_in_space_fill_the_picture_and_cover_none() -> None:
    """Twelve arms that reach over squares of 2 m, each around another place, m."""
    square = np.array([[[-1.0, -1.0], [1.0, 1.0]]])
    tracks = [square + 10.0 * k for k in range(ARMS)]
    places, scale = moving._layout(tracks, list(range(ARMS)), flat=False)
    drawn = [moving.pixels(t[0] - place, scale) for t, place in zip(tracks, places, strict=True)]
    corners = np.sort(np.array(drawn), axis=1)  # of each square: least and greatest x and y
    assert corners.min() >= 0 and corners.max() <= SIZE
    assert np.prod(corners[:, 1] - corners[:, 0], axis=1).sum() > 0.4 * SIZE**2
    for (low, high), (other, end) in combinations(corners, 2):
        assert (high <= other).any() or (end <= low).any()


def test_a_figure_of_many_robots_has_lines_of_quantiles(run: Run, tmp_path: Path) -> None:
    from cosim.reporting import figures

    scenario = load(CONFIGS / "many.toml", ("graphs.net.n=40", "run.stop=2"))
    [figure] = figure_specs(scenario, run).values()
    lines, references = figures._lines(figure.panels[0], run, "here")
    assert [line.label for line in lines] == [name for name, _ in QUANTILES]
    assert len(references) == 1
    assert draw(figure, run, tmp_path / "f.png").stat().st_size > 10_000
