"""Measure the table of ``peers.md`` anew: ``python docs/evidence/peers.py`` in the checkout.

It takes three minutes, and needs the extra `test` and Debian's libtbb12 (for Ecos).
"""

from __future__ import annotations

import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = Path(__file__).with_name("peers.md")
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from tests.fmi.abilities import ABILITIES, Ability  # noqa: E402
from tests.fmi.peers import PEERS  # noqa: E402

BEGIN, END = "<!-- measured by docs/evidence/peers.py -->\n", "<!-- end -->\n"


def row(ability: Ability) -> str:
    """A row of the table, each cell that can be measured measured."""
    cells = []
    for peer in PEERS:
        with tempfile.TemporaryDirectory(prefix="peers-") as folder:
            cells.append(ability.probe(peer, Path(folder)))
    read = [f"*{cell}*" if cell else "" for cell in ability.read]
    test = f"[{ability.test.rpartition('/')[2]}](../../{ability.test})"
    return f"| {ability.title} | {' | '.join([*cells, *read, test])} |\n"


def head() -> str:
    """The first lines of the table, with the versions that were measured."""
    versions = {"FMPy": "fmpy", "libcosim": "libcosimpy", "Ecos": "ecospy"}
    names = ["this project", *(f"{k} ({v} {version(v)})" for k, v in versions.items())]
    columns = ["", *names, "OMSimulator 3", "MasterSim 0.9.8", "our test"]
    return f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|\n"


def main() -> None:
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    table = head() + "".join(row(ability) for ability in ABILITIES)
    PAGE.write_text(before + BEGIN + table + END + rest.split(END)[1], encoding="utf-8")
    print(PAGE.relative_to(ROOT))


if __name__ == "__main__":
    main()
