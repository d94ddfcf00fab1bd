"""The runs that tests of the paper share."""

from __future__ import annotations

import pytest

from tests.paper.evidence import Evidence


@pytest.fixture(scope="session")
def evidence(tmp_path_factory: pytest.TempPathFactory) -> Evidence:
    """Cases of the reproduction, each run when first asked for."""
    return Evidence(tmp_path_factory.mktemp("paper"))
