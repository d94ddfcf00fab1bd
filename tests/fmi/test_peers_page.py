"""peers.md: its rows are what is measured, ours say yes, and the tests they name exist."""

from __future__ import annotations

from pathlib import Path

import pytest

from docs.evidence import peers as page
from tests.fmi.abilities import ABILITIES


def table() -> list[list[str]]:
    text = page.PAGE.read_text(encoding="utf-8").split(page.BEGIN)[1].split(page.END)[0]
    lines = text.splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_each_row_is_an_ability_and_this_project_has_it() -> None:
    rows = table()
    assert [row[0] for row in rows] == [ability.title for ability in ABILITIES]
    assert {row[1] for row in rows} == {"yes"}
    for row, ability in zip(rows, ABILITIES, strict=True):
        assert row[5:7] == [f"*{cell}*" if cell else "" for cell in ability.read]
        assert (page.ROOT / ability.test).is_file()


@pytest.mark.slow
@pytest.mark.parametrize("ability", ABILITIES, ids=lambda ability: ability.title)
def test_this_project_says_yes(tmp_path: Path, ability: object) -> None:
    assert ability.probe("cosim", tmp_path) == "yes"  # type: ignore[attr-defined]


def test_a_cell_is_measured(tmp_path: Path) -> None:
    """An FMU that does not take a parameter: an error here, and a wrong run in FMPy."""
    (ability,) = (a for a in ABILITIES if "does not take" in a.title)
    assert [ability.probe(peer, tmp_path) for peer in ("cosim", "FMPy")] == ["yes", "no"]


@pytest.mark.slow
@pytest.mark.needs_tbb
@pytest.mark.parametrize("ability", ABILITIES, ids=lambda ability: ability.title)
def test_measured_again_the_row_is_the_same(ability: object) -> None:
    assert page.row(ability) in page.PAGE.read_text(encoding="utf-8")  # type: ignore[arg-type]
