"""Each scenario of ``configs`` and ``examples`` is resumed to the same bytes, or refused before."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from cosim.base.errors import ScenarioError
from cosim.checkpoint import CheckpointInterval, CheckpointKeeper
from cosim.engine.simulate import Execution, simulate
from cosim.loading.files import load
from cosim.scenario.assemble import assemble
from tests.bridge.zenoh.rehearsed import CONFIGS
from tests.cosim.checkpoint.cuts import same_after_cuts
from tests.tiers import first_fast

ROOT = CONFIGS.parent
#: Tables that other files have beside components.
_OTHERS = {"extends", "nodes", "variants", "sweep", "scenario"}
#: What cannot be saved, with the sentence.
REFUSED = {"examples/own_controller/scenario.toml": "control has no get_state and no set_state"}


def is_scenario(path: Path) -> bool:
    document = tomllib.loads(path.read_text(encoding="utf-8"))
    return "components" in document and not _OTHERS & document.keys()


SCENARIOS = sorted(
    str(path.relative_to(ROOT))
    for folder in ("configs", "examples")
    for path in (ROOT / folder).rglob("*.toml")
    if is_scenario(path)
)


@pytest.mark.parametrize("name", first_fast([x for x in SCENARIOS if x not in REFUSED], 3))
def test_it_is_resumed_to_the_same_bytes(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = ROOT / name
    if "mujoco" in path.read_text(encoding="utf-8"):
        pytest.importorskip("mujoco")
    if "onnx" in path.read_text(encoding="utf-8"):
        pytest.importorskip("onnxruntime")
    monkeypatch.syspath_prepend(str(path.parent))
    whole = assemble(load(path))
    stop = whole.h * min(whole.ticks, 1000)
    same_after_cuts(tmp_path, lambda: load(path, [f"run.stop={stop!r}"]), cuts=2)


@pytest.mark.parametrize("name", REFUSED)
def test_it_is_refused_before_the_run(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str((ROOT / name).parent))
    execution = Execution(1, CheckpointKeeper(CheckpointInterval(0.0), {}))
    with pytest.raises(ScenarioError, match=REFUSED[name]):
        simulate(load(ROOT / name), tmp_path / "run", execution=execution)
    assert not (tmp_path / "run").exists()


def test_these_are_all_scenarios() -> None:
    assert len(SCENARIOS) >= 17 and REFUSED.keys() <= set(SCENARIOS)
