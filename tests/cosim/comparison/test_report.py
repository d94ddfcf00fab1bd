"""What a comparison writes: the table in four forms, and the figure."""

from __future__ import annotations

import csv
import io
import json
import re
from math import inf
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cosim.base.copies import replace
from cosim.base.errors import RunError, ScenarioError
from cosim.comparison import page, report
from cosim.comparison.comparison import Comparison
from cosim.comparison.figure import _Cells, draw
from cosim.comparison.measure import CaseOutcome
from cosim.comparison.rows import columns, format_number, rows
from cosim.reporting.figures import DPI
from tests.cosim.comparison.parts import VARIANTS, compared

COMMAND = "cosim compare configs/teleoperation.toml"


@pytest.fixture(scope="module")
def found() -> Comparison:
    """Nobody at the master: both come to rest; a tight grip: one does, one diverges."""
    return compared(
        VARIANTS, ["p+d", "paper"], ["free", "tight"], ["constant"], settings=["run.stop=30 s"]
    )


def test_the_text_has_a_block_an_operator_and_a_line_a_controller(found: Comparison) -> None:
    lines = report.text(found)
    assert "link constant: T = 0.75 s" in lines
    assert "tight: 200 N·m/rad, 2 N·m·s/rad" in lines
    heads = [line for line in lines if line.startswith("  controller")]
    assert len(heads) == 2
    for head in heads:
        block = lines[lines.index(head) :][:3]
        assert [line.split()[0] for line in block] == ["controller", "p+d", "paper"]
    assert "no: diverged at 0.17 s" in "\n".join(lines)
    assert "link tables: the same for every controller" in lines


def test_markdown_is_one_table_with_its_command(found: Comparison) -> None:
    text = report.markdown(found, COMMAND)
    table = [line for line in text.splitlines() if line.startswith("|")]
    assert f"`{COMMAND}`" in text
    assert len(table) == 2 + 4
    assert len({line.replace("\\|", "").count("|") for line in table}) == 1
    assert table[2].startswith("| constant | free | p+d | – |")
    assert "motion left the range" in text  # why it diverged


def test_csv_reads_back_exactly(found: Comparison) -> None:
    lines = list(csv.DictReader(io.StringIO(report.table_csv(found))))
    assert len(lines) == len(found.outcomes)
    for line, outcome in zip(lines, found.outcomes, strict=True):
        assert line["controller"] == outcome.case.controller
        assert line["stable"] == str(outcome.verdict.stable)
        for column, unit in columns(found):
            text = line[f"{column.name} [{unit}]"]
            if column.name in outcome.numbers:
                assert float(text) == outcome.numbers[column.name][0]
            else:
                assert text == ""


def test_json_has_everything_and_no_nan(found: Comparison) -> None:
    data = json.loads(json.dumps(report.as_data(found, COMMAND)), parse_constant=pytest.fail)
    assert data["command"] == COMMAND
    assert data["link_tables"]["same"] is True
    assert [t["runs"] for t in data["link_tables"]["tables"]] == [4, 4]
    assert data["columns"]["effort"]["unit"] == "N.m.√s"
    runs = {(run["operator"], run["controller"]): run for run in data["runs"]}
    assert runs["tight", "paper"]["numbers"] == {}
    assert runs["tight", "paper"]["ended_at_s"] == pytest.approx(0.17, abs=0.01)
    assert runs["free", "p+d"]["ended_at_s"] is None
    assert runs["free", "p+d"]["numbers"]["synchronised"] == pytest.approx(3.5, rel=0.1)


@pytest.mark.parametrize(
    ("value", "unit", "expected"),
    [
        (9.34, "s", "9.3"),
        (inf, "s", "never"),
        (inf, "rad", "∞"),
        (46.96, "N.m", "47"),
        (2476.4, "N.m", "2476"),
        (2.5e-9, "N.m", "<0.001"),
        (0.0, "N.m", "0"),
    ],
)
def test_how_a_number_is_shown(value: float, unit: str, expected: str) -> None:
    assert format_number(value, unit) == expected


def test_the_worst_of_several_seeds_decides(found: Comparison) -> None:
    row = next(r for r in rows(found) if (r.operator, r.controller) == ("tight", "paper"))
    good = next(r for r in rows(found) if (r.operator, r.controller) == ("tight", "p+d"))
    mixed = replace(row, outcomes=(*good.outcomes, *row.outcomes))
    assert mixed.stable == "no: diverged at 0.17 s (1 of 2 seeds)"
    assert mixed.cell(found.variants.columns[0], "s") == "–"


def cells(page: str, controller: str) -> list[str]:
    """The classes of the numbers in the rows of a controller, over all tables of a page."""
    found = re.findall(rf"<tr[^>]*><td class='name'>{re.escape(controller)}</td>(.*?)</tr>", page)
    return [x for row in found for x in re.findall(r'<td class="number([^"]*)"', row)]


