"""What README, CI and pyproject promise each other."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path
from time import sleep

import pytest

import cosim

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def command(name: str) -> str:
    """The one command between two markers of the README."""
    found = re.search(rf"<!-- {name} -->\n```sh\n(.*)\n```\n<!-- end -->", README)
    assert found, f"README.md has no {name} on a line of its own"
    return found[1]


@pytest.mark.parametrize("name", ["run command", "test command"])
def test_each_command_of_the_readme_sets_up_its_own_environment(name: str) -> None:
    setup, install, use = command(name).split(" && ")
    assert setup == "python3 -m venv .venv"
    assert install.startswith(".venv/bin/pip install -q ")
    assert use.startswith(".venv/bin/")


@pytest.mark.parametrize("name", ["run command", "test command"])
def test_ci_runs_each_command_as_the_readme_prints_it(name: str) -> None:
    script = (ROOT / ".ci" / "run").read_text()
    function = re.search(r"^readme_command\(\).*?^}$", script, re.MULTILINE | re.DOTALL)
    assert function
    assert script.count(f'readme_command "{name}"') > 0
    call = ["bash", "-c", f"{function[0]}\nreadme_command '{name}'"]
    done = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == command(name)


@pytest.mark.parametrize("script", PROJECT["project"]["scripts"].items(), ids=lambda s: s[0])
def test_console_scripts_exist(script: tuple[str, str]) -> None:
    module, _, function = script[1].partition(":")
    assert callable(getattr(import_module(module), function))


@pytest.mark.parametrize("name", PROJECT["project"]["scripts"])
def test_commands_print_their_help(name: str) -> None:
    module = PROJECT["project"]["scripts"][name].partition(":")[0]
    call = f"import sys; sys.argv = [{name!r}, '--help']; from {module} import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", call], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "usage" in done.stdout.lower()


@pytest.mark.parametrize("package", ["cosim", "fmus", "bridge"])
def test_packages_are_typed(package: str) -> None:
    assert (ROOT / package / "py.typed").is_file()


def test_the_changelog_knows_this_version() -> None:
    assert re.search(
        rf"^## {re.escape(cosim.__version__)}\b", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE
    )


def test_importing_the_packages_is_cheap() -> None:
    imported = "sys, cosim, fmus, bridge, cosim.native.structs, fmus.build.toolchain"
    call = f"import {imported}; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", call], cwd=ROOT, capture_output=True, text=True, check=True
    )
    heavy = {"numpy", "pyarrow", "matplotlib", "fmpy", "msgspec"}
    assert not heavy & set(done.stdout.split())


def test_models_are_declared_without_any_dependency() -> None:
    """So `pip install .` builds their FMUs in an environment that has setuptools only."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    libraries = {re.split(r"[<>=]", text)[0].replace("-", "_") for text in project["dependencies"]}
    libraries |= {"can", "zenoh"}
    call = f"import sys; sys.modules.update(dict.fromkeys({libraries}))\n"
    call += "from fmus.build.archive import installed_models; installed_models()"
    done = subprocess.run([sys.executable, "-c", call], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_parts_of_every_week_are_parts_of_the_long_tests():
    weekly = (ROOT / ".ci" / "weekly").read_text()
    named = re.search(r"\|\| set -- (.+)", weekly)
    known = re.findall(r"^part_(\w+)\(\)", (ROOT / ".ci" / "long").read_text(), re.M)
    assert named is not None and named[1].split() and set(named[1].split()) <= set(known)


def test_a_test_that_hangs_has_its_stacks_written_before_its_process_ends() -> None:
    options = PROJECT["tool"]["pytest"]["ini_options"]
    assert 0 < options["faulthandler_timeout"] < options["timeout"]


@pytest.mark.parametrize("code", [0, 3])
def test_ci_fails_where_what_it_began_failed(code: int) -> None:
    begun = f"begin part bash -c 'echo said; exit {code}'; echo meanwhile; finish part; echo after"
    call = ["bash", "-c", f". {ROOT / '.ci' / 'run'}; {begun}"]
    done = subprocess.run(call, capture_output=True, text=True, timeout=60)
    words = ["meanwhile", "said", *(["after"] if code == 0 else [])]
    assert (done.stdout.split(), done.returncode) == (words, code)


def test_ci_ends_with_the_code_of_its_last_command() -> None:
    for code in (0, 3):
        call = ["bash", "-c", f". {ROOT / '.ci' / 'run'}; exit {code}"]
        assert subprocess.run(call, timeout=60).returncode == code


def test_ci_beside_busy_processes_leaves_none_behind() -> None:
    call = ["bash", "-c", f". {ROOT / '.ci' / 'run'}; make_busy; echo ${{busy[@]}}"]
    done = subprocess.run(
        call, env=os.environ | {"LOAD": "1"}, capture_output=True, text=True, timeout=60, check=True
    )
    pids = done.stdout.splitlines()[-1].split()
    assert len(pids) == 2
    left = pids
    for _ in range(1000):
        if not (left := [pid for pid in pids if Path(f"/proc/{pid}").exists()]):
            break
        sleep(0.01)
    assert not left
