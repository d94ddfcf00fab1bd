"""Figures: the right lines, the right words, the same bytes."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cosim.base.copies import replace
from cosim.base.errors import RunError, ScenarioError
from cosim.cli.report import report
from cosim.record import Column, Recorder, Run
from cosim.reporting.figures import Figure, Panel, axis_label, draw
from cosim.reporting.html import TimedEvent
from cosim.reporting.marks import failure, marks

BLUE, VERMILLION, WHITE = (0x00, 0x72, 0xB2), (0xD5, 0x5E, 0x00), (255, 255, 255)
NAMES = {
    "m.q[0]": "rad", "m.q[1]": "rad", "s.q[0]": "rad", "s.q[1]": "rad",
    "m.theta_hat": "kg.m2", "m.odd": "1", "m.gap": "N.m",
}  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("run")
    t = np.arange(9001) * 1e-3
    q = 3.5 * (1 - np.exp(-t))
    gap = np.where((t > 3) & (t < 6), np.nan, q)
    gap[100], gap[200] = np.inf, 1e308
    rows = np.column_stack([q, -q, q - np.exp(-t), q, 2 * q, q, gap])
    columns = [Column(name, unit, i) for i, (name, unit) in enumerate(NAMES.items())]
    with Recorder(folder, columns, h=1e-3, n_signals=7, rows_per_chunk=9001) as recorder:
        buffer = recorder.buffer()
        buffer[:] = rows
        recorder.submit(buffer, 0, 9001)
    return Run.open(folder)


FIGURE = Figure(
    (
        Panel(("m.q[0]", "s.q[0]"), "first coordinate", ("master", "slave"), (3.5,), "q_h"),
        Panel(("m.q[1]", "s.q[1]"), "second coordinate", ("master", "slave"), ("s.q[0]",)),
    ),
    "Positions of the master and slave robots",
)


def pixels(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def count(image: np.ndarray, colour: tuple[int, int, int]) -> int:
    return int((np.abs(image - colour).max(axis=-1) < 12).sum())


def test_two_panels(run: Run, tmp_path: Path) -> None:
    path = draw(FIGURE, run, tmp_path / "positions.png")
    image = pixels(path)
    with Image.open(path) as file:
        assert file.format == "PNG"
        assert file.info["dpi"] == pytest.approx((150, 150), abs=0.1)
        assert "Software" not in file.info
    height, width, _ = image.shape
    assert width == 1080
    for half in (image[: height // 2], image[height // 2 :]):  # both lines in both panels
        assert count(half, BLUE) > 300 and count(half, VERMILLION) > 300
    edge = np.concatenate([image[:4].reshape(-1, 3), image[:, -4:].reshape(-1, 3)])
    assert count(edge, WHITE) == len(edge)  # nothing is cut off
    assert [p.name for p in tmp_path.iterdir()] == ["positions.png"]


def test_same_run_same_bytes_whatever_the_users_style(run: Run, tmp_path: Path) -> None:
    import matplotlib

    one = draw(FIGURE, run, tmp_path / "one.png").read_bytes()
    with matplotlib.rc_context({"lines.linewidth": 9, "font.size": 20, "savefig.dpi": 10}):
        before = dict(matplotlib.rcParams)
        two = draw(FIGURE, run, tmp_path / "two.png").read_bytes()
        assert dict(matplotlib.rcParams) == before
    assert one == two


def test_a_vector_is_drawn_entry_by_entry(run: Run, tmp_path: Path) -> None:
    whole = draw(Figure((Panel(("m.q",)),)), run, tmp_path / "a.png").read_bytes()
    each = Figure((Panel(("m.q[0]", "m.q[1]"), ylabel="q"),))
    assert draw(each, run, tmp_path / "b.png").read_bytes() == whole


def test_the_legend_takes_the_room_it_needs(run: Run, tmp_path: Path) -> None:
    long = Figure((Panel(("m.q[0]",), labels=("the position of the first joint",)),))
    image = pixels(draw(long, run, tmp_path / "a.png"))
    assert count(image[:, -4:], WHITE) == image[:, -4:].shape[0] * 4


def test_size_in_inches(run: Run, tmp_path: Path) -> None:
    figure = Figure(FIGURE.panels, size=(5.0, 4.0))
    assert pixels(draw(figure, run, tmp_path / "a.png")).shape[:2] == (600, 750)


def test_a_figure_for_a_column_has_its_legends_inside(run: Run, tmp_path: Path) -> None:
    narrow = pixels(draw(replace(FIGURE, width=3.5), run, tmp_path / "a.png"))
    assert narrow.shape[1] == 525 and narrow.shape[0] < 700
    frame = np.flatnonzero((narrow[:, -60:] < 40).all(axis=2).any(axis=0))
    assert frame.size and frame[-1] > 20  # the panels reach the right edge
    with pytest.raises(ScenarioError, match=r"--width: found 0\.01 m, expected 0\.05 m to 1 m"):
        report(tmp_path, png=True, width="1 cm")


def test_values_that_are_not_finite_are_gaps(run: Run, tmp_path: Path) -> None:
    image = pixels(draw(Figure((Panel(("m.gap",)),)), run, tmp_path / "a.png"))
    left, middle, right = np.split(image[:, 110:860], 3, axis=1)
    assert count(left, BLUE) > 100 and count(right, BLUE) > 100
    assert count(middle[:, 60:-60], BLUE) == 0


def test_a_line_that_another_one_hides_shows_in_its_gaps(run: Run, tmp_path: Path) -> None:
    """m.q[0] and s.q[1] are the same values."""
    image = pixels(draw(Figure((Panel(("m.q[0]", "s.q[1]")),)), run, tmp_path / "a.png"))
    axes = image[:, 110:860]
    assert count(axes, BLUE) > 150 and count(axes, VERMILLION) > 150
    apart = pixels(draw(Figure((Panel(("m.q[0]", "s.q[0]")),)), run, tmp_path / "b.png"))
    assert count(apart[:, 110:860], VERMILLION) > 1.5 * count(axes, VERMILLION)


def test_events_are_marked_in_every_panel_from_their_start_to_their_end(
    run: Run, tmp_path: Path
) -> None:
    events = (TimedEvent(3.0, "slave: FAULT", 6.0), TimedEvent(99.0, "after the run"))
    marked = Figure(FIGURE.panels, FIGURE.title, events=events)
    plain = pixels(draw(FIGURE, run, tmp_path / "plain.png"))
    image = pixels(draw(marked, run, tmp_path / "marked.png"))
    height = image.shape[0]
    for half in (slice(0, height // 2), slice(height // 2, height)):
        changed = np.flatnonzero((image[half] != plain[half]).any(axis=(0, 2)))
        inner = changed[(changed > 110) & (changed < 800)]
        assert (inner[0] - 108) / (inner[-1] - 108) == pytest.approx(3 / 6, abs=0.02)
    one_panel = Figure(FIGURE.panels[:1], events=events[1:])
    bare = draw(Figure(FIGURE.panels[:1]), run, tmp_path / "a.png").read_bytes()
    assert draw(one_panel, run, tmp_path / "b.png").read_bytes() == bare  # outside what is shown


def test_a_failed_run_says_so_in_red(run: Run, tmp_path: Path) -> None:
    failed = Figure(FIGURE.panels, FIGURE.title, failure="master: diverged " + 30 * "very ")
    image = pixels(draw(failed, run, tmp_path / "a.png"))
    red = image[:, :, 0] - image[:, :, 2] > 120
    assert red[:90].sum() > 300 and not red[:90, :40].any() and not red[:90, -20:].any()


def test_what_is_marked_is_said_by_the_run_folder() -> None:
    facts = {
        "status": "stopped",
        "error": "RunError: master: diverged",
        "scenario": {"events": [{"at": "2 s", "over": 0.5, "for": "1 s", "set": {"m.tau": 3.0}}]},
        "marks": [{"t": 1.0, "label": "slave: FAULT", "to": 4.0}],
    }
    assert marks(facts) == [
        TimedEvent(1.0, "slave: FAULT", 4.0), TimedEvent(2.0, "m.tau = 3.0", 3.5)
    ]  # fmt: skip
    assert failure(facts) == "master: diverged"
    assert failure(facts | {"rehearsal": {"verdict": "failed", "reasons": ["a", "b"]}}) == "a; b"
    assert failure({"status": "finished", "rehearsal": {"verdict": "passed"}}) == ""


def test_many_lines_and_mathematics(run: Run, tmp_path: Path) -> None:
    panel = Panel(("m.q[0]",) * 9, labels=("$q_1$", "ξ", r"$\hat\theta$"), reference=(1.0, 2.0))
    image = pixels(draw(Figure((panel,)), run, tmp_path / "a.png"))
    assert count(image, VERMILLION) > 300  # the ninth is on top


@pytest.mark.parametrize("rows", [0, 1])
def test_hardly_any_rows(tmp_path: Path, rows: int) -> None:
    with Recorder(tmp_path, [Column("x", "m", 0)], h=1.0, n_signals=1) as recorder:
        buffer = recorder.buffer()
        buffer[:rows] = 1.0
        recorder.submit(buffer, 0, rows)
    figure = Figure((Panel(("x",), reference=("x", 2.0)),), "empty")
    assert pixels(draw(figure, Run.open(tmp_path), tmp_path / "a.png")).size


@pytest.mark.parametrize(
    ("panel", "label"),
    [
        (Panel(("m.q[0]", "s.q[0]")), "q[0] [rad]"),
        (Panel(("m.q[0]", "s.q[1]"), ylabel="position"), "position [rad]"),
        (Panel(("m.q[0]", "s.q[1]")), "[rad]"),
        (Panel(("m.theta_hat",), ylabel="ϑ"), "ϑ [kg·m²]"),
        (Panel(("m.odd",)), "odd"),
        (Panel(("m.q[0]", "m.theta_hat"), ylabel="x"), "x [rad, kg·m²]"),
    ],
)
def test_axis_labels_carry_the_unit(run: Run, panel: Panel, label: str) -> None:
    assert axis_label(panel, run) == label


@pytest.mark.parametrize(
    ("figure", "sentence"),
    [
        (
            Figure((Panel(("m.q[0]",)), Panel(("m.p",))), "A"),
            "figure 'A', panel 2: .*'m.p'.*mean 'm",
        ),
        (Figure((Panel(("m.q",), reference=("m.r",)),), "A"), "panel 1: .*no signal 'm.r'"),
        (Figure((Panel(()),), "A"), "figure 'A', panel 1: a panel needs at least one signal"),
        (Figure((), "A"), "figure 'A': a figure needs at least one panel"),
    ],
)
def test_what_cannot_be_drawn(run: Run, tmp_path: Path, figure: Figure, sentence: str) -> None:
    with pytest.raises(ScenarioError, match=sentence):
        draw(figure, run, tmp_path / "a.png")
    assert not list(tmp_path.iterdir())


def test_a_file_that_cannot_be_written(run: Run, tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"cannot write .*a\.png: No such file"):
        draw(FIGURE, run, tmp_path / "gone" / "a.png")


def test_imports_wait_until_they_are_needed() -> None:
    code = (
        "import sys, cosim.record, cosim.measure.metrics, cosim.reporting.figures as figures\n"
        "assert not {'pyarrow', 'matplotlib', 'pandas'} & set(sys.modules)\n"
        "figures.load(lean=True)\n"
        "from matplotlib.artist import kwdoc\n"
        "from matplotlib.lines import Line2D\n"
        "assert 'linewidth' in kwdoc(Line2D)\n"  # put back
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_colours_are_those_of_the_page() -> None:
    from importlib.resources import files

    from cosim.reporting.figures import COLOURS

    style = (files("cosim.reporting") / "assets" / "report.css").read_text(encoding="utf-8")
    light = dict(re.findall(r"--s(\d): (#\w+);", style.split("@media", 1)[0]))
    full = [c if len(c) == 7 else "#" + "".join(2 * x for x in c[1:]) for c in light.values()]
    assert full == [*COLOURS] and [*light] == [str(i) for i in range(len(COLOURS))]


def test_a_line_has_the_colour_that_its_panel_names(run: Run, tmp_path: Path) -> None:
    from cosim.reporting.figures import COLOURS

    panel = Panel(FIGURE.panels[0].y[:1], colours=(2,))
    image = pixels(draw(Figure((panel,)), run, tmp_path / "a.png"))
    red, green, blue = bytes.fromhex(COLOURS[2][1:])
    assert count(image, (red, green, blue)) > 100 and count(image, BLUE) == 0
