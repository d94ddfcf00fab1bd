"""How many runs a worker gets at a time."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from math import nan

import pytest

from cosim.base.processes import Pool
from cosim.study.batch import PLACES
from cosim.study.design import Point
from cosim.study.run_point import StudyRow
from cosim.study.tasks import MOST, SECONDS, Tasks
from cosim.study.workers import LEAST


def tasks(count: int, slots: int, least: int = 1, wall: float = nan) -> list[int]:
    """The sizes of all tasks, after one of the first has said how long runs take."""
    made = Tasks((Point(f"{i}", {}, ()) for i in range(count)), count)
    made.use(Pool(ThreadPoolExecutor(), lambda: slots, least))
    sizes = [len(next(made))] if count else []
    if wall == wall:
        made.took([StudyRow("0", {}, (), True, "", nan, wall)])
    sizes += [len(task) for task in made]
    assert sum(sizes) == count
    assert made.left == 0
    return sizes


def test_a_task_takes_half_a_second() -> None:
    assert tasks(10_000, 2, wall=SECONDS / 48)[1] == 48
    assert tasks(10_000, 2, wall=0.0)[1] == MOST
    assert tasks(10_000, 2)[0] == PLACES
    assert set(tasks(100, 2, wall=60.0)[1:]) == {1}


def test_runs_of_a_task_are_made_in_full_groups() -> None:
    """Fewer than fill the places of a worker take as long as these."""
    sizes = tasks(10_000, 2, wall=SECONDS / 51)
    assert sizes[1] == 48 and 48 % PLACES == 0
    assert all(size % PLACES == 0 for size in sizes if size > PLACES)


def test_a_task_on_a_cluster_has_many_runs_until_the_end() -> None:
    sizes = tasks(10_000, 100, LEAST, wall=1.0)
    left = 10_000
    for size in sizes:
        assert size >= LEAST or left < LEAST * 4 * 100
        left -= size


@pytest.mark.parametrize("count", [0, 1, 3, 20])
def test_few_runs_are_shared_by_all(count: int) -> None:
    assert max(tasks(count, 4), default=0) <= max(1, count // 16)


def test_one_at_a_time() -> None:
    made = Tasks([Point(f"{i}", {}, ()) for i in range(5)], 5, alone=True)
    assert [len(task) for task in made] == [1] * 5
