"""FMUs of other tools do what nobody expects: they are run all the same, and nothing is lost."""

from __future__ import annotations

import ctypes as c
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import fmpy
import pytest

import cosim
from cosim.base.errors import RunError
from cosim.checks.preflight import check
from cosim.loading.files import load
from cosim.native import fmu_log, shared
from cosim.record import Run
from cosim.scenario.assemble import assemble
from fmus.build.toolchain import compile_object, compile_shared, link_shared
from tests.cosim.fmi.exporter import strict3
from tests.cosim.fmi.plain import SOURCE, P, U, Y, counted, described, export, real


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


#: Two logs of one name, in a process that has no others: those of earlier tests may be open here.
TWO_LOGS = """
import ctypes as c
from cosim.native import fmu_log, shared
engine = shared.library()
logs = [fmu_log.log(room=100) for _ in range(2)]
for log in logs:
    engine.engine_log_open(b"x", c.byref(log))
foreign = c.create_string_buffer(64)
engine.engine_log3(foreign, 0, b"a", b"of two")
engine.engine_log_close(c.byref(logs[0]))
engine.engine_log3(foreign, 0, b"a", b"of one")
engine.engine_log_close(c.byref(logs[1]))
engine.engine_log3(c.c_void_p(c.addressof(logs[1])), 0, b"a", b"after the end")
print([log.text() for log in logs])
"""


def test_what_nobody_is_known_to_have_said_is_dropped() -> None:
    done = subprocess.run([sys.executable, "-c", TWO_LOGS], capture_output=True, text=True)
    assert (done.stdout.strip(), done.stderr) == (str(["", "[ok] a: of one\n"]), "")


def test_many_logs_open_and_close_in_any_order() -> None:
    engine, n = shared.library(), 500
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


# ---- descriptions --------------------------------------------------------------------------------


def ran(path: Path, folder: Path, **component: Any) -> Run:
    """A run of one FMU, called m, over two steps of 0.1 s."""
    document = {
        "run": {"step": 0.1, "stop": 0.2},
        "components": {"m": {"model": str(path), **component}},
    }
    cosim.run(document, out=folder / "run")
    return Run.open(folder / "run")


def theirs(path: Path, name: str, **start: float) -> float:
    """The last value of a variable by FMPy."""
    found = fmpy.simulate_fmu(
        str(path), stop_time=0.2, step_size=0.1, output_interval=0.1, start_values=start,
        output=[name], validate=False,
    )  # fmt: skip
    return float(found[name][-1])


PLAIN = (real("u", U, "input", "2"), real("p", P, "parameter", "3"), real("y", Y, "output"))


def warnings(path: Path) -> list[str]:
    """What the check before a run says of an FMU."""
    loaded = load(path, ["run.stop=0.2", "run.step=0.1"])
    return [f.reason for f in check(loaded, assemble(loaded)) if f.rule == "ignored"]


@pytest.mark.parametrize(
    "how",
    [
        {"identifier": "plain-2.0 x"},
        {"identifier": "2plain"},
        {"token": 'guid=""'},
        {"token": ""},
        {"experiment": '<DefaultExperiment startTime="0" stopTime="INF" stepSize="0.1"/>'},
        {"experiment": '<DefaultExperiment stopTime="0" stepSize="0" tolerance="0"/>'},
    ],
)
def test_descriptions_of_other_tools_are_read(tmp_path: Path, how: dict[str, str]) -> None:
    path = export(tmp_path / "x.fmu", described(PLAIN, **how), {"ANY_TOKEN": ""} if "token" in how
                  else None)  # fmt: skip
    run = ran(path, tmp_path, parameters={"p": 5})
    assert run.column("m.y")[-1] == 7.0
    if how.get("token") != "":  # which FMPy takes for a mistake of its own
        assert theirs(path, "y", p=5, u=2) == 7.0
    loaded = load(path, ["run.stop=0.1"])
    assert loaded.run.step > 0
    assert warnings(path) == []


def test_a_name_that_is_there_twice_is_the_first(tmp_path: Path) -> None:
    twice = (*PLAIN, real("y", Y + 1, "output"), real("z", Y + 2, "output"))
    path = export(tmp_path / "twice.fmu", described(twice))
    assert ran(path, tmp_path, parameters={"p": 5}).column("m.y")[-1] == 7.0
    (said,) = warnings(path)
    assert "'y' is declared twice: that of value reference 32 is used, that of 33 is not" in said


