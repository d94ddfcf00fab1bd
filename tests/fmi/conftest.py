"""Tests with Ecos are left out where its libtbb12 is not installed, as in tests/system."""

from __future__ import annotations

from tests.system.conftest import pytest_collection_modifyitems, pytest_configure

__all__ = ["pytest_collection_modifyitems", "pytest_configure"]
