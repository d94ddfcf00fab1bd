"""Entries of arrays of FMI 2.0 are called as the FMU calls them, also where it counts from 1.

FMPy, which knows scalars only, says which variable has which value.
"""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

import cosim
from cosim.base.errors import CosimError
from cosim.checks.preflight import check
from cosim.engine.simulate import simulate
from cosim.fitting.varied import varied
from cosim.linear.scenario import linearized
from cosim.loading.files import load
from cosim.measure.declared_metrics import metrics
from cosim.measure.metrics import evaluate
from cosim.record import Run
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario, build
from cosim.ssp.export import write
from tests.cosim.fmi.plain import P, U, Y, counted, described, export, real

BASES = pytest.mark.parametrize("base", [0, 1])


def fmu(folder: Path, base: int) -> Path:
    return export(folder / "plain.fmu", counted(base))


def scenario(folder: Path, base: int, /, **m: Any) -> Scenario:
    """The FMU m fed by k, which is another instance; f of k starts at 10, 20, 30."""
    path = str(fmu(folder, base))
    document: dict[str, Any] = {
        "run": m.pop("run", {}) | {"step": 0.1, "stop": 0.5},
        "components": {
            "k": {"model": path, "start": {"f": [10, 20, 30]}},
            "m": {"model": path, **m},
        },
    }
    document |= {key: m.pop(key) for key in ("events", "metrics") if key in m}
    for key in ("events", "metrics"):
        document["components"]["m"].pop(key, None)
    return build(document, folder / "scenario.toml")


def ran(given: Scenario, folder: Path) -> Run:
    return Run.open(simulate(given, folder / "run").folder)


def last(run: Run, name: str = "m") -> list[float]:
    """The last value of each of the FMU's own outputs r."""
    return [float(run.column(n)[-1]) for n in run.names if n.startswith(f"{name}.r[")]


@BASES
def test_results_have_the_names_of_the_fmu_and_its_values(tmp_path: Path, base: int) -> None:
    values = {f"p[{base + i}]": float(i + 1) for i in range(3)}
    run = ran(scenario(tmp_path, base, parameters=values), tmp_path)
    names = [f"r[{base + i}]" for i in range(3)]
    theirs = fmpy.simulate_fmu(
        str(tmp_path / "plain.fmu"), stop_time=0.5, start_values=values, output=names
    )
    assert [n for n in run.names if n.startswith("m.r")] == [f"m.{n}" for n in names]
    for name in names:
        assert run.column(f"m.{name}")[-1] == theirs[name][-1]
    assert last(run) == [1.0, 2.0, 3.0]


@BASES
def test_a_wire_of_an_entry_goes_where_its_name_says(tmp_path: Path, base: int) -> None:
    inputs = {f"f[{base}]": f"k.r[{base + 2}]", f"f[{base + 2}]": f"k.r[{base}]"}
    run = ran(scenario(tmp_path, base, inputs=inputs), tmp_path)
    assert last(run, "k") == [10.0, 20.0, 30.0]
    assert last(run) == [30.0, 0.0, 10.0]


@pytest.mark.parametrize(("base", "wrong"), [(0, 3), (1, 0), (1, 4)])
def test_an_entry_that_the_fmu_has_not_is_refused(tmp_path: Path, base: int, wrong: int) -> None:
    there = rf"m\.f\[{base}\] to m\.f\[{base + 2}\]"
    with pytest.raises(CosimError, match=there):
        assemble(scenario(tmp_path, base, inputs={f"f[{wrong}]": "k.now"}))
    for table in ("parameters", "start"):
        with pytest.raises(CosimError, match=f"no entry of f 'f\\[{wrong}\\]'"):
            assemble(scenario(tmp_path, base, **{table: {f"f[{wrong}]": 1.0}}))


@BASES
def test_values_of_entries_and_of_whole_arrays(tmp_path: Path, base: int) -> None:
    given = {"p": [1.0, 2.0, 3.0], f"p[{base + 1}]": 7.0}
    run = ran(scenario(tmp_path, base, parameters=given, start={f"f[{base + 2}]": 0.5}), tmp_path)
    assert last(run) == [1.0, 7.0, 3.5]


@BASES
def test_set_on_the_command_line_and_in_python(tmp_path: Path, base: int) -> None:
    path = fmu(tmp_path, base)
    lone = load(path, [f"p[{base}]=4", f"f[{base + 1}]=5", "run.stop=0.1", "run.step=0.1"])
    assert last(ran(lone, tmp_path), "plain2") == [4.0, 5.0, 0.0]
    document = {
        "run": {"step": 0.1, "stop": 0.1},
        "components": {"m": {"model": str(path), "inputs": {}}},
    }
    done = cosim.run(
        document, set={f"components.m.parameters.p[{base}]": 4.0}, out=tmp_path / "api"
    )
    assert done[f"m.r[{base}]"][-1] == 4.0


@BASES
def test_record_and_patterns(tmp_path: Path, base: int) -> None:
    one, two = f"m.r[{base}]", f"m.r[{base + 1}]"
    for wanted, names in (
        ([one], {one}),
        ([f"m.p[{base}]"], {f"m.p[{base}]"}),
        ([f"*.r[{base + 1}]"], {two, two.replace("m", "k")}),
        ([one, "m.r"], {f"m.r[{base + i}]" for i in range(3)}),
    ):
        given = scenario(tmp_path, base, run={"record": {"signals": wanted}})
        run = Run.open(simulate(given, tmp_path / "run", force=True).folder)
        assert set(run.names) == names
    with pytest.raises(CosimError, match="no signal"):
        ran(scenario(tmp_path, base, run={"record": {"signals": ["m.r[9]"]}}), tmp_path)