@pytest.mark.parametrize("start", ["NaN", "INF"])
def test_a_start_that_is_no_number_is_none(tmp_path: Path, start: str) -> None:
    path = export(tmp_path / "nan.fmu", described((*PLAIN, real("q", P + 1, "parameter", start))))
    assert ran(path, tmp_path, parameters={"p": 5}).column("m.y")[-1] == 7.0
    assert ran(path, tmp_path / "set", parameters={"q": 5}).column("m.y")[-1] == 2.0
    (said,) = warnings(path)
    assert f"'q' has the start '{start}'" in said


# ---- libraries and sources -----------------------------------------------------------------------


def test_a_library_beside_the_binary_of_an_fmu_with_one_instance(tmp_path: Path) -> None:
    """It gets its own copy, which must find what it is linked with: RUNPATH $ORIGIN."""
    beside = tmp_path / "libbeside.so"
    (tmp_path / "beside.c").write_text(
        '__attribute__((visibility("default"))) double beside(double x) { return x + 100.0; }'
    )
    compile_shared([tmp_path / "beside.c"], beside)
    main = tmp_path / "plain2.so"
    origin = ("-Wl,--no-as-needed", "-Wl,-rpath,$ORIGIN", f"-L{tmp_path}", "-lbeside")
    objects = [compile_object(SOURCE, tmp_path / "plain2.o", flags=("-DBESIDE",))]
    link_shared(objects, main, flags=origin)
    beside_name = "binaries/linux64/libbeside.so"
    text = described(PLAIN, attributes='canBeInstantiatedOnlyOncePerProcess="true"')
    files = {"binaries/linux64/plain2.so": main.read_bytes(), beside_name: beside.read_bytes()}
    path = export(tmp_path / "beside.fmu", text, files=files)
    beside.unlink()
    document = {
        "run": {"step": 0.1, "stop": 0.2},
        "components": {n: {"model": str(path), "parameters": {"p": 5}} for n in ("a", "b")},
    }
    cosim.run(document, out=tmp_path / "run")
    run = Run.open(tmp_path / "run")
    assert [run.column(f"{n}.y")[-1] for n in "ab"] == [107.0, 107.0]
    assert theirs(path, "y", p=5, u=2) == 107.0


STANDARD = """
#include "fmi2Functions.h"
#ifndef FMI2_FUNCTION_PREFIX
#error "no prefix"
#endif
static const char *const version_of_types = fmi2TypesPlatform;
const char *kept(void) { return version_of_types; }
"""


@pytest.mark.parametrize("prefix", ["", "#define FMI2_FUNCTION_PREFIX plain2_\n"])
@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange"])
def test_sources_of_fmi_2(tmp_path: Path, prefix: str, interface: str) -> None:
    """With the standard's headers, which they need not bring, and with a prefix of their own."""
    inside = '<SourceFiles><File name="plain2.c"/><File name="standard.c"/></SourceFiles>'
    listed = {"inside": inside} if interface == "CoSimulation" else {}
    text = described(PLAIN, **listed)
    if not listed:
        text = text.replace("<ModelVariables>", f'<ModelExchange modelIdentifier="plain2">{inside}'
                            "</ModelExchange><ModelVariables>")  # fmt: skip
    path = tmp_path / "sources.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.writestr("sources/plain2.c", prefix + SOURCE.read_text())
        archive.writestr("sources/standard.c", STANDARD)
    run = ran(path, tmp_path, build=True, parameters={"p": 5})
    assert run.column("m.y")[-1] == 7.0
    assert ran(path, tmp_path / "again", build=True).column("m.y")[-1] == 2.0


def test_sources_of_fmi_3_that_are_included_by_others(tmp_path: Path) -> None:
    """With the standard's header; nothing is listed, and one file is part of another."""
    path = tmp_path / "sources.fmu"
    header = '#include "fmi3Functions.h"\nfmi3Float64 kept(void) { return 1.0; }\n'
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", strict3())
        archive.writestr("sources/template.c", (SOURCE.parent / "strict3.c").read_text())
        archive.writestr("sources/strict3.c", '#include "template.c"\n')
        archive.writestr("sources/header.c", header)
    run = ran(path, tmp_path, build=True, parameters={"gain": 5}, start={"x": 7})
    assert run.column("m.y")[0] == 7.0
