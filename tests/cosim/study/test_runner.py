"""The runner of all studies: cases run here or in processes, once, and are taken up again."""

from __future__ import annotations

import os
import signal
from functools import partial
from pathlib import Path

import pytest

from cosim.base.errors import ScenarioError
from cosim.base.processes import DIED, processes
from cosim.study.run_point import StudyRow
from cosim.study.runner import Observer, PlannedRuns, claim, perform, run_named
from cosim.study.store import Store, rows, write_state


def row(k: int) -> StudyRow:
    """Run `k`: fails if it is odd, and ends its process if it is 4."""
    if k == 4:
        os._exit(3)
    return StudyRow(f"{k}", {"k": k}, (), k % 2 == 0, "odd" if k % 2 else "", wall=0.1)


def died(name: str, why: str) -> StudyRow:
    return StudyRow(name, {"k": int(name)}, (), False, why)


def test_one_process_is_this_one_and_in_order() -> None:
    done, cases = [], [3, 1, 2]
    assert list(perform(done.append, cases, None)) == [(x, None) for x in cases]
    assert done == cases


def test_an_interrupt_comes_when_active_calls_have_ended() -> None:
    done, said = [], []
    with pytest.raises(KeyboardInterrupt):
        for case, result in perform(
            abs, range(-100, 0), partial(processes, 2), lambda: said.append("stopping")
        ):
            assert result == -case
            if not done:
                signal.raise_signal(signal.SIGINT)
            done.append(case)
    assert 1 <= len(done) < 10
    assert said == ["stopping"]


def test_only_missing_runs_are_made_and_failed_ones_with_retry(tmp_path: Path) -> None:
    planned: list[PlannedRuns] = []
    made: list[str] = []
    observer = Observer(planned.append, lambda found: made.append(found.run))
    for count, retry, expected in ((3, False, "012"), (6, False, "345"), (6, True, "1345")):
        made.clear()
        with Store(tmp_path, {}) as store:
            cases = {f"{k}": k for k in range(count)}
            opened = partial(processes, 1)
            run_named(row, cases, store, opened, observer, retry=retry, died=died)
        assert sorted(made) == list(expected)
    assert [(p.found, p.to_run, p.retried) for p in planned] == [(0, 3, 0), (3, 3, 0), (6, 4, 4)]
    reasons = {run: found["reason"] for run, found in rows(tmp_path).items()}
    assert reasons == {"0": "", "1": "odd", "2": "", "3": "odd", "4": DIED, "5": "odd"}


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    assert claim(tmp_path, "soak test", {"seed": 1})
    write_state(tmp_path, {"seed": 1})
    assert not claim(tmp_path, "soak test", {"seed": 1})
    with pytest.raises(ScenarioError, match="another seed, 1; expected 2"):
        claim(tmp_path, "soak test", {"seed": 2})
    other = tmp_path / "other"
    other.mkdir()
    (other / "mine.txt").touch()
    with pytest.raises(ScenarioError, match=r"holds mine\.txt but no soak test"):
        claim(other, "soak test", {})
