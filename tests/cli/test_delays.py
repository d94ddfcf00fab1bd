"""``cosim delays`` as a user runs it."""

from __future__ import annotations

from pathlib import Path

from cosim.links.frozen import TRACES
from cosim.links.presets import PRESETS
from tests.cli.command import Command


def test_it_lists_every_preset_and_trace_with_source_and_sum(cosim: Command) -> None:
    said = cosim("delays").out
    for name, found in PRESETS.items():
        assert f"  {name} " in said and found.source in said
    for name, trace in TRACES.items():
        assert f"  {name} " in said and trace.sha256[:16] in said


def test_it_describes_one_and_refuses_what_is_not_there(cosim: Command) -> None:
    said = cosim("delays", "geo").out
    assert "constructed from" in said and "gilbert-elliott" in said
    assert TRACES["geo-up"].sha256 in cosim("delays", "geo-up").out
    assert "did you mean 'wifi6'" in cosim.refused("delays", "wify6")


def test_it_verifies_and_writes_the_traces(cosim: Command, tmp_path: Path) -> None:
    assert "16 traces have their SHA-256 sums" in cosim("delays", "--verify").out
    cosim("delays", "--write", tmp_path / "traces")
    assert len(list((tmp_path / "traces").glob("*.csv"))) == 16
