"""The FMU of a link: what it holds follows its table, and after the table's end its last age."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fmus.models.delay import LinkDelay, build_links
from tests.cosim.fmi.exporter import outputs, plan_of

pytestmark = pytest.mark.usefixtures("compiled_once")
STEPS = 12


@pytest.mark.parametrize(
    ("rows", "later"),
    [
        ([-1, -1, 0, 0, 2], [3, 4, 5, 6, 7, 8, 9, 10]),
        ([-1, 0, 0], [*range(1, 11)]),
        ([-1, 0, -1], [-1] * 10),
    ],
)
def test_after_the_last_row_the_age_stays(
    tmp_path: Path, rows: list[int], later: list[int]
) -> None:
    link = LinkDelay("link", rows, 12, 1, "rad", 0.1, [7.0])
    fmu = build_links([link], tmp_path)["link"]
    found = outputs(plan_of(fmu, STEPS), {"u": 100.0 + np.arange(STEPS)})
    expected = [7.0 if held < 0 else 100.0 + held for held in [*rows, *later]]
    assert np.ravel(found["y"]).tolist() == expected
