"""A continued comparison takes over the results that it has, and its table is the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.base.errors import ScenarioError
from cosim.comparison import measure, report
from cosim.comparison.comparison import compare
from cosim.comparison.kept import KeptResults, OutcomeRow
from cosim.comparison.same_links import KEPT
from cosim.study.runner import UNOBSERVED, Observer
from cosim.study.store import JOURNAL
from tests.cosim.comparison.parts import SMALL, loaded, push, written


class Stopped(Exception):
    """The comparison ends after this many results."""


def stop_after(count: int) -> Observer:
    done: list[str] = []

    def progress(row: OutcomeRow) -> None:
        done.append(row.run)
        if len(done) == count:
            raise Stopped

    return Observer(done=progress)


TEXT = SMALL + push("pushes") + push("fails", fail_at=0.5)


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def results(path: Path, folder: Path, observer=UNOBSERVED, same: str = ""):
    variants, base = loaded(path)
    chosen = variants.select(["all"], (), ())
    with KeptResults(folder, same) as kept:
        found = compare(base, variants, chosen, [0, 1], kept=kept, observer=observer)
    return list(report.write(found, folder, "cosim compare"))


def test_it_goes_on_with_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    for folder in (whole, parts):
        report.claim(folder)
    path = written(tmp_path, TEXT)
    results(path, whole)
    assert JOURNAL not in files(whole)
    with pytest.raises(Stopped):
        results(path, parts, stop_after(4))
    assert {name.partition("/")[0] for name in files(parts)} == {JOURNAL, KEPT}
    with open(parts / JOURNAL, "ab") as file:
        file.write(b'{"run": "torn')  # as a process leaves it that is killed
    with pytest.raises(ScenarioError, match="unfinished comparison; use --resume"):
        report.claim(parts)
    report.claim(parts, resume=True)
    ran = []
    simulate = measure.simulate
    monkeypatch.setattr(
        measure, "simulate", lambda s, f, **k: (ran.append(s), simulate(s, f, **k))[1]
    )
    results(path, parts)
    assert len(ran) == 2  # of six
    assert files(parts) == files(whole)


def test_what_follows_from_something_else_is_run_again(tmp_path: Path) -> None:
    path, folder = written(tmp_path, TEXT), tmp_path / "out"
    report.claim(folder)
    with pytest.raises(Stopped):
        results(path, folder, stop_after(3), same="an FMU")
    assert (folder / JOURNAL).read_bytes().count(b"\n") == 3
    with pytest.raises(Stopped):
        results(path, folder, stop_after(3), same="another one")
    assert (folder / JOURNAL).read_bytes().count(b"\n") == 6
    report.claim(folder, force=True)
    assert not (folder / JOURNAL).exists()
