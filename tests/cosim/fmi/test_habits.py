"""FMUs of other tools do what nobody expects: they are run all the same, and nothing is lost."""

from __future__ import annotations

import ctypes as c
from pathlib import Path

import pytest

import cosim
from cosim.base.errors import RunError
from cosim.native import fmu_log, structs
from tests.cosim.fmi.plain import counted, export


def test_an_fmu_that_changes_the_directory_does_not_move_sweeps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    export(Path("wanders.fmu"), counted(), {"CHDIR": None})
    Path("s.toml").write_text(
        '[run]\nstep = 0.1\nstop = 0.2\n[components.m]\nmodel = "wanders.fmu"\n'
        '[metrics.most]\nkind = "final"\nof = ["m.r[1]"]\n'
    )
    Path("study.toml").write_text(
        'scenario = "s.toml"\n[vary.p]\npath = "components.m.parameters.p"\nvalues = [1.0, 2.0]\n'
    )
    for k in range(2):  # the second from where the first has ended
        cosim.run("s.toml", out=f"run{k}")
        assert (tmp_path / f"run{k}" / "trajectories.parquet").is_file()
    cosim.sweep("study.toml", "swept", jobs=1)
    assert [p.name for p in (tmp_path / "swept" / "results").iterdir()] == ["part-00000.parquet"]
    assert {p.name for p in tmp_path.iterdir()} == {
        "wanders.fmu", "s.toml", "study.toml", "run0", "run1", "swept",
    }  # fmt: skip


@pytest.mark.parametrize("isolate", [False, True])
def test_an_fmu_that_logs_with_a_foreign_environment(tmp_path: Path, isolate: bool) -> None:
    """It was a segmentation fault; what is said belongs to the instance of that name."""
    path = export(tmp_path / "says.fmu", counted(), {"FOREIGN_LOG": None})
    names = ("one", "two")
    document = {
        "run": {"step": 0.1, "stop": 0.2},
        "components": {
            name: {"model": str(path), "log": True, "isolate": isolate} for name in names
        },
    }
    cosim.run(document, out=tmp_path / "run")
    said = [
        "[ok] logAll: instantiated with a foreign pointer",
        "[ok] logAll: and with none at all",
        "[warning] logAll: and with NULL",
    ]
    for name in names:
        assert (tmp_path / "run" / f"{name}.fmu.log").read_text().splitlines() == said


def test_what_nobody_is_known_to_have_said_is_dropped() -> None:
    engine = structs.library()
    logs = [fmu_log.log(room=100) for _ in range(2)]
    for log in logs:
        engine.engine_log_open(b"x", c.byref(log))
    foreign = c.create_string_buffer(64)
    engine.engine_log3(foreign, 0, b"a", b"of two")
    engine.engine_log_close(c.byref(logs[0]))
    engine.engine_log3(foreign, 0, b"a", b"of one")
    engine.engine_log_close(c.byref(logs[1]))
    engine.engine_log3(c.c_void_p(c.addressof(logs[1])), 0, b"a", b"after the end")
    assert [log.text() for log in logs] == ["", "[ok] a: of one\n"]


def test_many_logs_open_and_close_in_any_order() -> None:
    engine, n = structs.library(), 500
    logs = list(fmu_log.logs(n))
    order = [(k * 211) % n for k in range(n)]
    for k in order:
        engine.engine_log_open(f"x{k}".encode(), c.byref(logs[k]))
    for k in order[: n // 2 + 30]:
        engine.engine_log_close(c.byref(logs[k]))
    for k in order[:5]:  # which makes room of the closed ones
        engine.engine_log_open(b"again", c.byref(logs[k]))
    for log in logs:
        engine.engine_log3(c.c_void_p(c.addressof(log)), 0, b"", b"text")
    opened = {*order[:5], *order[n // 2 + 30 :]}
    assert {k for k, log in enumerate(logs) if log.count} == opened
    for log in logs:
        engine.engine_log_close(c.byref(log))


@pytest.mark.parametrize("isolate", [False, True])
def test_a_value_that_an_fmu_refuses_ends_the_run(tmp_path: Path, isolate: bool) -> None:
    """Of three calls of the engine with Reals only, the first one fails."""
    path = export(tmp_path / "refuses.fmu", counted(), {"REFUSES": None})
    document = {
        "run": {"step": 0.1, "stop": 1.0},
        "components": {"m": {"model": str(path), "isolate": isolate}},
        "events": [{"at": 0.5, "set": {"m.f[2]": 200.0}}],
    }
    with pytest.raises(RunError, match="setting inputs returned error") as caught:
        cosim.run(document, out=tmp_path / "run")
    assert caught.value.tick == 5
    assert "200 is too much" in str(caught.value)
