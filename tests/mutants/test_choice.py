"""Tests that execute the changed block are asked first, and no more of them than fit the budget."""

from __future__ import annotations

from pathlib import Path

from tests.mutants.blocks import Block
from tests.mutants.changes import Mutant
from tests.mutants.choice import Choice
from tests.mutants.trial import Outcome

C, PY = Path("a.c"), Path("a.py")
BLOCKS = [Block(C, 10, 20, 0), Block(C, 0, 30, 1), Block(Path("b.c"), 0, 30, 2)]
INNER, OUTER = Mutant(C, 15, " < ", " <= "), Mutant(C, 5, " < ", " <= ")
MEASURED = {
    "near.py": Outcome(
        seconds={"near.py::a": (1.0, 1.0), "near.py::b": (1.0, 0.5), "near.py::c": (1.0, 0.1)},
        executed={"near.py::a": [0, 1], "near.py::b": [1]},
    ),
    "far.py": Outcome(
        seconds={"far.py::a": (0.1, 0.1), "far.py::late": (9.0, 0.1), "far.py::slow": (9.0, 9.0)},
        executed={"far.py::a": [1, 2], "far.py::late": [1], "far.py::slow": [1]},
    ),
    "other.py": Outcome(
        failures=["other.py::a"],
        seconds={"other.py::a": (0.1, 0.1), "other.py::b": (0.1, 0.1)},
        executed={"": [2]},
    ),
}


def test_only_the_files_that_execute_the_block_are_asked() -> None:
    choice = Choice(MEASURED, BLOCKS, 60)
    assert choice.tests(INNER) == (["near.py::a", "near.py::c", "near.py::b"], 3)
    assert choice.tests(OUTER)[0][:4] == ["far.py::a", "far.py::late", "near.py::b", "near.py::a"]
    assert list(choice.rounds(OUTER, choice.tests(OUTER)[0])) == [["near.py", "far.py"]]


def test_every_test_is_asked_about_what_is_in_no_block() -> None:
    choice = Choice(MEASURED, BLOCKS, 60)
    assert (
        choice.tests(Mutant(PY, 5, " < ", " <= "))[1] == 6
    )  # without the slow and the failing one
    assert "takes too long: far.py::slow" in choice.said()
    assert "fails without a change: other.py::a" in choice.said()


def test_the_budget_limits_the_tests() -> None:
    assert Choice(MEASURED, BLOCKS, 1.2).tests(INNER) == (["near.py::a", "near.py::c"], 3)
    assert Choice(MEASURED, BLOCKS, 0.1).tests(INNER) == (["near.py::a"], 3)


def test_a_test_that_noticed_a_change_of_the_source_comes_first() -> None:
    choice = Choice(MEASURED, BLOCKS, 60)
    for test in ("far.py::late", "near.py::a", "near.py::a"):
        choice.noticed(C, test)
    choice.noticed(PY, "near.py::b")
    assert choice.tests(OUTER)[0][:3] == ["near.py::a", "far.py::late", "far.py::a"]


def test_a_test_that_waits_for_the_clock_is_known() -> None:
    choice = Choice(MEASURED, BLOCKS, 60)
    assert choice.waits("far.py::late")
    assert not choice.waits("far.py::slow")
    assert choice.waits("collection")


def test_tests_whose_blocks_are_unknown_are_asked() -> None:
    unknown = {"x.py": Outcome(seconds={"x.py::a": (0.1, 0.1)})}
    assert Choice(MEASURED | unknown, BLOCKS, 60).tests(INNER)[0][0] == "x.py::a"


def test_tests_in_the_folder_that_mirrors_the_source_s_come_first() -> None:
    known = {
        f"tests/{room}/test_{n}.py": Outcome(seconds={f"tests/{room}/test_{n}.py::a": (cpu, cpu)})
        for n, (room, cpu) in enumerate([("far", 0.1)] * 3 + [("near", 0.9)])
    }
    asked, _ = Choice(known, [], 1.1).tests(Mutant(Path("near/a.py"), 5, " < ", " <= "))
    assert asked == [f"tests/{file}.py::a" for file in ("far/test_0", "far/test_1", "near/test_3")]