def test_a_law_under_which_an_arm_never_moves_is_not_the_best(tmp_path: Path) -> None:
    found = compared(
        VARIANTS, ["free", "pd", "p+d"], ["light"], ["constant"], settings=["run.stop=30 s"]
    )
    still = {row.controller: row.still for row in rows(found)}
    assert still == {"free": ("slave.q",), "pd": (), "p+d": ()}
    none, one = (next(r for r in rows(found) if r.controller == x) for x in ("free", "pd"))
    effort = next(c for c, _ in columns(found) if c.name == "effort")
    assert none.values(effort) < one.values(effort) and none.is_stable and not none.is_ranked
    assert "; no motion of slave.q" in none.stable
    text = page.write(found, tmp_path, COMMAND).read_text(encoding="utf-8")
    assert not any(cells(text, "free"))
    assert {" best", " worst"} <= {*cells(text, "pd"), *cells(text, "p+d")}


def test_numbers_that_look_alike_are_neither_best_nor_worst(
    found: Comparison, tmp_path: Path
) -> None:
    """Errors of 1e-9 and 2e-9 rad in two rows are alike; of 0.1 and 0.2 rad, one is better."""
    column = next(c for c, _ in columns(found) if c.name == "apart")

    def marked(*values: float) -> list[str]:
        good = next(o for o in found.outcomes if o.verdict.stable and o.case.operator == "free")
        outcomes = [
            replace(
                good, case=replace(good.case, controller=name), numbers={column.name: (value, "m")}
            )
            for name, value in zip(("p+d", "paper"), values, strict=True)
        ]
        chosen = replace(found.chosen, operators=("free",))
        one = replace(found, outcomes=tuple(outcomes), chosen=chosen)
        text = page.write(one, tmp_path, COMMAND).read_text(encoding="utf-8")
        return [x for name in ("p+d", "paper") for x in cells(text, name) if x]

    assert marked(1e-9, 2e-9) == []
    assert marked(0.1, 0.2) == [" best", " worst"]


def test_a_row_that_is_not_stable_is_marked_and_never_the_best(
    found: Comparison, tmp_path: Path
) -> None:
    text = page.write(found, tmp_path, COMMAND).read_text(encoding="utf-8")
    assert [r.controller for r in rows(found) if not r.is_stable] == ["paper"]
    assert text.count("<tr class='unranked unstable'>") == text.count("<tr class='unranked") == 1
    row = text.split("<tr class='unranked unstable'>")[1].split("</tr>")[0]
    assert "no: diverged at 0.17 s" in row


# ---- files -------------------------------------------------------------------------------------


def test_what_is_written(found: Comparison, tmp_path: Path) -> None:
    report.claim(tmp_path / "new")
    paths = list(report.write(found, tmp_path / "new", COMMAND))
    assert [p.name for p in paths] == ["table.md", "table.csv", "table.json", "links"]
    assert len(list((tmp_path / "new" / "links").glob("constant-seed0/*.parquet"))) == 2


def test_only_a_comparison_is_replaced(found: Comparison, tmp_path: Path) -> None:
    list(report.write(found, tmp_path, COMMAND))
    with pytest.raises(ScenarioError, match="not empty; expected an empty one, or --force"):
        report.claim(tmp_path)
    report.claim(tmp_path, force=True)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
    (tmp_path / "thesis.tex").touch()
    (tmp_path / report.RESULT).touch()
    with pytest.raises(ScenarioError, match="not empty"):
        report.claim(tmp_path, force=True)
    assert (tmp_path / "thesis.tex").exists()


def test_a_file_that_cannot_be_written_is_named(found: Comparison, tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"cannot write .*table\.md: No such file"):
        list(report.write(found, tmp_path / "none", COMMAND))
    with pytest.raises(RunError, match=r"cannot write .*x\.png"):
        draw(found, tmp_path / "none" / "x.png")


# ---- the figure --------------------------------------------------------------------------------


def colour(outcome: CaseOutcome, comparison: Comparison, picture: np.ndarray) -> tuple[int, ...]:
    """The ground of an outcome's cell, near its upper right corner."""
    c, cells = comparison.chosen, _Cells.of(comparison)
    i, j = c.operators.index(outcome.case.operator), c.controllers.index(outcome.case.controller)
    x, y = cells.corner(0, i, j)
    x, y = x + cells.size[0] - 0.05, cells.height - y - cells.size[1] + 0.05
    return tuple(picture[round(y * DPI), round(x * DPI)])


def test_each_run_is_a_cell_on_the_ground_of_its_verdict(found: Comparison, tmp_path: Path) -> None:
    with Image.open(draw(found, tmp_path / "figure.png")) as image:
        picture = np.asarray(image.convert("RGB"))
    grounds = {o.verdict.kind: colour(o, found, picture) for o in found.outcomes}
    assert grounds["at rest"] == (255, 255, 255)
    assert grounds["diverged"] == (0xF6, 0xB8, 0xA8)
    blue = picture[:, :, 2].astype(int) - picture[:, :, 0] > 80
    assert blue.sum() > 300  # trajectories of the first signal


def test_the_same_comparison_draws_the_same_bytes(found: Comparison, tmp_path: Path) -> None:
    first, second = draw(found, tmp_path / "1.png"), draw(found, tmp_path / "2.png")
    assert first.read_bytes() == second.read_bytes()


def test_runs_that_left_nothing_behind_can_be_drawn(found: Comparison, tmp_path: Path) -> None:
    bare = replace(found, outcomes=tuple(replace(o, curves=()) for o in found.outcomes))
    assert draw(bare, tmp_path / "bare.png").stat().st_size > 1000
