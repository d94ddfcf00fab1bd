"""A network that cosim falsify has found breaks the same requirement wherever the scenario runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.base import toml
from cosim.falsify.scenario_text import text

ROOT = Path(__file__).resolve().parents[3]
ZENOH = str(ROOT / "configs" / "deploy" / "zenoh.toml")
#: Segments that keep the arms of the shipped teleoperation apart: (from, to, delay), s, both ways.
THERE = [(0.5, 1.5, 0.3), (2.4, 3.4, 1.2), (8.4, 9.2, 1.2), (9.4, 10.6, 0.3)]
BACK = [(0.5, 13.5, 1.2)]


@pytest.fixture
def failing(tmp_path: Path) -> Path:
    """The scenario with these delays, as it is written into the folder of a search."""
    document = toml.read(ROOT / "configs" / "teleoperation.toml")
    document["run"]["stop"] = "7 s"
    for link, segments in zip(document["links"], (THERE, BACK), strict=True):
        keys = [{"from": a, "to": b, "delay": T} for a, b, T in segments]
        link["delay"] = {"law": "segments", "delay": "750 ms", "segments": keys}
    document["require"] = {
        "settled": {"always": "abs(master.q - slave.q) < 0.05 rad", "after": "6 s"}
    }
    path = tmp_path / "failing.toml"
    path.write_text(text(document))
    return path


def test_offline_and_in_the_twin(failing, cosim_run, twin):
    """The twin over Zenoh: its network takes no time, and every link has its delay."""
    runs = [cosim_run(failing, set={"run.seed": 0}), twin(failing, ZENOH, set={"run.seed": 0})]
    found = [run.requirements["settled"] for run in runs]
    assert [x.verdict for x in found] == ["failed", "failed"]
    assert found[0].value == pytest.approx(found[1].value, rel=1e-3)


@pytest.mark.slow
def test_in_lock_step_with_the_bits_of_the_twin(failing, twin, rehearsal):
    one = twin(failing, ZENOH, set={"run.seed": 0})
    two = rehearsal(failing, ZENOH, set={"run.seed": 0})
    assert two.is_identical_to(one)
    assert not two.passes("settled")


@pytest.mark.slow
def test_in_a_rehearsal_on_the_wall_clock(failing, rehearsal):
    run = rehearsal(failing, ZENOH, set={"run.seed": 0}, clock="wall")
    assert not run.passes("settled")
