"""``--json``: what a command prints, as data; it is the same for a program to read."""

from __future__ import annotations

import json
import re
from math import inf, nan
from pathlib import Path
from typing import Any

import pytest
from click import Command as Command_
from click import Context
from typer.main import get_command

from cosim.base.errors import RunError
from cosim.cli.commands import app
from cosim.cli.options import JSON_VERSION, write_json
from cosim.cli.overview import COMMANDS
from cosim.record import Run
from cosim.record.digest import digest
from fmus.models import planar2r
from tests.cli.command import ROOT, Command
from tests.cli.conftest import cosim as cosim  # the command as a fixture
from tests.cosim.study.studies import STUDY, written

CONFIG = ROOT / "configs" / "teleoperation.toml"


def test_numbers_that_are_not_finite_are_null(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_json(path, "run", {"a": [nan, 1.0, (inf, 2)], "b": {"c": -inf}})
    assert json.loads(path.read_text("utf-8")) == {
        "schema": "cosim.run/1",
        "a": [None, 1.0, [None, 2]],
        "b": {"c": None},
    }
    with pytest.raises(RunError, match=r"cannot write .*none/a.json"):
        write_json(tmp_path / "none" / "a.json", "run", {})


@pytest.fixture
def said(cosim: Command, tmp_path: Path) -> Any:
    """What a command says and writes."""

    def call(*arguments: str | Path) -> tuple[Any, str]:
        path = tmp_path / "said.json"
        done = cosim(*arguments, "--json", path)
        assert done.code == 0, done.err
        return json.loads(path.read_text("utf-8")), done.out

    return call


def test_how_a_scenario_runs_and_what_a_run_folder_holds(said: Any, tmp_path: Path) -> None:
    found, text = said("show", CONFIG)
    assert (found["step_s"], found["ticks"], found["algorithm"]) == (0.001, 60000, "sampled")
    assert [c["name"] for c in found["components"]][:2] == ["master", "master_control"]
    for entry in found["what each input samples"]:
        assert set(entry) == {"input", "source", "value"} and entry["value"] in text
    assert found["links"][0]["least age"] == "at least 300 ticks old"
    said("run", CONFIG, "--set", "run.stop=0.01", "--no-plot", "--out", tmp_path / "run")
    found, text = said("show", tmp_path / "run")
    assert found["status"] == "finished" and found["recorded"] == "11 rows to t = 0.01 s"
    assert found["recorded"] in text


@pytest.mark.parametrize("form", ["module", "file"])
def test_what_an_fmu_is(said: Any, form: str) -> None:
    file = str(planar2r.fmu())
    found, text = said("info", "fmus.models.planar2r" if form == "module" else file)
    assert found["FMI"] == "2.0 co-simulation" and found["kind"] == "continuous"
    assert found["problems"] == [] and "FMPy found no problems" in text
    signals = {s["signal"]: s for s in found["signals"]}
    assert (signals["tau[2]"]["unit"], signals["q[2]"]["causality"]) == ("N.m", "output")


def test_what_a_python_component_is(said: Any) -> None:
    found, _ = said("info", "tests.cli.components:Half")
    assert found["problems"] is None and found["kind"] == "sampled"
    assert [(s["signal"], s["causality"]) for s in found["signals"]] == [
        ("u[2]", "input"), ("y[2]", "output"), ("fails", "start"),
    ]  # fmt: skip


def test_a_run_and_its_twin(said: Any, tmp_path: Path) -> None:
    short = ("--set", "run.stop=2", "--no-plot")
    found, text = said("run", CONFIG, *short, "--out", tmp_path / "run")
    assert found["folder"] == str(tmp_path / "run") and found["seconds"] == 2.0
    effort = found["metrics"]["effort"]
    assert f"{effort['value']:.4g} {effort['unit']}" in text
    assert len(found["link_ages"]) == 2
    assert found["digest"] == digest(Run.open(tmp_path / "run"))
    twin, text = said("run", CONFIG, "--deploy", "zenoh", *short, "--out", tmp_path / "twin")
    assert f"{twin['metrics']['effort']['value']:.4g}" in text


def test_a_rehearsal_its_replay_and_its_report(said: Any, cosim: Command, tmp_path: Path) -> None:
    found, text = said(
        "rehearse", CONFIG, "--deploy", "can", "-i", "cosim", "--clock", "simulated", "--set",
        "run.stop=0.5", "--no-twin", "--out", tmp_path / "run",
    )  # fmt: skip
    assert f"verdict                {found['verdict']}" in text and found["exit_code"] == 0
    assert found["replay"] == {"exact": True, "greatest": 0.0, "first": None}
    assert {n: x["slots"] for n, x in found["nodes"].items()} == {
        "master": 500, "slave": 500, "master_control": 100, "slave_control": 100,
    }  # fmt: skip
    again, text = said("replay", tmp_path / "run")
    assert again["exact"] and again["slots"]["master"] == 500 and "exactly 0" in text
    page = tmp_path / "run" / "report.html"
    first = page.read_bytes()
    page.unlink()
    assert cosim("report", tmp_path / "run").code == 0
    assert page.read_bytes() == first and b"Configured and measured" in first


def test_a_sweep_and_a_comparison(said: Any, tmp_path: Path) -> None:
    study = written(tmp_path, STUDY + "values = [1, 10, 205]\n[stable]\nrest = 1.0\n")
    found, _ = said("sweep", study, "--out", tmp_path / "sweep", "--jobs", "1", "--no-plot")
    assert (found["points"], found["runs"], found["stable"], found["failed"]) == (3, 3, 2, 0)
    assert found["measures"]["rest"]["largest"] > 1.0
    found, _ = said(
        "compare", CONFIG, "--controllers", "paper", "--operators", "light", "--links", "paper",
        "--set", "run.stop=1 s", "--jobs", "1", "--no-plot", "--out", tmp_path / "compared",
    )  # fmt: skip
    table = (tmp_path / "compared" / "table.json").read_text("utf-8")
    assert found["runs"] == json.loads(table)["runs"]


def test_delays_and_claims(said: Any, tmp_path: Path) -> None:
    found, text = said("delays")
    wifi = next(x for x in found["delays"] if x["name"] == "wifi5")
    assert wifi["law"] == "preset" and f"{1e3 * wifi['p50']:.3g}" in text
    found, text = said("reproduce", "--only", "o1", "--jobs", "1", "--out", tmp_path / "paper")
    assert found["claims"] and all(claim["passed"] for claim in found["claims"])
    assert f"{len(found['claims'])} claims" in text


#: Commands with the option, and arguments of those that need little time.
QUICK: dict[str, tuple[str | Path, ...]] = {
    "run": (CONFIG, "--set", "run.stop=0.01", "--no-plot"),
    "check": (CONFIG,),
    "show": (CONFIG,),
    "info": ("fmus.models.planar2r",),
    "delays": (),
    "doctor": (),
}
WITH_JSON = (
    *(
        "analyze",
        "campaign",
        "check",
        "compare",
        "conform",
        "delays",
        "diff",
        "doctor",
        "falsify",
        "fit",
    ),
    *("identify", "info", "ping", "rehearse", "replay", "reproduce", "run", "show", "soak"),
    "sweep",
)


def option(command: str) -> Any:
    """The option ``--json`` of a command, or None."""
    found = get_command(app).get_command(Context(Command_("cosim")), command)  # type: ignore[attr-defined]
    return next((p for p in found.params if "--json" in p.opts), None)


def test_the_option_is_the_same_everywhere() -> None:
    found = {name: one for name in COMMANDS if (one := option(name)) is not None}
    assert tuple(sorted(found)) == WITH_JSON
    assert {(one.metavar, one.help, one.is_flag) for one in found.values()} == {
        ("FILE", "Write the result as JSON; -: to standard output, and nothing else.", False)
    }


def test_the_table_of_schemas_is_complete() -> None:
    """The schemas that the source writes, by `write_json` or `save` of :class:`ResultOptions`."""
    call = re.compile(r'\b(?:write_json\([^,()]+, |result\.save\()"(\w+)"')
    sources = [p for room in ("bridge", "cosim", "fmus") for p in (ROOT / room).rglob("*.py")]
    written = {name for path in sources for name in call.findall(path.read_text("utf-8"))}
    page = (ROOT / "docs" / "testing.md").read_text("utf-8")
    rows = re.findall(r"^\| `cosim\.([\w-]+)/(\d+)` \| `([\w-]+)", page, re.MULTILINE)
    assert [name for name, _, _ in rows] == sorted(written)
    assert {int(version) for _, version, _ in rows} == {JSON_VERSION}
    assert {command for _, _, command in rows} == set(WITH_JSON)


@pytest.mark.parametrize("command", QUICK)
def test_standard_output_has_the_document_only(
    cosim: Command, tmp_path: Path, command: str
) -> None:
    done = cosim(command, *QUICK[command], "--json", "-")
    printed = json.loads(done.out)
    assert next(iter(printed)) == "schema" and printed["schema"] == f"cosim.{command}/1"
    cosim(command, *QUICK[command], "--json", tmp_path / "said.json")
    written = json.loads((tmp_path / "said.json").read_text("utf-8"))
    assert list(written) == list(printed)
    assert done.err.strip()  # the text
