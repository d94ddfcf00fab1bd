"""The C layer and the kernels under the sanitizers, driven by an importer in C (host.c)."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from fmus.build.source import sources, units
from fmus.model import Model, clocked
from fmus.models import arm, planar2r, teleoperation, xi

HOST = Path(__file__).with_name("host.c")
WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Werror")
FLAGS = ("-std=c99", "-O1", "-g", "-fno-omit-frame-pointer", "-ffp-contract=off", *WARNINGS)


@cache
def sanitized() -> tuple[str, ...]:
    """A compiler with its strongest sanitizers: the host's with ASan, or zig's with UBSan."""
    gcc = shutil.which("gcc") or shutil.which("clang")
    if gcc is not None:
        both = (gcc, "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
        check = subprocess.run(
            [*both, "-x", "c", "-", "-o", os.devnull],
            input="int main(void) { return 0; }",
            text=True,
            capture_output=True,
        )
        if check.returncode == 0:
            return both
    # -fno-sanitize-recover: trap, since zig ships no UBSan runtime for every target
    return (sys.executable, "-m", "ziglang", "cc", "-fsanitize=undefined", "-fsanitize-trap=all")


MODELS = (planar2r.model(), teleoperation.model(2), clocked(xi.model(), 1e-3), arm.model())


@pytest.fixture(scope="module")
def objects(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of objects: what models share is compiled once."""
    return tmp_path_factory.mktemp("objects")


def compiled(unit: dict[str, str], objects: Path) -> str:
    """The object of a C file, the first of `unit`, and the headers that it includes."""
    folder = objects / hashlib.sha256(json.dumps(unit).encode()).hexdigest()
    source = folder / next(iter(unit))
    if not folder.exists():
        folder.mkdir()
        for name, text in unit.items():
            (folder / name).write_text(text)
        run([*sanitized(), *FLAGS, "-c", "-o", str(source.with_suffix(".o")), str(source)])
    return str(source.with_suffix(".o"))


def run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "model",
    MODELS,
    ids=lambda model: model.identifier,
)
def test_both_apis_are_clean_under_the_sanitizers(
    model: Model, objects: Path, tmp_path: Path
) -> None:
    for name, text in sources(model).items():
        (tmp_path / name).write_text(text)
    host = tmp_path / "host"
    files = [compiled(unit, objects) for unit in units(model)]
    run([*sanitized(), *FLAGS, f"-I{tmp_path}", "-o", str(host), str(HOST), *files, "-lm"])
    options = {"ASAN_OPTIONS": "detect_leaks=1", "UBSAN_OPTIONS": "print_stacktrace=1"}
    done = subprocess.run(
        [str(host)], capture_output=True, text=True, env={**os.environ, **options}
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
