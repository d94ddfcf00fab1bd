"""Recordings with small row groups, and runs that are read in pieces although they are short."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.record import groups, run
from tests.system.runs import ROOT


def recorded(folder: Path, name: str, stop: str) -> Path:
    """A recording of a scenario of ``configs/`` in row groups of 1024 rows."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(groups, "_GROUP_MOST", 1024)
        simulate(load(ROOT / "configs" / f"{name}.toml", [f"run.stop={stop}"]), folder / name)
    return folder / name


def read_in_pieces(monkeypatch: pytest.MonkeyPatch, values: int = 1) -> None:
    """Let every run be read in pieces of about so many values."""
    monkeypatch.setattr(run, "PIECE", values)
