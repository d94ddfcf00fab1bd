"""A file that is no scenario is said to be what it is, with the command that it is for."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.cli.overview import COMMANDS
from tests.cli.command import CONFIG, ROOT, Command
from tests.cli.conftest import cosim as cosim  # the command as a fixture


@pytest.mark.parametrize(
    ("file", "said"),
    [
        ("studies/delay.toml", "is a study, not a scenario; it is for `cosim sweep "),
        ("deploy/can.toml", "is a deployment, not a scenario; it is for `cosim rehearse SCENARIO"),
        ("faults/drop.toml", "is a fault script, not a scenario; it is for `cosim rehearse SCENAR"),
        ("faults/campaign.toml", "is a campaign, not a scenario; it is for `cosim campaign "),
        ("compare/bilateral.toml", "is a file of variants, not a scenario; it is for `cosim comp"),
        ("can/link.dbc", "is a DBC file, not a scenario; it is for dbc in a bus"),
        ("can/generate.py", 'is a Python file, not a scenario; it is for model = "MODULE:CLASS"'),
        ("robots/fr3.urdf", "is a robot, not a scenario; it is for `cosim new arm NAME --urdf "),
    ],
)
def test_a_file_for_another_command(cosim: Command, file: str, said: str) -> None:
    done = cosim("run", ROOT / "configs" / file)
    assert done.code == 2 and f"configs/{file}: {said}" in done.err


@pytest.mark.parametrize(
    ("command", "file", "said"),
    [
        ("sweep", "teleoperation.toml", "is a scenario, not a study; it is for `cosim run "),
        ("campaign", "teleoperation.toml", "is a scenario, not a campaign; it is for `cosim run "),
        ("report", "teleoperation.toml", "is a scenario, not the folder of a run; it is for `cosi"),
        ("diff", "teleoperation.toml", "is a scenario, not the folder of a run; it is for `cosim "),
        ("replay", "teleoperation.toml", "is a scenario, not the folder of a run; it is for `cos"),
        ("rehearse", "studies/delay.toml", "is a study, not a scenario; it is for `cosim sweep "),
        ("compare", "studies/delay.toml", "is a study, not a scenario; it is for `cosim sweep "),
        ("check", "deploy/can.toml", "is a deployment, not a scenario; it is for `cosim rehearse "),
        ("export", "deploy/can.toml", "is a deployment, not a scenario; it is for `cosim rehear"),
        ("info", "teleoperation.toml", "is a scenario, not an FMU; it is for `cosim run "),
    ],
)
def test_every_command_names_the_right_one(
    cosim: Command, command: str, file: str, said: str
) -> None:
    path = ROOT / "configs" / file
    done = cosim(command, path, *([path] if command == "diff" else []))
    assert done.code == 2 and f"{path}: {said}" in done.err


def test_keys_are_of_nodes(cosim: Command, tmp_path: Path) -> None:
    done = cosim("keys", ROOT / "configs" / "teleoperation.toml", "--folder", tmp_path / "keys")
    assert done.code == 2 and "which is a scenario; " in done.err
    assert "expected names of nodes: master slave" in done.err
    none = cosim("keys", "none.toml", "--folder", tmp_path / "keys")
    assert none.code == 2 and "found none.toml, the name of a file" in none.err
    assert not (tmp_path / "keys").exists()


@pytest.mark.parametrize("command", ["soak", "rehearse"])
def test_a_missing_scenario_is_named_before_its_deployment(cosim: Command, command: str) -> None:
    done = cosim(command, "nofile.toml")
    assert done.code == 2 and "nofile.toml: no such file; expected a scenario" in done.err


def test_a_file_in_place_of_a_command(cosim: Command) -> None:
    done = cosim(CONFIG)
    assert done.code == 2 and f"is a scenario; it is for `cosim run {CONFIG}`" in done.err


def test_a_wrong_scenario_keeps_its_own_message(cosim: Command, tmp_path: Path) -> None:
    """The file is of the right kind: what is wrong inside of it is said."""
    (tmp_path / "a.toml").write_text('[components.a]\nmodel = "fmus.models.nothing"\n')
    done = cosim("run", tmp_path / "a.toml")
    assert done.code == 2 and "it is for" not in done.err


def test_the_folder_of_a_run(cosim: Command, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text("{}", encoding="utf-8")
    done = cosim("run", tmp_path)
    assert done.code == 2 and "is the folder of a run, not a scenario" in done.err


def test_a_command_that_is_not_there(cosim: Command) -> None:
    done = cosim("rehears")
    assert done.code == 2 and "no command 'rehears'; did you mean 'rehearse'?" in done.err
    done = cosim("completion", "Bash")
    assert done.code == 2 and "did you mean 'bash'?" in done.err


def test_bash_completes_commands_options_and_files(cosim: Command, tmp_path: Path) -> None:
    script = cosim("completion", "bash").out
    (tmp_path / "scenario.toml").touch()
    fake = 'cosim() { echo "  --set PATH --seed N"; }\n'  # what the script asks for options

    def completed(*words: str) -> list[str]:
        line = " ".join(f"'{word}'" for word in words)
        ask = f"COMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; _cosim; echo ${{COMPREPLY[@]}}"
        call = ["bash", "-c", script + fake + ask]
        return subprocess.run(
            call, cwd=tmp_path, capture_output=True, text=True, check=True
        ).stdout.split()

    assert completed("cosim", "re") == [name for name in COMMANDS if name.startswith("re")]
    assert completed("cosim", "run", "--se") == ["--set", "--seed"]
    assert completed("cosim", "run", "sce") == ["scenario.toml"]
    assert "compinit" in cosim("completion", "zsh").out
    assert "__fish_use_subcommand" in cosim("completion", "fish").out


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["run", str(CONFIG), "--deploy", "can-c"], ["can-cia402", "can-classic"]),
        (["run", str(CONFIG), "--set", "run.st"], ["run.step=", "run.stop=", "run.start="]),
        (
            ["run", str(CONFIG), "--set", "links.1.delay.h"],
            ["links.1.delay.high=", "links.1.delay.hold="],
        ),
        (["run", str(CONFIG), "--set", "links.0.delay.name=wifi"], ["links.0.delay.name=wifi5"]),
        (["run", str(CONFIG), "--record", "master.t"], ["master.tau_h"]),
        (["delays", "wifi"], ["wifi5"]),
        (["run", str(CONFIG), "--out", "ru"], []),
        (["run", "no.toml", "--set", "run.sto"], ["run.stop="]),
        ([], []),
    ],
)
def test_values_of_options_are_offered(cosim: Command, words: list[str], found: list[str]) -> None:
    offered = cosim("completion", "words", *words).out.split()
    assert [w for w in found if w not in offered] == []
    assert all(w.startswith(words[-1]) for w in offered) and bool(offered) == bool(found)


def test_a_completion_needs_no_numpy() -> None:
    words = ["run", str(CONFIG), "--set", "links.0.delay.name="]
    code = (
        "import sys; from cosim.loading.candidates import candidates; "
        f"assert candidates({words!r}); assert 'numpy' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


#: An interactive zsh completes ``cosim rep`` and an option on a pseudo-terminal.
ZSH = r"""
zmodload zsh/zpty; zpty z 'zsh -f -i'
zpty -w z 'PS1="%% "; eval "$(cosim completion zsh)"; bindkey "^I" complete-word; echo REA""DY'
zpty -r -m z x '*READY*'
zpty -w -n z $'cosim rep\t\t'; zpty -r -m z x '*reproduce*'; print -r -- $x
zpty -w -n z $'\x15cosim run --st\t\t'; zpty -r -m z x '*--strict*'; print -r -- $x
zpty -d z
"""
FISH = """cosim completion fish | source; complete -C "cosim rep"; complete -C "cosim run --st"
complete -C "cosim delays wifi"
"""


@pytest.mark.slow
@pytest.mark.parametrize(("shell", "script"), [("zsh", ZSH), ("fish", FISH)])
def test_other_shells_complete_commands_and_options(
    tmp_path: Path, shell: str, script: str
) -> None:
    if shutil.which(shell) is None:
        assert not os.environ.get("CI"), f"no {shell}"
        pytest.skip(f"no {shell} on this machine")
    command = tmp_path / "cosim"
    command.write_text(f'#!/bin/sh\nexec {sys.executable} -m cosim "$@"\n')
    command.chmod(0o755)
    env = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "HOME": str(tmp_path),
           "PYTHONPATH": str(ROOT)}  # fmt: skip
    done = subprocess.run(
        [shell, "-c", script], capture_output=True, text=True, env=env, timeout=120, check=True
    )
    for word in ("replay", "report", "reproduce", "--stop", "--strict"):
        assert word in done.stdout, done
    assert "recover" not in done.stdout and "--set" not in done.stdout
