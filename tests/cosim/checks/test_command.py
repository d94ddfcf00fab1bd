"""``cosim check``, and its warnings in ``cosim run``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.command import CONFIG, Command

TIGHT = ("--set", "components.master.parameters.k_p=200",
         "--set", "components.master.parameters.k_d=2")  # fmt: skip
HOLDING = ("--set", "components.master_control.parameters.lambda_M=0")
PASSIVE = ("--set", "components.master_control.parameters.lambda_M=1",
           "--set", "components.slave_control.parameters.lambda_M=1")  # fmt: skip


def test_warnings_are_told_with_what_to_change(cosim: Command) -> None:
    done = cosim("check", CONFIG, *HOLDING)
    assert (done.code, done.err) == (0, "")
    assert "warning  master_control  [no-integral]" in done.out
    assert "-> choose lambda_M > 0" in done.out
    assert done.out.splitlines()[-1].startswith("0 errors, 1 warning, ")


def test_strict_fails_for_warnings_and_errors_always_fail(cosim: Command) -> None:
    assert cosim("check", CONFIG, "--strict", *HOLDING).code == 1
    assert cosim("check", CONFIG, "--strict").code == 0
    slow = ("--set", "components.master_control.parameters.K=400")
    done = cosim("check", CONFIG, *slow)
    assert done.code == 1 and "error    run  [run]" in done.out
    assert "master_control" in done.out.split("[poles]")[0].splitlines()[-1]


def test_findings_as_json(cosim: Command) -> None:
    cosim("check", CONFIG, "--json", "f.json")
    data = json.loads(Path("f.json").read_text("utf-8"))
    found = {f["rule"]: f for f in data["findings"]}
    assert found["felt-damping"]["number"] == pytest.approx(4.0, rel=1e-4)
    assert set(found["passivity"]) == {
        "rule", "severity", "where", "number", "unit", "reason", "advice"
    }  # fmt: skip
    assert found["passivity"]["severity"] == "note"
    assert "up to lambda_M = 4.79 1/s in place of 10" in found["passivity"]["reason"]


def test_a_scenario_that_cannot_be_is_refused(cosim: Command) -> None:
    lost = '{law="independent", p=0.1}'
    settings = ("--set", f"links.0.loss={lost}", "--set", 'links.0.semantics="fifo"')
    said = cosim.refused("check", CONFIG, *settings)
    assert 'packets are lost, but semantics = "fifo"' in said
    assert "no such file" in cosim.refused("check", "missing.toml")


def test_a_run_says_what_warns_on_standard_error(cosim: Command) -> None:
    run = ("run", CONFIG, "--set", "run.stop=0.1", "--no-plot", "--out")
    said = cosim(*run, "one", *HOLDING)
    assert (said.code, said.err) == (0, "")
    (line,) = said.checked
    assert line.startswith("check: warning: master_control: lambda_M = 0: degree 0")
    assert cosim(*run, "two", *HOLDING, "--quiet").checked == ()
    assert cosim(*run, "three", *PASSIVE).checked == ()


def test_poles_stop_a_run_only_if_it_is_strict(cosim: Command) -> None:
    run = ("run", CONFIG, "--set", "run.stop=0.05", "--no-plot", *TIGHT)
    said = cosim(*run, "--out", "one")
    assert said.code == 0 and Path("one/run.json").is_file() and said.checked == ()
    assert "the loop is unstable" in cosim.refused(*run, "--strict", "--out", "two")


def test_a_check_that_fails_does_not_stop_a_run(
    cosim: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("oh")

    monkeypatch.setattr("cosim.checks.preflight.findings", broken)
    said = cosim("run", CONFIG, "--set", "run.stop=0.05", "--no-plot", "--out", "one")
    assert (said.code, said.err) == (0, "")
    (line,) = said.checked
    assert "the check failed, so nothing is known: ZeroDivisionError: oh" in line
