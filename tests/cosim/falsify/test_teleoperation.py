"""The teleoperation on links of 0.3 to 1.2 s: what breaks it, and a law that nothing breaks."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from benchmarks.falsify_cases import Document, settling, waves
from cosim.base.processes import processes
from cosim.falsify.execute import Falsification, falsify
from cosim.falsify.scenario_text import text
from cosim.falsify.search import Budget

pytestmark = pytest.mark.slow


def searched(document: Document, folder: Path, runs: int) -> Falsification:
    (folder / "case.toml").write_text(text(document))
    budget = Budget(runs)
    return falsify(folder / "case.toml", (), folder / "out", partial(processes, 2), budget)


def test_the_readmes_hand_does_not_settle_in_time_on_a_few_segments(tmp_path: Path) -> None:
    """All constant delays settle by 13 s."""
    state = searched(settling(), tmp_path, 4000)
    assert state.found is not None and state.found.family != "constant"
    assert state.account.runs["constant"] == 400
    assert state.shrinking is not None and len(state.shrinking.now.pieces) <= 5


@pytest.mark.parametrize(("name", "breaks"), [("wave", True), ("wave-integral", False)])
def test_waves_drift_apart_and_their_integrals_do_not(
    name: str, breaks: bool, tmp_path: Path
) -> None:
    """Position is the integral of what arrives: lost and repeated waves stay in it."""
    state = searched(waves(name), tmp_path, 4000 if breaks else 1200)
    assert (state.found is not None) == breaks
    if state.shrinking is not None:
        assert len(state.shrinking.now.pieces) <= 3 and state.shrinking.failing >= 20
