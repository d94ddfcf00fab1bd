"""The n-th call of the system on a run folder fails: complete, or a sentence and all data."""

from __future__ import annotations

import errno
import subprocess
from pathlib import Path

import pytest

from bridge.deployment.system import load_system
from bridge.replay import twin
from bridge.results.outcome import begin
from fmus.build.toolchain import compiler
from tests.cli.command import CONFIG, finished
from tests.cli.faulted import COMMANDS, Case, Faulted, every
from tests.tiers import first_fast


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


@pytest.mark.parametrize("command", first_fast(["run", "replay"]))
def test_some_calls_fail(shim: Path, tmp_path: Path, given: Path, command: str) -> None:
    some = [(n, errno.ENOSPC, False) for n in (1, 5, 12, 40)]
    some += [(8, errno.ENOSPC, True), (60, errno.ENOSPC, True), (3, errno.EIO, False)]
    cases = [Case(n, "", error, keep, "", ()) for n, error, keep in some]
    Faulted(shim, tmp_path, given, command).check(lambda calls: cases)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("command", COMMANDS)
def test_every_call_fails_in_turn(shim: Path, tmp_path: Path, given: Path, command: str) -> None:
    """All n up to 200 and 20 beyond, as far as there are so many, in each process."""
    faulted = Faulted(shim, tmp_path, given, command, programs=2)
    faulted.check(lambda calls: every(command, calls))


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
