"""Write the tables of ``cosim compare``: ``python docs/evidence/compare_tables.py``.

A table stands between ``<!-- table: COMMAND -->`` and ``<!-- end -->``; the command is run in the
checkout, on two processes, and takes some seconds.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[2]
PAGE = Path(__file__).with_name("controllers.md")
_TABLE = re.compile(r"(<!-- table: (.*) -->\n)(?:.*\n\n)?(?:\|.*\n)*(<!-- end -->)")


def table(command: str) -> str:
    """The command as text, and the rows that it writes."""
    with TemporaryDirectory() as folder:
        out = Path(folder, "table")
        words = [*shlex.split(command)[1:], "--no-plot", "--quiet", "--jobs", "2", "--out", out]
        call = [sys.executable, "-c", "from cosim.cli import main; main()", *map(str, words)]
        done = subprocess.run(call, cwd=ROOT, stdout=subprocess.DEVNULL)
        if done.returncode not in (0, 1):  # 1: a combination failed, as the table says
            sys.exit(f"{command}: exit code {done.returncode}")
        lines = (out / "table.md").read_text(encoding="utf-8").splitlines(keepends=True)
    return f"`{command}`\n\n" + "".join(x for x in lines if x.startswith("|"))


def main() -> None:
    """Replace the tables of the page."""
    text = PAGE.read_text(encoding="utf-8")
    new = _TABLE.sub(lambda found: found[1] + table(found[2]) + found[3], text)
    PAGE.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()
