"""A page computes what the command line does, to the last bit."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.engine.simulate import simulate
from cosim.live import bundle, digest
from cosim.loading.files import load
from cosim.record import Run
from tests.cosim.live.node import computed

CONFIGS = Path(__file__).parents[3] / "configs"


def native(path: Path, folder: Path, *settings: str) -> str:
    """The digest of a run by the command line's engine."""
    simulate(load(path, settings), folder)
    return digest(Run.open(folder))


@pytest.mark.parametrize(
    ("name", "settings"),
    [("teleoperation", ["run.stop=3"]), ("teleoperation", ["run.stop=1.0005", "run.step=0.0005"]),
     ("teaching", ["run.stop=1"]), ("openarm", ["run.stop=0.2"]),
     ("teleoperation", ["run.stop=1", "run.record.every=7"])],
)  # fmt: skip
def test_a_page_has_the_digest_of_the_command_line(name, settings, tmp_path):
    path = CONFIGS / f"{name}.toml"
    (found,) = computed(bundle(load(path, settings)), [{}])
    assert found["digest"] == native(path, tmp_path / "run", *settings)
    assert found["failure"] is None


def test_a_second_run_in_a_page_has_the_same_bits(tmp_path):
    first, second = computed(bundle(load(CONFIGS / "teleoperation.toml", ["run.stop=1"])), [{}, {}])
    assert first["digest"] == second["digest"]
