from __future__ import annotations

import pytest

from cosim.engine import simulate as simulation
from tests.cosim.checkpoint.cuts import CHUNK


@pytest.fixture(autouse=True)
def short_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation, "CHUNK_TICKS", CHUNK)
