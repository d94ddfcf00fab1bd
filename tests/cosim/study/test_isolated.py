"""Isolated FMUs in a study: their process stays for the next point, with a new instance."""

from __future__ import annotations

import gc
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from cosim.base.copies import replace
from cosim.fmi import FmuComponent, FmuOptions
from cosim.fmi.isolation import remote
from cosim.native.structs import MailboxStruct
from cosim.study import batch
from cosim.study.design import Point
from cosim.study.run_point import StudyRow, StudySetup, run_points
from tests.cosim.fmi.exporter import events3, export, nasty2, strict2, strict3, timed3
from tests.cosim.fmi.test_calls import DISCARD, ERROR, FATAL, RETURNS
from tests.fmi.runs import Watch

CRASH, NO_START, GIVEN = 1, 9, "components.x.parameters"
DEFAULTS = {"rate": 0.0, "how": 0, "status": 0, "when": 1e9, "gain": 2.0, "wait": 0.15, "half": 0.0}
EXPORTED = {
    "2.0": strict2(), "3.0": strict3(), "3.0 events": strict3('hasEventMode="true"'),
    "clocks": timed3(), "an interval": events3(),
}  # fmt: skip


class Started(list[remote.RemoteInstance]):
    """The processes that were started; `alive`: how many of them still run."""

    @property
    def alive(self) -> int:
        return sum(one._process.poll() is None for one in self)


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> Iterator[Started]:
    found, init = Started(), remote.RemoteInstance.__init__

    def noted(self: remote.RemoteInstance, *given: object, **more: object) -> None:
        found.append(self)
        init(self, *given, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(remote.RemoteInstance, "__init__", noted)
    yield found
    close()
    assert not found.alive


def close() -> None:
    batch._places.close()


def study(fmu: Path, isolate: bool = True, output: str = "y", **keys: object) -> StudySetup:
    model = {"model": str(fmu), "isolate": isolate, **keys}
    document = {
        "run": {"step": 0.1, "stop": 1.0},
        "components": {"x": model},
        "metrics": {name: {"kind": name, "of": [f"x.{output}"]} for name in ("final", "rms")},
        "figures": {},
    }
    return StudySetup(fmu.parent / "study.toml", document, {})


def points(*each: dict[str, float]) -> list[Point]:
    """All with the same parameters: with others, an FMU is loaded again."""
    names = dict.fromkeys(name for some in each for name in some)
    return [
        Point(f"{i}", {}, tuple(f"{GIVEN}.{n}={some.get(n, DEFAULTS[n])}" for n in names))
        for i, some in enumerate(each)
    ]


def rows(found: Sequence[StudyRow]) -> list[str]:
    return [repr(replace(row, wall=0.0)) for row in found]


@pytest.mark.parametrize("fmi", EXPORTED)
def test_rows_are_those_of_fmus_in_this_process(tmp_path, started, monkeypatch, fmi: str) -> None:
    """One process for all points; each has a new instance, whose calls are those of a run alone."""
    fmu = export(EXPORTED[fmi], tmp_path / "x.fmu")
    name = {"clocks": "wait", "an interval": "half"}.get(fmi, "rate")
    output = {"clocks": "time", "an interval": "integral"}.get(fmi, "y")
    chosen = points({name: 0.25}, {}, {name: 0.5}, {name: 0.25}, {})
    wanted = rows(run_points(study(fmu, False, output), chosen))
    assert not started and not any("reason='" in row and "reason=''" not in row for row in wanted)
    watch = Watch(fmu, tmp_path, monkeypatch)
    watched = study(watch.path, True, output)
    assert rows(run_points(watched, chosen)) == wanted
    assert rows(run_points(watched, chosen)) == wanted
    assert len(started) == started.alive == 1
    assert [call.name for call in watch.calls()].count("FreeInstance") == 10
    assert watch.violations() == []


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
@pytest.mark.parametrize(("status", "processes"), [(DISCARD, 1), (ERROR, 2), (FATAL, 2)])
def test_an_fmu_that_fails_takes_its_process_along(
    tmp_path, started, fmi: str, status: int, processes: int
) -> None:
    """After an error nothing is known of what the next instance would find there."""
    fmu = export(EXPORTED[fmi], tmp_path / "x.fmu")
    fails = {"how": RETURNS, "status": status, "when": 0.5}
    chosen = points({"rate": 1.0}, fails, {"rate": 1.0}, {})
    wanted = rows(run_points(study(fmu, False), chosen))
    found = run_points(study(fmu), chosen)
    assert rows(found) == wanted
    assert [bool(row.reason) for row in found] == [False, True, False, False]
    assert found[0].measures == found[2].measures != found[3].measures
    assert len(started) == processes and started.alive == 1


def test_a_crash_is_of_one_point(tmp_path, started) -> None:
    fmu = export(nasty2(), tmp_path / "x.fmu")
    crash = {"how": CRASH, "when": 0.5}
    found = run_points(study(fmu, output="up"), points({}, crash, {}, {"how": NO_START}, {}, crash))
    reasons = ["", "ended in doStep: SIG", "", "in enter_initialization: SIGABRT", "", "SIG"]
    for row, reason in zip(found, reasons, strict=True):
        assert reason in row.reason and bool(reason) == bool(row.reason)
    assert found[0].measures == found[2].measures == found[4].measures
    assert len(started) == 3


@pytest.mark.parametrize("one", ["the FMU", "memory"])
def test_a_process_that_may_have_one_instance_has_one(tmp_path, started, one: str) -> None:
    flag = 'canBeInstantiatedOnlyOncePerProcess="true"' if one == "the FMU" else ""
    fmu = export(strict2(flag), tmp_path / "x.fmu")
    given = {"memory": 500} if one == "memory" else {}
    found = run_points(study(fmu, **given), points({"rate": 0.5}, {}, {"rate": 0.5}))
    assert found[0].measures == found[2].measures != found[1].measures
    assert len(started) == 3 and not started.alive


def test_a_process_that_was_told_to_hurry_ends(tmp_path, started) -> None:
    fmu = FmuComponent(export(strict2(), tmp_path / "x.fmu"), options=FmuOptions(isolate=True))
    fmu.stays = True
    fmu.initialize({})
    fmu.close()
    fmu.initialize({})
    assert len(started) == started.alive == 1
    MailboxStruct.from_address(started[0]._end.box).stop = 1
    fmu.close()
    assert not started.alive


def test_another_component_gets_another_process(tmp_path, started) -> None:
    """That of the component before ends; so do all with the thread that had them."""
    fmu = export(strict2(), tmp_path / "x.fmu")
    alive = []

    def work() -> None:
        settings = ["run.seed=1", "run.seed=2", "components.x.timeout=50.0", "run.seed=3"]
        for i, setting in enumerate(settings):
            found = run_points(study(fmu), [Point(f"{i}", {}, (setting,))])
            alive.append((found[0].reason, len(started), started.alive))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    gc.collect()
    assert alive == [("", 1, 1), ("", 1, 1), ("", 2, 1), ("", 3, 1)]
    assert not started.alive
