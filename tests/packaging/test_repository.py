"""Files that servers and other tools read: their steps are run, their commands exist."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from bridge.deployment.system import load_system
from bridge.results.outcome import run_twin
from bridge.scaffold import write_controller
from fmus.build.archive import VERSIONS

ROOT = Path(__file__).resolve().parents[2]
ACTION: dict[str, Any] = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))


#: Writes its arguments to a file, a line each call, and fails where it is told to.
RECORDER = """\
#!/bin/sh
echo "$@" >>"$CALLS"
[ "$1" != "${FAILS:-}" ]
"""
FULL = {"SCENARIO": "a law.toml", "DEPLOY": "can", "REFERENCE": "runs/1", "OUT": "out"}


def by_action(folder: Path, given: dict[str, str]) -> int:
    """The exit code of the action's own steps, each as its shell runs it."""
    inputs = {f"${{{{ inputs.{name} }}}}": given.get(name.upper(), "") for name in ACTION["inputs"]}
    for step in ACTION["runs"]["steps"]:
        if "run" not in step or step["name"] == "install":
            continue
        if "if" in step:
            assert step["if"] == "inputs.reference != ''"
            if not given.get("REFERENCE"):
                continue
        call = ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", step["run"]]
        code = run(call, folder, {name: inputs[text] for name, text in step["env"].items()})
        if code:
            return code
    return 0


def by_script(folder: Path, given: dict[str, str]) -> int:
    """The exit code of the script that does the same."""
    return run(["sh", str(ROOT / "examples" / "ci.sh")], folder, given)


def run(call: list[str], folder: Path, given: dict[str, str]) -> int:
    """The exit code of a command; programs in `folder` come first, then those of this Python."""
    path = os.pathsep.join([str(folder), str(Path(sys.executable).parent), os.environ["PATH"]])
    known = {"PATH": path, "PYTHONPATH": str(ROOT), "CALLS": str(folder / "calls")}
    return subprocess.run(call, cwd=folder, env=os.environ | known | given).returncode


@pytest.mark.parametrize("how", [by_action, by_script])
@pytest.mark.parametrize("fails", ["", "check", "run", "diff"])
def test_the_steps_come_in_order_and_end_where_one_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: Any, fails: str
) -> None:
    (tmp_path / "cosim").write_text(RECORDER)
    (tmp_path / "cosim").chmod(0o755)
    monkeypatch.setenv("FAILS", fails)
    assert how(tmp_path, FULL) == (1 if fails else 0)
    calls = (tmp_path / "calls").read_text().splitlines()
    expected = [
        "check a law.toml --deploy can",
        "run a law.toml --deploy can --out out/twin",
        "diff runs/1 out/twin --html out/difference.html --junit out/difference.xml",
    ]
    done = ["", "check", "run", "diff"].index(fails) or 3
    assert calls == expected[:done]
    if not fails:
        assert how(tmp_path, FULL | {"REFERENCE": "", "DEPLOY": ""}) == 0
        assert (tmp_path / "calls").read_text().splitlines()[3:] == [
            "check a law.toml --deploy ",
            "run a law.toml --deploy  --out out/twin",
        ]


def test_the_script_checks_runs_and_compares(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_controller("law_for_ci", tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    file = tmp_path / "law_for_ci.toml"
    file.write_text(file.read_text().replace('stop = "5 s"', 'stop = "0.1 s"'))
    system = load_system(file, str(tmp_path / "deploy" / "law_for_ci.toml"), ["run.stop=0.1"])
    reference = run_twin(system, tmp_path / "reference")
    file.write_text(file.read_text().replace("K = 20.0", "K = 80.0"))
    given = {"SCENARIO": "law_for_ci.toml", "REFERENCE": str(reference), "OUT": "out"}
    assert by_script(tmp_path, given) == 1  # it is another controller
    for name in ("twin/report.html", "difference.html", "difference.xml"):
        assert (tmp_path / "out" / name).is_file()


def test_reports_are_kept_of_what_failed_above_all() -> None:
    assert ACTION["runs"]["steps"][-1]["if"] == "always()"


def test_commands_that_servers_and_hooks_call_are_there() -> None:
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())
    calls = [s["run"] for s in workflow["jobs"]["run"]["steps"] if "run" in s]
    assert calls and all(os.access(ROOT / call.split()[-1], os.X_OK) for call in calls)
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"][0]["hooks"]
    program, *steps = shlex.split(hooks[0]["entry"])
    check = (ROOT / program).read_text()
    assert os.access(ROOT / program, os.X_OK)
    assert steps and all(f"    {step})" in check for step in steps)


def test_a_report_of_a_problem_asks_for_what_repeats_it() -> None:
    form = yaml.safe_load((ROOT / ".github" / "ISSUE_TEMPLATE" / "problem.yml").read_text())
    required = {x["id"] for x in form["body"] if x.get("validations", {}).get("required")}
    assert {"repeat", "doctor"} <= required
    assert any("`cosim doctor`" in x["attributes"]["label"] for x in form["body"])


def test_read_the_docs_builds_the_site_as_its_script_says() -> None:
    """The keys are those of the service's schema, against which the file was checked once."""
    found = yaml.safe_load((ROOT / ".readthedocs.yaml").read_text(encoding="utf-8"))
    jobs = found["build"]["jobs"]
    script = (ROOT / "docs" / "site.py").read_text(encoding="utf-8")
    (install,) = jobs["install"]
    assert f"``{install}``" in script
    (build,) = jobs["build"]["html"]
    assert shlex.split(build) == ["python", "docs/site.py", "$READTHEDOCS_OUTPUT/html"]
    assert "python docs/site.py FOLDER" in script
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    python = found["build"]["tools"]["python"]
    assert f"Programming Language :: Python :: {python}" in project["classifiers"]
    assert "site" in project["optional-dependencies"]


def test_texts_of_listings_agree_with_the_project() -> None:
    release = (ROOT / "RELEASE.md").read_text(encoding="utf-8")
    listed = json.loads(release.split("```json\n")[1].split("```")[0])
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    head, row = (
        next(line for line in readme.splitlines() if line.startswith(begin)).split("|")[2:5]
        for begin in ("| | Linux", "| runs, studies")
    )
    tried = {name for name, said in zip(head, row, strict=True) if said.strip() == "yes"}
    assert all(any(name in column for column in tried) for name in listed["platforms"])
    fmi = (ROOT / "docs" / "fmi.md").read_text(encoding="utf-8")
    assert set(listed["fmiVersions"]) == {"1.0", *VERSIONS}
    for word, kind in (("CS", "co-simulation"), ("ME", "model exchange"), ("SE", "scheduled exec")):
        assert word in listed["fmuImport"] and kind in fmi
    page = listed["examplesURL"].removeprefix("SITE/").removesuffix(".html")
    assert (ROOT / "docs" / f"{page}.md").is_file()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert "cosim" in project["entry-points"]["can.interface"]
    assert project["name"] == listed["name"] == "cosim-bridge"
