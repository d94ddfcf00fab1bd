"""The compiled parts of a checkout, made again after a change.

``build_backend/compiled.py`` decides by contents which library is out of date, and compiles all its
files; with :func:`tests.objects.keep` only those that the change reaches.
"""

from __future__ import annotations

import runpy
from pathlib import Path


def build(root: Path) -> None:
    """Make the libraries and FMUs of the checkout `root`.

    Raises fmus.build.toolchain.ToolchainError where the compiler refuses a source.
    """
    runpy.run_path(str(root / "build_backend" / "compiled.py"))["build"]()
