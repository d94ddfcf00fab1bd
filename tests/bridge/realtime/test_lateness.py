"""The report of a journal's times: exact on known values, and drawn."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.realtime.lateness import Lateness, Spread, draw, journal_lateness, lateness
from cosim.base.errors import CosimError, RunError

MS = 1_000_000


def report(late: list[int], period: int = MS) -> Lateness:
    deadline = 10**15 + period * np.arange(len(late))
    woke = deadline + np.array(late, np.int64)
    return lateness(
        deadline, woke, period, received=woke + 10, stepped=woke + 30, sent=woke + 60
    )  # fmt: skip


def test_known_values() -> None:
    late = [7_000] * 989 + [40_000] * 10 + [2 * MS]
    found = report(late)
    assert (found.late.count, found.late.minimum, found.late.maximum) == (1000, 7_000, 2 * MS)
    assert (found.late.p50, found.late.p99, found.late.p999) == (7_000, 40_000, 40_000)
    assert found.late.mean == pytest.approx(np.mean(late))
    assert found.missed == 1
    assert found.ratio == pytest.approx(0.04)
    assert found.bins == ((7_000, 989), (40_000, 10), (2_000_000, 1))
    assert {name: spread.maximum for name, spread in found.parts.items()} == {
        "receive": 10, "step": 20, "send": 30,
    }  # fmt: skip
    assert found.period is not None
    assert found.period.mean == pytest.approx(MS + (2 * MS - 7_000) / 999)


@given(st.lists(st.integers(-MS, 10**10), min_size=1, max_size=200))
def test_against_numpy_and_nothing_is_lost(late: list[int]) -> None:
    found = report(late)
    for q, value in ((0.5, found.late.p50), (0.99, found.late.p99), (0.999, found.late.p999)):
        assert value == np.quantile(late, q, method="inverted_cdf")
    assert sum(n for _, n in found.bins) == len(late)
    assert found.missed == sum(x >= MS for x in late)
    drawn = [line.split() for line in found.histogram().splitlines()]
    assert sum(int(line[2]) for line in drawn) == len(late)


def test_a_slot_late_by_a_period_is_missed() -> None:
    assert report([MS]).missed == 1
    found = report([MS - 1])
    assert (found.missed, found.period) == (0, None)
    assert "1 slots, 0 missed (0 %)" in found.text()


def test_parts_that_were_not_kept_are_left_out() -> None:
    found = lateness([0, 10], [1, 11], 10, received=[2, 12])
    assert list(found.parts) == ["receive"]
    assert found.rows()[1][0] == "lateness"
    assert len(found.rows()) == 5


def test_a_stall_counts_once_beside_every_slot_that_it_made_late() -> None:
    stall = [4_900_000, 3_900_000, 2_900_000, 1_900_000, 900_000]  # slots caught up after 4.9 ms
    found = report([10_000] * 5 + stall + [10_000] * 5)
    assert found.late.count == 15
    assert found.once.count == 11
    assert (found.once.maximum, found.once.p50) == (4_900_000, 10_000)
    assert found.text().splitlines()[2].split()[:3] == ["each", "stall", "once"]


def test_a_journal_says_what_sending_took() -> None:
    names = ("deadline_ns", "woke_ns", "received_ns", "done_ns", "send_ns")
    rows = np.zeros(3, np.dtype([(name, "<i8") for name in names]))
    rows["deadline_ns"] = 100 * np.arange(3)
    rows["woke_ns"] = rows["deadline_ns"] + 7
    rows["received_ns"] = rows["woke_ns"] + 10
    rows["done_ns"] = rows["received_ns"] + 25
    rows["send_ns"] = 5
    found = journal_lateness(rows, 100)
    assert (found.late.p50, found.missed) == (7, 0)
    assert {k: v.p50 for k, v in found.parts.items()} == {"receive": 10, "step": 20, "send": 5}


def test_text_and_json() -> None:
    found = report([5_000] * 50 + [120_000])
    lines = found.text().splitlines()
    assert len({len(line) for line in lines[:-1]}) == 1
    assert "period (1000 nominal)" in lines[3]
    kept = json.loads(json.dumps(found.facts()))
    assert kept["late"]["p50"] == 5_000
    assert kept["bins"] == [[5_000, 50], [120_000, 1]]
    assert found.histogram().splitlines()[0].startswith("        5 us        50 ####")


@pytest.mark.parametrize(
    ("deadline", "woke", "period"),
    [([], [], MS), ([0], [0, 1], MS), ([0], [0], 0), ([[0]], [[0]], MS)],
)
def test_what_cannot_be_is_refused(deadline: object, woke: object, period: int) -> None:
    with pytest.raises(CosimError, match=r"lateness: found .*expected"):
        lateness(deadline, woke, period)  # type: ignore[arg-type]


def test_spread_of_one() -> None:
    assert Spread.of([3]) == Spread(1, 3, 3.0, 0.0, 3, 3, 3, 3)


@pytest.mark.parametrize("worst", [90_000, 10**12])
def test_a_figure(tmp_path: Path, worst: int) -> None:
    reports = {"one": report([20_000] * 100 + [worst]), "two": report([-5, 0, 31_000])}
    assert draw(reports, tmp_path / "late.png").read_bytes()[:4] == b"\x89PNG"


def test_a_figure_that_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(CosimError, match="no reports"):
        draw({}, tmp_path / "late.png")
    with pytest.raises(RunError, match=r"late\.png"):
        draw({"one": report([0])}, tmp_path / "missing" / "late.png")
