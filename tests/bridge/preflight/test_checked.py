"""A twin and a rehearsal are checked as `cosim check --deploy` does, and their folders say so."""

import json
from pathlib import Path

import pytest

from bridge.cli.rehearse import checked
from bridge.deployment.system import load_system
from cosim.base.errors import ScenarioError
from cosim.checks import preflight
from cosim.cli.check import print_warnings
from cosim.cli.options import OutputOptions
from tests.bridge.zenoh.rehearsed import CONFIGS
from tests.cli.command import Command
from tests.cli.conftest import cosim as cosim  # the command as a fixture

TELEOPERATION = CONFIGS / "teleoperation.toml"
HOLDING = "components.master_control.parameters.lambda_M=0"
SHORT = ("--set", "run.stop=0.05", "--set", HOLDING)


def test_what_the_check_warns_of_is_in_the_folder_of_a_twin(cosim: Command, tmp_path: Path) -> None:
    words = (str(TELEOPERATION), "--deploy", "can", *SHORT)
    done = cosim("check", *words, "--json", str(tmp_path / "check.json"))
    assert done.code == 0, done.err
    said = json.loads((tmp_path / "check.json").read_text())["findings"]
    serious = [f for f in said if f["severity"] in ("error", "warning")]
    assert any(f["rule"] == "no-integral" for f in serious)
    done = cosim("run", *words, "--out", str(tmp_path / "twin"))
    assert done.code == 0, done.err
    kept = json.loads((tmp_path / "twin" / "run.json").read_text())["findings"]
    assert kept == serious
    assert all(f["reason"] in " ".join(done.checked) for f in kept), done
    page = (tmp_path / "twin" / "report.html").read_text()
    assert "no error and no warning" not in page and "manipulability is finite" in page


def test_a_rehearsal_checks_scenario_and_deployment(capsys: pytest.CaptureFixture[str]) -> None:
    system = load_system(TELEOPERATION, "can", ["run.stop=0.05"])
    settings = ["run.stop=0.05", HOLDING, "deploy.latency=false"]
    found = checked(system, TELEOPERATION, settings, OutputOptions())
    places = [(f["rule"], f["where"]) for f in found]
    assert ("no-integral", "master_control") in places
    assert len(set(places)) == len(places)
    assert capsys.readouterr().err.count("check: warning: ") == len(found)
    with pytest.raises(ScenarioError, match="lambda_M = 0"):
        checked(system, TELEOPERATION, settings, OutputOptions(strict=True, quiet=True))


def test_a_check_that_fails_is_a_finding_not_its_absence(monkeypatch: pytest.MonkeyPatch) -> None:
    system = load_system(TELEOPERATION, "can", ["run.stop=0.05"])

    def fails(*_: object, **__: object) -> None:
        raise ZeroDivisionError("within")

    monkeypatch.setattr(preflight, "findings", fails)
    [found] = print_warnings(system.scenario, system.plan, strict=False, quiet=True)["findings"]
    assert (found["severity"], found["rule"]) == ("warning", "check")
    assert "ZeroDivisionError: within" in found["reason"]
