"""The n-th call of the system on a run folder fails: complete, or a sentence and all data."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from random import Random
from shutil import rmtree
from typing import Any

import numpy as np
import pytest

from cosim.record import Run, verify
from fmus.toolchain import compiler
from tests.cli.command import CONFIG, ROOT, finished

COMMANDS: dict[str, Sequence[str]] = {
    "run": ("run", str(CONFIG), "--quiet", "--no-plot", "--set", "run.stop=2"),
    "twin": ("run", str(CONFIG), "--deploy", "can", "--quiet", "--no-plot", "--set", "run.stop=1"),
    "sweep": (
        "sweep", "{root}/study.toml", "--quiet", "--no-plot", "--workers", "threads", "--jobs", "1",
    ),
}  # fmt: skip
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


def outcomes(
    shim: Path, folder: Path, command: str, cases: Sequence[tuple[int, int, bool]]
) -> Iterator[tuple[tuple[int, int, bool], Path, dict[str, Any]]]:
    """(at, errno, whether it stays so) -> the folder and what came of it."""
    with subprocess.Popen(
        [sys.executable, "-m", "tests.cli.failing"],
        cwd=ROOT, env=os.environ | {"LD_PRELOAD": str(shim), "PYTHONPATH": str(ROOT)},
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as program:  # fmt: skip
        assert program.stdin is not None and program.stdout is not None
        for i, (at, number, keep) in enumerate(cases):
            root = folder / f"{i}"
            if command == "sweep":
                (folder / "study.toml").write_text(STUDY.format(CONFIG))
            arguments = [a.format(root=folder) for a in COMMANDS[command]]
            case = {
                "at": at, "errno": number, "keep": keep, "root": f"{root}/",
                "arguments": [*arguments, "--out", str(root / "here")],
            }  # fmt: skip
            program.stdin.write(json.dumps(case) + "\n")
            program.stdin.flush()
            yield (at, number, keep), root / "here", json.loads(program.stdout.readline())
            rmtree(root)


def judge(here: Path, found: dict[str, Any], name: str) -> None:
    """Complete, or one sentence and readable up to then."""
    said = [line for line in found["said"].splitlines() if not line.startswith("check: ")]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if found["code"] == 0:
            verify(here)
            assert name == "sweep" or len(Run.open(here)) in (1001, 2001)
            return
        assert found["code"] in (1, 2), found
        assert said and said[0].startswith(("error: ", "interrupted")), found
        assert not any("Traceback" in line for line in said), found
        for folder in (here, *here.glob("runs/*")) if here.exists() else ():
            if any((folder / f).exists() for f in ("trajectories.parquet", "trajectories.live")):
                run = Run.open(folder)
                assert np.array_equal(run.t, np.arange(len(run)) * 1e-3)


@pytest.mark.parametrize("command", ["run"])
def test_some_calls_fail(shim: Path, tmp_path: Path, command: str) -> None:
    cases = [(n, errno.ENOSPC, False) for n in (1, 5, 12, 40)]
    cases += [(8, errno.ENOSPC, True), (60, errno.ENOSPC, True), (3, errno.EIO, False)]
    failed = 0
    for _, here, found in outcomes(shim, tmp_path, command, cases):
        judge(here, found, command)
        failed += found["code"] != 0
    assert failed >= 5


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_every_call_fails_in_turn(shim: Path, tmp_path: Path, command: str) -> None:
    draw = Random(command)
    numbers = [*range(1, 201), *(draw.randrange(201, 2000) for _ in range(20))]
    cases = [(n, draw.choice((errno.ENOSPC, errno.EIO)), draw.random() < 0.5) for n in numbers]
    for case, here, found in outcomes(shim, tmp_path, command, cases):
        try:
            judge(here, found, command)
        except Exception as error:
            raise AssertionError(f"{case}: {error}") from error


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
