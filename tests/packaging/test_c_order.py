"""No C file calls one that calls it back, directly or by way of others, in any folder."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from fmus.build.toolchain import FLAGS, compiler
from tests.c_order import ROOT, calls, includes, ordered

LIBRARIES = {
    "bridge": ("bridge/c", "bridge/c/portable", "bridge/c/lsbus"),
    "engine": ("cosim/c", "cosim/c/engine"),
    "simulated bus": ("cosim/c/bus",),
    "preloaded": ("bridge/c/preload",),
    "models": ("fmus/c",),
    "network FMUs": ("fmus/c/lsbus", "fmus/c/lsbus/bus"),
}
#: Put before libc's own functions by the loader, and the units of the engine once more.
APART = {"xstate.c", "engine.c"}
UNITS = ROOT / "cosim/c/engine"


def files(library: str, pattern: str) -> tuple[Path, ...]:
    found = (p for folder in LIBRARIES[library] for p in sorted((ROOT / folder).glob(pattern)))
    return tuple(path for path in found if path.name not in APART)


@pytest.mark.parametrize("library", LIBRARIES)
def test_no_file_calls_one_that_calls_it_back(library: str) -> None:
    graph = calls(files(library, "*.c"))
    assert any(graph.values())
    ordered(graph)


@pytest.mark.parametrize("library", LIBRARIES)
def test_includes_of_headers_go_one_way(library: str) -> None:
    ordered(includes(files(library, "*.h")))


def test_the_engine_lists_its_units_from_below() -> None:
    whole = (ROOT / "cosim/c/engine.c").read_text(encoding="utf-8")
    listed = [UNITS / name for name in re.findall(r'#include "engine/(\w+\.c)"', whole)]
    assert sorted(listed) == sorted(UNITS.glob("*.c"))
    for path, below in calls(tuple(listed)).items():
        assert all(listed.index(other) < listed.index(path) for other in below)


def test_each_unit_of_the_engine_compiles_by_itself() -> None:
    command = [*compiler(), *FLAGS, "-Wall", "-Wextra", "-Werror", "-fsyntax-only"]
    command += [f"-I{UNITS.parent}", *map(str, sorted(UNITS.glob("*.c")))]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