@BASES
def test_events_and_metrics(tmp_path: Path, base: int) -> None:
    given = scenario(
        tmp_path, base,
        events=[{"at": 0.2, "set": {f"m.f[{base + 1}]": 5.0}}],
        metrics={"most": {"kind": "peak", "of": [f"m.r[{base + 1}]"]}},
    )  # fmt: skip
    run = ran(given, tmp_path)
    assert last(run) == [0.0, 5.0, 0.0]
    assert [m.value for m in evaluate(metrics(given), run)] == [5.0]


@BASES
def test_tables_by_the_names_of_their_columns(tmp_path: Path, base: int) -> None:
    path, table = fmu(tmp_path, base), tmp_path / "u.csv"
    names = [f"f[{base + i}]" for i in range(3)]
    table.write_text(f"t,{','.join(names)}\n0,1,2,3\n1,1,2,3\n")
    stop = ["run.stop=0.1", "run.step=0.1"]
    assert last(ran(load(path, stop, table), tmp_path), "plain2") == [1.0, 2.0, 3.0]
    table.write_text(f"t,{names[1]}\n0,7\n1,7\n")
    run = Run.open(simulate(load(path, stop, table), tmp_path / "one").folder)
    assert last(run, "plain2") == [0.0, 7.0, 0.0]
    wired = scenario(tmp_path, base, inputs={names[1]: {"table": "u.csv"}})
    assert last(Run.open(simulate(wired, tmp_path / "two").folder)) == [0.0, 7.0, 0.0]


def test_a_table_that_counts_otherwise_is_refused(tmp_path: Path) -> None:
    (tmp_path / "u.csv").write_text("t,f[0],f[1],f[2]\n0,1,2,3\n1,1,2,3\n")
    with pytest.raises(CosimError, match=r"f has an entry \[0\]; expected entries from \[1\] on"):
        assemble(scenario(tmp_path, 1, inputs={"f": {"table": "u.csv"}}))


@BASES
def test_export_and_import_of_an_ssp(tmp_path: Path, base: int) -> None:
    inputs = {f"f[{base}]": f"k.r[{base + 2}]", f"f[{base + 2}]": f"k.r[{base}]"}
    given = scenario(tmp_path, base, inputs=inputs, parameters={f"p[{base + 1}]": 5.0})
    write(given, assemble(given), tmp_path / "x.ssp")
    with zipfile.ZipFile(tmp_path / "x.ssp") as archive:
        text = archive.read("SystemStructure.ssd").decode()
    assert f'startConnector="r[{base + 2}]" endElement="m" endConnector="f[{base}]"' in text
    again = load(tmp_path / "x.ssp")
    assert last(ran(again, tmp_path)) == [30.0, 5.0, 10.0]
    assert set(again.components["m"].inputs) == set(inputs)


@BASES
def test_fit_linearize_and_messages(tmp_path: Path, base: int) -> None:
    plan = assemble(scenario(tmp_path, base))
    (one,) = varied(plan, [f"m.p[{base + 2}]:1..2"])
    assert (one.index, one.name) == (2, f"m.p[{base + 2}]")
    with pytest.raises(CosimError, match=rf"such as m\.p\[{base}\]|such as p\[{base}\]"):
        varied(plan, ["m.p:1..2"])
    fed = scenario(tmp_path, base, inputs={f"f[{base}]": "k.now"})
    said = " ".join(x.line for x in check(fed, assemble(fed)) if x.where.startswith("m"))
    assert f"f[{base + 1}]" in said and f"f[{base + 2}]" in said and f"f[{base}]" not in said
    model = linearized(
        tmp_path / "plain.fmu",
        ["run.stop=0.1", "run.step=0.1"],
        inputs=[f"plain2.f[{base + 1}]"],
        outputs=[f"plain2.r[{base + 1}]", f"plain2.r[{base}]"],
    )
    assert np.hstack([model.C @ model.B, model.D]).any(axis=1).tolist() == [True, False]


def test_matrices_from_one(tmp_path: Path) -> None:
    names = [(i, j) for i in (1, 2) for j in (1, 2, 3)]
    variables = [
        real(f"{kind}[{i},{j}]", first + n, causality)
        for kind, first, causality in (("A", U, "input"), ("B", P, "parameter"), ("C", Y, "output"))
        for n, (i, j) in enumerate(names)
    ]
    path = export(tmp_path / "matrix.fmu", described(variables))
    parameters = {"B[2,1]": 4.0, "B": [[0, 0, 3], [0, 0, 0]]}
    document = {
        "run": {"step": 0.1, "stop": 0.1},
        "components": {
            "a": {"model": str(path), "parameters": parameters},
            "b": {"model": str(path), "inputs": {"A[2]": "a.C[1]", "A[1,2]": "a.C[2,1]"}},
        },
    }
    run = ran(build(document, tmp_path / "s.toml"), tmp_path)
    found = {n: run.column(n)[-1] for n in run.names if run.column(n)[-1]}
    assert found == {"a.C[1,3]": 3.0, "a.C[2,1]": 4.0, "b.C[2,3]": 3.0, "b.C[1,2]": 4.0}
    assert np.shape(run.array("a.C")) == (2, 6)
