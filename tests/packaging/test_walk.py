"""A command enters few of our files: a newcomer who follows it has little to open."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
#: Files that the README's first command enters, also those that it only imports.
MOST = 141
#: Prints the files below the folder given first that the command of the other arguments enters.
PROGRAM = """
import sys
root, entered = sys.argv[1], set()
def note(frame, event, _):
    name = frame.f_code.co_filename
    if name.startswith(root) and "/.venv/" not in name:
        entered.add(name[len(root):])
sys.argv = ["cosim", *sys.argv[2:]]
{before}
sys.setprofile(note)
try:
    {call}
except SystemExit as end:
    assert not end.code, end.code
sys.setprofile(None)
print("entered", *sorted(entered), sep="\\n")
"""


def entered(program: str, *command: str) -> list[str]:
    """The files of ours that a command enters."""
    call = [sys.executable, "-c", program, f"{ROOT}/", *command]
    done = subprocess.run(call, cwd=ROOT, check=True, capture_output=True, text=True)
    return done.stdout.partition("entered\n")[2].split()


def test_the_first_run_of_the_readme_enters_few_files(tmp_path: Path) -> None:
    program = PROGRAM.format(before="from cosim.cli.commands import command", call="command()")
    words = ("run", "configs/teleoperation.toml", "--stop", "0.1", "--no-plot", "-q", "--out")
    files = entered(program, *words, str(tmp_path / "run"))
    assert "cosim/engine/simulate.py" in files
    assert "fmus/build/source.py" not in files, "FMUs are older than their sources: build them"
    assert len(files) <= MOST, "\n".join(files)


def test_the_help_enters_three_files() -> None:
    program = PROGRAM.format(before="", call="from cosim.cli import main; main()")
    files = ["cosim/__init__.py", "cosim/cli/__init__.py", "cosim/cli/overview.py"]
    assert entered(program, "--help") == files
