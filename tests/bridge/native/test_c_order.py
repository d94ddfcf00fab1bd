"""The C files of the bridge have an order: no file calls one that depends on it.

Each has a header with its interface, and a torque passes each file on its way once.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
FOLDER = ROOT / "bridge/c"
#: Put before libc's own function by the loader; nobody here calls it.
APART = {"xstate"}
FILES = sorted(path.stem for path in FOLDER.glob("*.c") if path.stem not in APART)
DEFINED = re.compile(r"^(?!static|typedef|enum|#)[A-Za-z][^\n;{}=]*?\b(\w+)\([^;{}]*?\)\n\{", re.M)
#: The way of a torque: outlet, guard, codec, protection, bus; then receiver, delay line, drive.
OUT = ("outlet", "guard", "message", "e2e", "crc", "send", "bus", "bus_socket")
IN = ("dispatch", "reception", "limit", "receiver", "sample_journal", "delay", "inlet", "drive")


def source(name: str) -> str:
    """A file without its comments."""
    text = (FOLDER / name).read_text(encoding="utf-8")
    return re.sub(r"/\*.*?\*/", " ", text, flags=re.S)


@cache
def offered() -> dict[str, str]:
    """The file of each function that a file offers to others."""
    return {name: stem for stem in FILES for name in DEFINED.findall(source(f"{stem}.c"))}


@cache
def calls() -> dict[str, set[str]]:
    """The files whose functions each file names."""
    found = {}
    for stem in FILES:
        words = set(re.findall(r"\b\w+\b", source(f"{stem}.c")))
        found[stem] = {home for name, home in offered().items() if name in words} - {stem}
    return found


def included(name: str) -> set[str]:
    return {n for n in re.findall(r'#include "(\w+\.h)"', source(name)) if (FOLDER / n).is_file()}


def ordered(graph: Mapping[str, set[str]]) -> list[str]:
    """From the bottom up. Raises graphlib.CycleError, which names the circle."""
    return list(TopologicalSorter(graph).static_order())


def test_no_file_calls_one_that_calls_it_back() -> None:
    order = ordered(calls())
    assert len(order) == len(FILES) > 35
    assert order.index("dispatch") < order.index("slot") < order.index("wall_clock")


def test_includes_go_one_way() -> None:
    ordered({path.name: included(path.name) for path in FOLDER.glob("*.h")})


@pytest.mark.parametrize("stem", FILES)
def test_a_file_has_a_header_of_what_it_offers(stem: str) -> None:
    assert f"{stem}.h" in included(f"{stem}.c")
    words = set(re.findall(r"\b(\w+)\(", source(f"{stem}.h")))
    assert {name for name, home in offered().items() if home == stem} <= words
    there = {name: home for name, home in offered().items() if home != stem}
    assert not {n for n in re.findall(r"\b(\w+)\([^)]*\);", source(f"{stem}.h")) if n in there}


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
    assert below in calls()[above]


def test_the_design_page_walks_them_in_this_order() -> None:
    page = (ROOT / "docs/design.md").read_text(encoding="utf-8")
    walk = page[page.index("**A torque on its way in a rehearsal**") :].split("\n\n")[0]
    named = [n for n in re.findall(r"`(\w+)\.c`", walk) if n in OUT + IN]
    assert list(dict.fromkeys(named)) == [*OUT, *IN]
    assert len(named) == len(OUT + IN) + 1  # the codec works at both ends
