"""The Python interface: what ``import cosim`` offers."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.loading.files import load
from cosim.record import Run

ROOT = Path(__file__).parents[3]
CONFIG = ROOT / "configs" / "teleoperation.toml"


@pytest.fixture(scope="module")
def result() -> cosim.RunResult:
    return cosim.run(str(CONFIG), set={"run.stop": "3 s", "links[0].delay.high": "1 s"}, seed=3)


def test_the_names_are_imported_when_they_are_used() -> None:
    code = (
        "import sys, cosim; before = set(sys.modules)\n"
        "assert not {'numpy', 'pyarrow', 'msgspec', 'cosim.api'} & before, before\n"
        "for name in cosim.__all__: getattr(cosim, name)\n"
        "assert 'matplotlib' not in sys.modules and 'pandas' not in sys.modules\n"
        "assert len(cosim.__all__) <= 12 and set(cosim.__all__) <= set(dir(cosim))"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
    with pytest.raises(AttributeError, match="module 'cosim' has no attribute 'walk'"):
        cosim.walk  # type: ignore[attr-defined]  # noqa: B018


def test_a_run_is_that_of_the_command_line(result: cosim.RunResult, tmp_path: Path) -> None:
    from cosim.engine.simulate import simulate

    settings = ["run.stop=3 s", "links.0.delay.high=1 s", "run.seed=3"]
    simulate(load(CONFIG, settings), tmp_path / "run")
    expected = Run.open(tmp_path / "run")
    assert result.signals[:2] == ("master.dq", "master.q")
    assert np.array_equal(result["master.q"], expected.array("master.q"))
    assert np.array_equal(result["master.q[1]"], expected.column("master.q[1]"))
    assert result.unit("master.q") == "rad"
    assert result.t[-1] == 3.0 and len(result) == len(result.t)
    assert result.metrics["effort"].unit == "N.m.√s"
    assert result.metrics["effort"].value == pytest.approx(46.0, abs=2.0)
    assert result.status == "finished"


def test_a_folder_is_opened_again(result: cosim.RunResult) -> None:
    again = cosim.open(result.folder)
    assert np.array_equal(again["slave.q"], result["slave.q"])
    assert again.metrics.keys() == result.metrics.keys()
    assert repr(again) == repr(result)
    assert "3001 rows to 3 s, finished" in repr(again)


def test_a_temporary_folder_is_removed_with_its_result(tmp_path: Path) -> None:
    first = cosim.run(CONFIG, set={"run.stop": "10 ms"})
    folder = first.folder
    assert folder.exists()
    del first
    assert not folder.exists()
    kept = cosim.run(CONFIG, set={"run.stop": "10 ms"}, out=tmp_path / "run")
    del kept
    assert (tmp_path / "run" / "run.json").exists()


def test_tables_for_other_libraries(result: cosim.RunResult) -> None:
    frame = result.to_pandas()
    assert frame.index.name == "t" and frame.attrs["units"]["master.q[0]"] == "rad"
    assert np.array_equal(frame["master.q[0]"].to_numpy(), result["master.q[0]"])
    table = result.to_polars()
    assert table.columns[0] == "t" and table.height == len(result)
    data = result.to_xarray()
    assert data["master.q"].dims == ("t", "master.q_entry")
    assert data["master.q"].attrs["units"] == "rad"
    assert np.array_equal(data["master.q"].to_numpy(), result["master.q"])


def test_a_library_that_is_missing_is_a_sentence(
    result: cosim.RunResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "polars", None)
    with pytest.raises(cosim.CosimError, match="polars is not installed: pip install polars"):
        result.to_polars()


def test_a_notebook_shows_the_result_and_its_picture(result: cosim.RunResult) -> None:
    html = result._repr_html_()
    assert "operator effort" in html and "<script" not in html and len(html) < 15_000
    for picture in (result.plot(), result.plot("master.q", "slave.q")):
        assert picture._repr_png_().startswith(b"\x89PNG")


def test_findings_of_a_check() -> None:
    found = cosim.check(CONFIG)
    assert [f.severity for f in found] == sorted(
        (f.severity for f in found), key=["error", "warning", "note"].index
    )
    assert any(f.rule == "passivity" for f in found)


def test_controllers_are_compared() -> None:
    found = cosim.compare(
        CONFIG,
        controllers=["paper", "pd"],
        operators=["light"],
        links=["constant"],
        set={"run.stop": "2 s"},
    )
    assert [o.case.controller for o in found.outcomes] == ["paper", "pd"]


def test_a_study_gives_its_rows_as_they_come(tmp_path: Path) -> None:
    study = tmp_path / "study.toml"
    study.write_text(
        f'scenario = "{CONFIG}"\nsettings = ["run.stop=0.1 s"]\n'
        '[vary.k_p]\npath = "components.master.parameters.k_p"\nvalues = [5.0, 10.0]\n',
        encoding="utf-8",
    )
    seen = []
    table = cosim.sweep(study, tmp_path / "out", each=lambda row: seen.append(row.run))
    assert len(seen) == len(table.records) == 2


# ---- scenarios and components in Python --------------------------------------------------------


@cosim.component(
    inputs={"q": (2, "rad"), "dq": (2, "rad/s")},
    outputs={"tau": (2, "N.m")},
    parameters={"k": (10.0, "N.m/rad"), "d": (4.0, "N.m.s/rad")},
)
def spring(q: np.ndarray, dq: np.ndarray, k: float, d: float) -> dict[str, np.ndarray]:
    """A spring to 0 and a damper."""
    return {"tau": -k * q - d * dq}


def hung(model: object, **parameters: float) -> dict[str, object]:
    return {
        "run": {"step": "1 ms", "stop": "2 s"},
        "components": {
            "arm": {
                "model": "fmus.models.planar2r",
                "inputs": {"tau": "control.tau"},
                "start": {"q": [1.0, 0.5]},
            },
            "control": {
                "model": model,
                "period": "5 ms",
                "inputs": {"q": "arm.q", "dq": "arm.dq"},
                "parameters": parameters,
            },
        },
    }


def test_a_scenario_in_python_runs_a_function_as_a_controller() -> None:
    given = cosim.run(hung(spring), set={"components.control.parameters.d": 8.0})
    q, dq, tau = given["arm.q"], given["arm.dq"], given["control.tau"]
    assert np.array_equal(tau[0], -10.0 * q[0])
    k = 400  # at 0.4 s the controller reads the arm, and holds its output
    assert np.array_equal(tau[k], -10.0 * q[k] - 8.0 * dq[k])
    assert np.array_equal(tau[k], tau[k + 4])
    other = cosim.run(hung(spring, k=40.0, d=8.0))
    assert np.array_equal(other["control.tau"][0], -40.0 * q[0])


def test_the_same_object_has_one_name_and_others_have_their_own() -> None:
    from cosim.api.given import name_of

    def make() -> None:
        pass

    other = make
    assert name_of(make) == name_of(other)

    assert name_of(lambda: None) != name_of(lambda: None)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: cosim.run("nothing.toml"), "nothing.toml: no such file"),
        (lambda: cosim.run(CONFIG, set={"components.nobody.period": "1 s"}), "no 'nobody'"),
        (lambda: cosim.run({"run": {"step": "1 ms", "stop": "1 s"}}), r"no \[components\] table"),
        (lambda: cosim.open("no-such-folder"), "there is no such run folder"),
        (lambda: cosim.component(inputs={"q": 3}, outputs={}), "port 'q' is 3; expected a unit"),  # type: ignore[dict-item]
    ],
)
def test_mistakes_are_sentences(call: object, says: str) -> None:
    with pytest.raises(cosim.CosimError, match=says):
        call()  # type: ignore[operator]


def test_an_unknown_signal_is_answered_with_the_nearest(result: cosim.RunResult) -> None:
    with pytest.raises(cosim.CosimError, match=r"did you mean 'master\.q'"):
        result["master.qq"]


def test_the_examples_of_the_page_run(monkeypatch: pytest.MonkeyPatch) -> None:
    page = (ROOT / "docs" / "running.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    monkeypatch.chdir(ROOT)
    names: dict[str, object] = {}
    for block in blocks[:2]:  # the third runs whole comparisons and studies
        exec(compile(block, "docs/running.md", "exec"), names)
    run = names["run"]
    assert isinstance(run, cosim.RunResult) and abs(run["arm.q"][-1]).max() < 0.5
