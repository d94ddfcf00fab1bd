"""The two files of uPlot (MIT licence) that reports contain, from the wheel of ``uplot-python``.

Only these files are taken. To install that package would bring its requirements as well, IPython
among them, which takes longer than anything else before the compiler begins.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import zipfile
from importlib.util import find_spec
from pathlib import Path

UPLOT = "uplot-python>=1.1"
FOLDER = Path(__file__).resolve().parent.parent / "cosim" / "reporting" / "assets"
NAMES = ("uPlot.iife.js", "uPlot.min.css")


def take() -> list[Path]:
    """Write the files if they are not there; those written. Raises ModuleNotFoundError."""
    if all((FOLDER / name).is_file() for name in NAMES):
        return []
    contents = _installed() or _downloaded()
    if not contents:
        raise ModuleNotFoundError(f"no {', '.join(NAMES)}: pip install '{UPLOT}'")
    for name, content in contents.items():
        (FOLDER / name).write_bytes(content)
    return [FOLDER / name for name in contents]


def requirements() -> list[str]:
    """``uplot-python``, if the files are not there and cannot be taken from its wheel alone."""
    try:
        take()
    except ModuleNotFoundError:
        return [UPLOT]
    return []


def _installed() -> dict[str, bytes]:
    """The files of an installed ``uplot-python``, which is not imported; empty without it."""
    spec = find_spec("uplot")
    if spec is None or spec.origin is None:
        return {}
    static = Path(spec.origin).parent / "static"
    return {name: (static / name).read_bytes() for name in NAMES}


def _downloaded() -> dict[str, bytes]:
    """The files from a wheel that pip downloads; empty without pip or without a network.

    ``-I``: a front end hides the pip of the environment behind ``PYTHONPATH``.
    """
    with tempfile.TemporaryDirectory(prefix="uplot-") as folder:
        call = [sys.executable, "-I", "-m", "pip", "download", "-q", "--no-deps", "-d", folder]
        done = subprocess.run([*call, UPLOT], capture_output=True, check=False)
        wheels = list(Path(folder).glob("*.whl"))
        if done.returncode or not wheels:
            return {}
        with zipfile.ZipFile(wheels[0]) as wheel:
            return {name: wheel.read(f"uplot/static/{name}") for name in NAMES}
