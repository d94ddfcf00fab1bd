"""Parts of a search: their candidates are those of one call, and so is what is made of them."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest

from cosim.falsify.scenario_text import text
from cosim.study.store import read_journal
from tests.cli.command import Command
from tests.cosim.falsify.plants import integrator

FILES = ("falsify.json", "failing.toml", "netem.sh", "test_failing.py")


def loop(folder: Path, a: float, families: tuple[str, ...] = ()) -> Path:
    """A loop that no constant delay breaks; breaks with others if `a` is large enough."""
    path = folder / "loop.toml"
    tables = {"falsify": {"families": list(families)}} if families else {}
    path.write_text(text({**integrator(a, 8, 120.0), **tables}))
    return path


def results(folder: str) -> dict[str, bytes]:
    return {name: p.read_bytes() for name in FILES if (p := Path(folder, name)).exists()}


@pytest.mark.parametrize(
    ("a", "families", "code"),
    [
        (0.1, (), 0),
        (0.3, (), 1),
        (0.3, ("optimizer", "draw"), 1),
        (0.4, (), 1),  # the nominal network breaks it
    ],
)
def test_parts_in_any_order_give_the_result_of_one_call(
    a: float, families: tuple[str, ...], code: int, cosim: Command, tmp_path: Path
) -> None:
    call = ("falsify", loop(tmp_path, a, families), "--runs", "200", "--jobs", "1", "--seed", "3")
    assert cosim(*call).code == code
    whole = results("runs/loop-falsified")
    whole_keys = set(read_journal(Path("runs/loop-falsified/journal.jsonl")))
    Path("runs/loop-falsified").rename("whole")
    order = list(range(1, 6))
    random.Random(1).shuffle(order)
    for k in order:
        done = cosim(*call, "--part", f"{k}/5")
        assert done.code == 0, done.err
    folders = sorted(Path("runs/loop-falsified.parts").iterdir())
    done = cosim(*call, "--merge", *folders)
    assert done.code == code, done.err
    assert results("runs/loop-falsified") == whole
    if code == 0:  # but for the nominal one, few are in two parts, as families share some
        found = [set(read_journal(f / "journal.jsonl")) for f in folders]
        every = set().union(*found)
        assert sum(len(x) - 1 for x in found) < 1.1 * len(every)
        assert every < whole_keys and len(whole_keys - every) <= 64  # two generations


def test_a_part_that_was_killed_or_is_missing_changes_nothing(
    cosim: Command, tmp_path: Path
) -> None:
    call = ("falsify", loop(tmp_path, 0.1), "--runs", "300", "--jobs", "1")
    assert cosim(*call).code == 0
    whole = results("runs/loop-falsified")
    Path("runs/loop-falsified").rename("whole")
    for k in (1, 2):
        assert cosim(*call, "--part", f"{k}/3").code == 0
    first, second = sorted(Path("runs/loop-falsified.parts").iterdir())
    journal = first / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[:9]) + b'{"run": "torn')
    done = cosim(*call, "--merge", first, second)
    assert done.code == 0
    assert "part 3/3 not found; the candidates were run now" in done.err
    assert results("runs/loop-falsified") == whole
    assert cosim(*call, "--part", "1/3").code == 0  # continues
    assert len(read_journal(journal)) == len(lines)


def test_a_part_stops_after_the_round_in_which_one_of_its_own_fails(
    cosim: Command, tmp_path: Path
) -> None:
    call = ("falsify", loop(tmp_path, 0.3), "--runs", "2000", "--jobs", "1")
    done = cosim(*call, "--part", "1/2")
    assert done.code == 0 and "has one that fails" in done.out
    assert len(read_journal(Path("runs/loop-falsified.parts/1-of-2/journal.jsonl"))) < 500


def test_what_does_not_fit_together_is_refused(cosim: Command, tmp_path: Path) -> None:
    call = ("falsify", loop(tmp_path, 0.1), "--jobs", "1")
    for given in (("--part", "1/2"), ("--merge", "a")):
        said = cosim.refused(*call, "--time", "5 s", *given)
        assert "found --time with parts" in said and said.endswith("expected --runs")
    assert cosim(*call, "--runs", "60", "--part", "1/2").code == 0
    (part,) = Path("runs/loop-falsified.parts").iterdir()
    merged = (*call, "--merge", part, "--out", "out", "--runs")
    assert "whose runs is 60, expected 50" in cosim.refused(*merged, "50")
    assert "whose seed is 0, expected 1" in cosim.refused(*merged, "60", "--seed", "1")
    said = cosim.refused(*call, "--runs", "60", "--part", "2/2", "--out", part)
    assert "the folder contains part 1 of 2, expected part 2 of 2" in said
    said = cosim.refused(*call, "--runs", "60", "--out", part)
    assert "the folder contains part 1 of 2, expected all runs" in said
    assert not Path("out").exists()
    assert json.loads((part / "sweep.json").read_text())["part"] == [1, 2]
