"""Ecos' library is for x86-64 and needs libtbb12 (Debian): left out where that is not installed."""

from __future__ import annotations

import ctypes
import platform

import pytest

MARKER = "needs_tbb"
_TBB = "libtbb.so.12"


def _there() -> bool:
    try:
        ctypes.CDLL(_TBB)
    except OSError:
        return False
    return platform.machine() == "x86_64"


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", f"{MARKER}: needs {_TBB} (Debian: libtbb12) and ecospy")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    left_out = [] if _there() else [i for i in items if i.get_closest_marker(MARKER)]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [i for i in items if i not in left_out]
