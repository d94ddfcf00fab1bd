"""Nodes of a deployment as they are wired, before anything runs."""

from __future__ import annotations

import pytest

from tests.bridge.slots import Slots


@pytest.fixture
def wired(tmp_path):
    """A node of a system, by its name, with buses of its own."""
    made = []

    def call(system, name):
        folder = tmp_path / f"{name}{len(made)}"
        folder.mkdir()
        made.append(Slots(system, name, folder))
        return made[-1].wired

    yield call
    for slots in made:
        slots.wired.__exit__()
