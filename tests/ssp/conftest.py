"""Tests with Ecos are left out where its libtbb12 is not installed, as in tests/system."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.system.conftest import pytest_collection_modifyitems, pytest_configure

__all__ = ["pytest_collection_modifyitems", "pytest_configure"]


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Systems of tests are not kept."""
    monkeypatch.setattr("cosim.base.archive.cache_folder", lambda: tmp_path / "cache")
