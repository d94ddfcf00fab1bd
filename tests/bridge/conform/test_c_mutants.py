"""The participant in C keeps every rule, and each mutant of it breaks the one that names it.

The mutants are in `c_mutants.toml`. All of them run in `.ci/long conform`; a sample is `live`.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.conform.participant import PARTICIPANT_RULES, ParticipantKit
from bridge.conform.rules import Conformity, ConformityReport
from bridge.deployment.system import System, load_system
from bridge.rehearsal.simulated_buses import served
from bridge.sdk.folder import write_participant
from cosim.base import toml
from tests.bridge.deployments import TELEOPERATION

NODE, ATTEMPTS = "master_control", 3
MUTANTS = toml.read(Path(__file__).with_name("c_mutants.toml"))["mutants"]
#: Rules whose mutants `.ci/run` tries, too.
SAMPLE = ("C-30", "C-59")
SETTINGS = [
    'run.stop="60 s"',
    *(f'deploy.buses.{bus}.interface="cosim"' for bus in ("left", "right")),
    *(f'deploy.buses.{bus}.channel="{bus}"' for bus in ("left", "right")),
]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc)"),
]


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sources of the participant in C."""
    folder = tmp_path_factory.mktemp("participant") / "c"
    write_participant(load_system(TELEOPERATION, "can", SETTINGS), NODE, "c", folder)
    return folder


@pytest.fixture(scope="module")
def system() -> Iterator[System]:
    """The deployment on simulated buses that are served."""
    with served(load_system(TELEOPERATION, "can", SETTINGS), []) as channels:
        yield load_system(TELEOPERATION, "can", [*SETTINGS, *channels])


def built(sources: Path, folder: Path, mutant: dict | None = None) -> Path:
    """The program, with the changes of a mutant."""
    shutil.copytree(sources, folder)
    for change in mutant["changes"] if mutant else ():
        file = folder / change["file"]
        code, old = file.read_text(encoding="utf-8"), change["old"]
        assert code.count(old) == 1, f"{file.name} has {old!r} {code.count(old)} times"
        file.write_text(code.replace(old, change["new"]), encoding="utf-8")
    command = "cc -std=c99 -O0 -w -o participant *.c"
    subprocess.run(command, shell=True, cwd=folder, check=True)
    return folder / "participant"


def judge(system: System, program: Path, rules: str) -> ConformityReport:
    channels = [system.deployment.buses[bus].channel for bus in system.buses_of(NODE)]
    kit = ParticipantKit(system, NODE, [str(program), *channels])
    return kit.judge(PARTICIPANT_RULES.selected(rules))


def broken(system: System, program: Path, rule: str) -> Conformity:
    """The verdict of a rule; a slow machine gets some attempts."""
    for _ in range(ATTEMPTS):
        found = judge(system, program, rule)
        if found.verdict is not Conformity.INCONCLUSIVE:
            break
    return found.verdict


def test_the_participant_in_c_keeps_every_rule(
    system: System, sources: Path, tmp_path: Path
) -> None:
    found = judge(system, built(sources, tmp_path / "c"), "")
    failed = {j.rule.number: j.came for j in found.judged if j.verdict is Conformity.FAILED}
    assert not failed
    assert found.count(Conformity.PASSED) + found.count(Conformity.INCONCLUSIVE) >= 50


def test_there_is_a_mutant_for_most_rules() -> None:
    assert len({m["rule"] for m in MUTANTS}) >= 50


@pytest.mark.parametrize(
    "mutant",
    [
        pytest.param(
            m, id=f"{m['rule']} {m['name']}", marks=[pytest.mark.live] * (m["rule"] in SAMPLE)
        )
        for m in MUTANTS
    ],
)
def test_a_mutant_breaks_the_rule_that_names_it(
    system: System, sources: Path, tmp_path: Path, mutant: dict
) -> None:
    verdict = broken(system, built(sources, tmp_path / "c", mutant), mutant["rule"])
    if verdict is Conformity.INCONCLUSIVE:
        pytest.skip("this machine was too slow to tell")
    assert verdict is Conformity.FAILED
