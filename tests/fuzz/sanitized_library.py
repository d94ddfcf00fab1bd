"""A pytest plug-in: the module SANITIZED_STRUCTS takes its library from SANITIZED_LIBRARY."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path

structs = import_module(os.environ["SANITIZED_STRUCTS"])
structs.library_path = lambda: Path(os.environ["SANITIZED_LIBRARY"])
