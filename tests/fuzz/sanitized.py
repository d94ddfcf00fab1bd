"""The C of the bridge under AddressSanitizer and UndefinedBehaviorSanitizer, in a child process.

The library is compiled once per content of the sources, and loaded by a child process in place of
the ordinary one: tables, buses and whole nodes are those that Python makes of the shipped files.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.fuzz.targets import ROOT

TARGETS = ("decode", "hear")
FLAGS = (
    "-std=c99", "-O1", "-g1", "-fno-omit-frame-pointer", "-ffp-contract=off", "-shared", "-fPIC",
    "-fsanitize=address,undefined", "-fno-sanitize-recover=all",
)  # fmt: skip


def missing() -> str:
    """Why it cannot be done here; "": it can."""
    if sys.platform != "linux":
        return "the sanitizers are preloaded, which needs Linux"
    return "" if shutil.which("gcc") else "no gcc, whose sanitizers are preloaded into Python"


def library() -> Path:
    """The library, compiled where the sources are not those of last time."""
    folders = (ROOT / "bridge" / "c", ROOT / "cosim" / "c")
    length = ROOT / "cosim" / "c" / "bus" / "length.c"
    sources = sorted([*folders[0].glob("*.c"), length])
    headers = sorted(p for folder in (*folders, length.parent) for p in folder.glob("*.h"))
    parts = [p.read_bytes() for p in (*sources, *headers)] + [" ".join(FLAGS).encode()]
    digest = hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]
    output = Path(tempfile.gettempdir()) / f"cosim-fuzz-{os.getuid()}" / f"{digest}.so"
    if output.is_file():
        return output
    output.parent.mkdir(mode=0o700, exist_ok=True)
    scratch = output.with_suffix(f".{os.getpid()}")
    include = [f"-I{folder}" for folder in folders]
    command = ["gcc", *FLAGS, *include, "-o", str(scratch), *map(str, sources), "-lm"]
    subprocess.run(command, check=True)
    scratch.replace(output)
    return output


def preloaded() -> dict[str, str]:
    """The environment of a Python that loads a library with sanitizers."""
    runtimes = [
        subprocess.check_output(["gcc", f"-print-file-name={name}"], text=True).strip()
        for name in ("libasan.so", "libubsan.so")
    ]
    return {
        "LD_PRELOAD": " ".join(runtimes),
        "ASAN_OPTIONS": "detect_leaks=0:abort_on_error=0:exitcode=86",
        "UBSAN_OPTIONS": "print_stacktrace=1:exitcode=86",
        "PYTHONMALLOC": "malloc",  # so that every object has its own bounds
        "PYTHONPATH": str(ROOT),
    }


def command(target: str, seed: int, count: int, seconds: float) -> tuple[list[str], dict[str, str]]:
    """What runs a target, and its environment. `count` mutants, or `seconds` where that is > 0."""
    words = [sys.executable, "-m", "tests.fuzz.frames", target, str(library())]
    return [*words, str(seed), str(count), str(seconds)], {**os.environ, **preloaded()}
