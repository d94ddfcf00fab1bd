"""Our C under AddressSanitizer and UndefinedBehaviorSanitizer, in a child process.

The library is loaded by a child process in place of the ordinary one: tables, buses and whole nodes
are those that Python makes of the shipped files. That of the bridge, which is fuzzed, is compiled
once per content of the sources; with those of the engine and of the simulated bus, tests run again.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.fuzz.targets import ROOT

TARGETS = ("decode", "hear")
FLAGS = (
    "-std=c99", "-O1", "-g1", "-fno-omit-frame-pointer", "-ffp-contract=off", "-shared", "-fPIC",
    "-fsanitize=address,undefined", "-fno-sanitize-recover=all",
)  # fmt: skip


def missing() -> str:
    """The reason for which it cannot be done here; "": it can."""
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
    return {  # wide zones between objects: an access a whole struct too far is seen, too
        "LD_PRELOAD": " ".join(runtimes),
        "ASAN_OPTIONS": "detect_leaks=0:abort_on_error=0:exitcode=86:redzone=512",
        "UBSAN_OPTIONS": "print_stacktrace=1:exitcode=86",
        "PYTHONMALLOC": "malloc",  # so that every object has its own bounds
        "PYTHONPATH": str(ROOT),
    }


def command(target: str, seed: int, count: int, seconds: float) -> tuple[list[str], dict[str, str]]:
    """The command for a target, and its environment: `count` mutants, or `seconds` if > 0."""
    words = [sys.executable, "-m", "tests.fuzz.frames", target, str(library())]
    return [*words, str(seed), str(count), str(seconds)], {**os.environ, **preloaded()}


def compiled(sources: Sequence[Path], folder: Path) -> Path:
    """A library of these sources; unoptimized, so that what is read and not used is seen, too."""
    made = folder / "sanitized.so"
    include = [f"-I{place}" for place in sorted({source.parent for source in sources})]
    command = ["gcc", *FLAGS, "-O0", *include, "-o", str(made), *map(str, sources), "-lm"]
    subprocess.run(command, check=True)
    return made


def failure(made: Path, structs: str, tests: Sequence[Path], folder: Path) -> str:
    """The failure of tests whose module `structs` loads this library; "": there is none.

    `folder`: for what the tests leave.
    """
    words = [sys.executable, "-m", "pytest", "-q", "-p", "tests.fuzz.sanitized_library"]
    words += ["-p", "no:cacheprovider", f"--basetemp={folder / 'inner'}", *map(str, tests)]
    words += ["--capture=sys"]  # what a sanitizer writes before it ends the process is not lost
    chosen = {"SANITIZED_MODULE": structs, "SANITIZED_LIBRARY": str(made)}
    environment = {**os.environ, **preloaded(), **chosen}
    found = subprocess.run(words, cwd=ROOT, env=environment, text=True, capture_output=True)
    said = f"exit code {found.returncode}\n{found.stdout[-4000:]}{found.stderr[-4000:]}"
    return said if found.returncode else ""
