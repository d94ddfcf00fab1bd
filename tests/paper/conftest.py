"""The runs that tests of the paper share."""

from __future__ import annotations

import os

import pytest

from tests.paper.evidence import Evidence


@pytest.fixture(scope="session")
def evidence(tmp_path_factory: pytest.TempPathFactory) -> Evidence:
    """Cases of the reproduction, each run when first asked for."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "paper"
    folder.mkdir(exist_ok=True)
    return Evidence(folder)
