"""The n-th call of the system on a run folder fails: complete, or a sentence and all data."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from random import Random
from shutil import copytree, rmtree
from typing import Any

import pytest

from bridge.deployment.system import load_system
from bridge.replay import twin
from bridge.results.outcome import begin
from fmus.toolchain import compiler
from tests.bridge.zenoh.rehearsed import sockets
from tests.cli.command import CONFIG, ROOT, finished
from tests.cli.outcomes import judge

TWIN = ("--deploy", "can", "--set", "run.stop=1")
#: {here}: what is written; {given}: a recorded run; {root}: the folder whose calls fail.
COMMANDS: dict[str, Sequence[str]] = {
    "run": ("run", str(CONFIG), "--quiet", "--no-plot", "--set", "run.stop=2", "--out", "{here}"),
    "twin": ("run", str(CONFIG), *TWIN, "--quiet", "--no-plot", "--out", "{here}"),
    "sweep": (
        "sweep", "{study}", "--quiet", "--no-plot", "--workers", "threads", "--jobs", "1",
        "--out", "{here}",
    ),
    "replay": ("replay", "{here}"),
    "offline": ("replay", "{here}", "--offline"),
    "lockstep": (
        "rehearse", str(CONFIG), "--deploy", "zenoh", "--clock", "lockstep", "--no-plot",
        "--no-twin", "--set", "run.stop=0.5", "--set", "deploy.patience=20 s",
        "--set", "deploy.buses.net.options.wait=\"3 s\"", "--out", "{here}",
    ),
}  # fmt: skip
ROWS = {"run": 2001, "twin": 1000}
#: Those whose nodes are processes of their own: seconds a case.
PROCESSES = ("lockstep",)
STUDY = """
scenario = "{}"
keep = "trajectories"
[vary.stop]
paths = ["run.stop"]
values = [0.5, 1.0]
"""


@pytest.fixture(scope="session")
def shim(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``faulty.c``, compiled."""
    path = tmp_path_factory.mktemp("shim") / "faulty.so"
    source = Path(__file__).with_name("faulty.c")
    call = [*compiler(), "-shared", "-fPIC", "-O1", "-o", str(path), str(source), "-ldl"]
    subprocess.run(call, check=True)
    return path


@pytest.fixture(scope="session")
def given(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nodes that were recorded."""
    folder = tmp_path_factory.mktemp("given")
    system = load_system(CONFIG, "can", ["run.stop=1"])
    begin(system, folder, {"settings": ["run.stop=1"]})
    (folder / "nodes").mkdir()
    twin.simulate(system, folder / "nodes")
    return folder


Case = tuple[int, int, bool]


def outcomes(
    shim: Path, folder: Path, given: Path, command: str, cases: Sequence[Case]
) -> Iterator[tuple[Case, Path, dict[str, Any]]]:
    """(at, errno, whether it stays so) -> the folder and what came of it.

    Before them one in which nothing fails; cases beyond the number of its calls are left out.
    """
    with subprocess.Popen(
        [sys.executable, "-m", "tests.cli.failing"],
        cwd=ROOT, env=os.environ | {"LD_PRELOAD": str(shim), "PYTHONPATH": str(ROOT)},
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as program:  # fmt: skip
        assert program.stdin is not None and program.stdout is not None
        (folder / "study.toml").write_text(STUDY.format(CONFIG))
        calls = max(at for at, _, _ in cases)
        for i, (at, number, keep) in enumerate([(0, 0, False), *cases]):
            if at > calls:
                continue
            root = folder / f"{i}"
            root.mkdir()
            here = root / "here"
            if command in ("replay", "offline"):
                copytree(given, here)
            names = {"here": here, "study": folder / "study.toml"}
            arguments = [a.format(**names) for a in COMMANDS[command]]
            for setting in sockets(("master", "slave"), root) if command in PROCESSES else ():
                arguments += ["--set", setting]
            case = {
                "at": at, "errno": number, "keep": keep, "root": f"{root}/", "arguments": arguments,
            }  # fmt: skip
            program.stdin.write(json.dumps(case) + "\n")
            program.stdin.flush()
            found = json.loads(program.stdout.readline())
            if at == 0 and command not in PROCESSES:
                calls = found["calls"]
            yield (at, number, keep), here, found
            rmtree(root)


def failures(
    shim: Path, folder: Path, given: Path, command: str, cases: Sequence[Case]
) -> list[str]:
    """Judge every case: what is not as it has to be. The first, undisturbed one has to be well."""
    wrong, failed = [], 0
    for case, here, found in outcomes(shim, folder, given, command, cases):
        failed += found["code"] != 0
        try:
            judge(here, found, ROWS.get(command))
            assert case[0] > 0 or found["code"] == 0, found
        except Exception as error:
            wrong.append(f"{case}: {type(error).__name__}: {error}")
    assert failed, "no call failed: the shim does nothing"
    return wrong


@pytest.mark.parametrize("command", ["run", "replay"])
def test_some_calls_fail(shim: Path, tmp_path: Path, given: Path, command: str) -> None:
    cases = [(n, errno.ENOSPC, False) for n in (1, 5, 12, 40)]
    cases += [(8, errno.ENOSPC, True), (60, errno.ENOSPC, True), (3, errno.EIO, False)]
    assert not failures(shim, tmp_path, given, command, cases)


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_every_call_fails_in_turn(shim: Path, tmp_path: Path, given: Path, command: str) -> None:
    """All n up to 200 and 20 beyond, as far as there are so many; 20 where a case takes seconds."""
    draw = Random(command)
    numbers = [*range(1, 201), *(draw.randrange(201, 2000) for _ in range(20))]
    if command in PROCESSES:
        numbers = [*range(1, 10), *(draw.randrange(10, 200) for _ in range(11))]
    cases = [(n, draw.choice((errno.ENOSPC, errno.EIO)), draw.random() < 0.5) for n in numbers]
    assert not failures(shim, tmp_path, given, command, cases)


def test_a_cache_that_cannot_be_written_is_gone_around(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Home and cache are no folders here; FMUs are unpacked where temporary files are."""
    (tmp_path / "file").write_text("")
    (tmp_path / "tmp").mkdir()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setenv("HOME", str(tmp_path / "file"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    done = finished(
        "run", CONFIG, "--no-plot", "--set", "run.stop=1", "--out", "here", cwd=tmp_path
    )
    assert done.code == 0, done
    assert list((tmp_path / "tmp").glob("cosim-*/unpacked/*"))
