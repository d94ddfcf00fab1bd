"""Commands whose output is closed, full, or read by nobody: no traceback; the right exit code."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.cli.overview import COMMANDS
from tests.cli.command import CALL, CONFIG

FMUS = [sys.executable, "-c", "from fmus.cli import main; main()"]
ESTOP = [sys.executable, "-m", "bridge.can.estop"]
BAD = [*CALL, "info", "none.fmu"]
#: Programs that print, each by another way: `print`, typer's help, an option, a command's own text.
PRINTING = {
    "overview": [*CALL, "--help"],
    "help": [*CALL, "info", "--help"],
    "version": [*CALL, "--version"],
    "check": [*CALL, "check", str(CONFIG)],
    "fmus": [*FMUS, "list"],
    "estop": [*ESTOP, "-i", "virtual", "-c", "a", "--seconds=0.01"],
}
full = pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")


def called(program: list[str], ways: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """The program, its streams redirected as in a shell; its output follows, if there is any."""
    return subprocess.run(
        ["sh", "-c", f'"$@" {ways}', "sh", *program],
        capture_output=True,
        text=True,
        timeout=120,
        env={k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"} | variables,
    )


@full
@pytest.mark.parametrize("name", PRINTING)
def test_a_full_output_is_an_error(name: str) -> None:
    done = called(PRINTING[name], ">/dev/full")
    assert done.stderr == "error: standard output: No space left on device\n"
    assert done.returncode == 1


@full
@pytest.mark.parametrize("name", ["overview", "version", "estop"])
def test_a_full_output_is_an_error_at_once(name: str) -> None:
    done = called(PRINTING[name], ">/dev/full", PYTHONUNBUFFERED="1")
    assert done.stderr == "error: standard output: No space left on device\n"
    assert done.returncode == 1


@pytest.mark.parametrize("name", PRINTING)
def test_a_closed_output_is_not_missed(name: str) -> None:
    done = called(PRINTING[name], "<&- >&-")
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("name", PRINTING)
def test_nobody_reads_the_output_any_more(name: str) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with open(writing, "wb") as pipe:
        done = subprocess.run(
            PRINTING[name], stdout=pipe, stderr=subprocess.PIPE, text=True, timeout=120
        )
    assert (done.returncode, done.stderr) == (1, "")


@pytest.mark.parametrize("ways", ["2>&-", ">&- 2>&-", pytest.param("2>/dev/full", marks=full)])
@pytest.mark.parametrize(("program", "code"), [(PRINTING["check"], 0), (BAD, 2)], ids=["ok", "bad"])
def test_lost_notes_do_not_change_the_exit_code(program: list[str], code: int, ways: str) -> None:
    assert called(program, ways).returncode == code


@full
def test_bad_input_is_said_where_the_output_is_full() -> None:
    done = called(BAD, ">/dev/full")
    assert (done.returncode, done.stderr) == (2, "error: none.fmu: no such file\n")


@full
def test_a_run_comes_to_its_end_where_nobody_can_be_told(tmp_path: Path) -> None:
    out = tmp_path / "run"
    short = ["run", str(CONFIG), "--set", "run.stop=0.01", "--out", str(out), "--no-plot"]
    done = called([*CALL, *short], ">&- 2>/dev/full")
    assert done.returncode == 0
    assert (out / "SHA256SUMS").exists()


def test_no_file_of_a_command_gets_the_number_of_a_closed_stream() -> None:
    """What C code prints would land in it."""
    opens = "\n".join(
        (
            "import os",
            "from cosim.base.streams import open_standard_streams",
            "open_standard_streams()",
            "found = os.open(os.devnull, os.O_RDONLY)",
            "assert found > 2, found",
            "assert all(os.get_inheritable(n) for n in range(3))",
        )
    )
    for ways in ("<&-", ">&-", "<&- >&- 2>&-"):
        done = called([sys.executable, "-c", opens], ways)
        assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("ways", [">&-", pytest.param(">/dev/full", marks=full)])
def test_help_of_every_command(name: str, ways: str) -> None:
    done = called([*CALL, name, "--help"], ways)
    assert "Traceback" not in done.stderr
    assert done.returncode == (1 if "full" in ways else 0)
