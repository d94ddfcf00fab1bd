"""Each C file of the bridge has a header with its interface, and a torque passes each file on its
way once.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.c_order import ROOT, calls, includes, offered, ordered, source

FOLDER = ROOT / "bridge/c"
#: Put before libc's own function by the loader; nobody here calls it.
APART = {"xstate"}
FILES = tuple(path for path in sorted(FOLDER.glob("*.c")) if path.stem not in APART)
#: The way of a torque: outlet, guard, codec, protection, bus; then receiver, delay line, drive.
OUT = ("outlet", "guard", "message", "e2e", "crc", "send", "bus", "bus_socket")
IN = ("dispatch", "reception", "limit", "receiver", "sample_journal", "delay", "inlet", "drive")


def called(stem: str) -> set[str]:
    """The files whose functions a file names."""
    return {path.stem for path in calls(FILES)[FOLDER / f"{stem}.c"]}


def test_the_order_is_that_of_a_slot() -> None:
    order = [path.stem for path in ordered(calls(FILES))]
    assert len(order) == len(FILES) > 35
    assert order.index("dispatch") < order.index("slot") < order.index("wall_clock")


@pytest.mark.parametrize("file", FILES, ids=lambda path: path.stem)
def test_a_file_has_a_header_of_what_it_offers(file: Path) -> None:
    header = file.with_suffix(".h")
    assert header in includes((file, header))[file]
    words = set(re.findall(r"\b(\w+)\(", source(header)))
    assert {name for name, home in offered(FILES).items() if home == file} <= words
    there = {name: home for name, home in offered(FILES).items() if home != file}
    assert not {n for n in re.findall(r"\b(\w+)\([^)]*\);", source(header)) if n in there}


@pytest.mark.parametrize(
    ("above", "below"),
    [
        ("outlet", "guard"), ("outlet", "message"), ("message", "e2e"), ("e2e", "crc"),
        ("outlet", "send"), ("send", "bus"), ("bus", "bus_socket"), ("dispatch", "bus"),
        ("dispatch", "reception"), ("reception", "message"), ("reception", "limit"),
        ("reception", "receiver"), ("reception", "delay"), ("inlet", "delay"), ("inlet", "drive"),
    ],
)  # fmt: skip
def test_a_torque_goes_from_file_to_file(above: str, below: str) -> None:
    assert below in called(above)


def test_the_design_page_walks_them_in_this_order() -> None:
    page = (ROOT / "docs/design.md").read_text(encoding="utf-8")
    walk = page[page.index("**A torque on its way in a rehearsal**") :].split("\n\n")[0]
    named = [n for n in re.findall(r"`(\w+)\.c`", walk) if n in OUT + IN]
    assert list(dict.fromkeys(named)) == [*OUT, *IN]
    assert len(named) == len(OUT + IN) + 1  # the codec works at both ends
