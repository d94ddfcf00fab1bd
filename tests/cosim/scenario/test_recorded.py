"""A run over the links of another: its tables in place of laws."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import RunError, ScenarioError
from cosim.engine.simulate import simulate
from cosim.links.storage import load_table
from cosim.loading.files import load
from cosim.record import Run
from cosim.scenario.assemble import assemble
from cosim.scenario.recorded import with_recorded_links

CONFIG = Path(__file__).parents[3] / "configs" / "teleoperation.toml"
LOSS = [f'links.{i}.loss={{law="independent", p=0.2}}' for i in (0, 1)]
LATE = [f'links.{i}.semantics="newest-stamp"' for i in (0, 1)]
QUEUE = [
    f"links.{i}.{key}"
    for i in (0, 1)
    for key in ('semantics="queue"', "depth=40", 'drop="newest"', 'take="all"')
]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 3 s whose links lose packets."""
    folder = tmp_path_factory.mktemp("run") / "run"
    simulate(load(CONFIG, ["run.stop=3", "run.seed=7", *LATE, *LOSS]), folder)
    return folder


def signals(folder: Path) -> np.ndarray:
    found = Run.open(folder)
    return np.stack([found.column(name) for name in found.names])


def test_the_same_scenario_over_the_same_tables_is_the_same_run(run: Path, tmp_path: Path):
    scenario = load(CONFIG, ["run.stop=3"])  # another seed, another law, nothing lost
    simulate(scenario, tmp_path / "again", plan=with_recorded_links(assemble(scenario), run))
    assert np.array_equal(signals(tmp_path / "again"), signals(run))
    for name, path in Run.open(run).link_tables.items():
        found = load_table(Run.open(tmp_path / "again").link_tables[name])[1]
        assert np.array_equal(found, load_table(path)[1])


def test_another_controller_hears_the_same_network(run: Path, tmp_path: Path):
    scenario = load(CONFIG, ["run.stop=2", "components.master_control.parameters.lambda_M=1"])
    found = simulate(
        scenario, tmp_path / "other", plan=with_recorded_links(assemble(scenario), run)
    )
    assert not np.array_equal(signals(tmp_path / "other"), signals(run)[:, :2001])
    recorded = load(CONFIG, ["run.stop=2", "run.seed=7", *LATE, *LOSS])
    assert found.ages == simulate(recorded, tmp_path / "short").ages


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["run.stop=4"], r"the table ends at 3 s, the run at 4 s; expected a run\.stop"),
        (["run.stop=2", 'run.step="5 ms"'], "stored for periods of 5 and 5 ticks of 0.001 s"),
        (
            ["run.stop=2", 'links.0.name="x"'],
            "no table of the link 'x' in this run; it has: master_control",
        ),
    ],
)
def test_tables_that_do_not_fit(settings: list[str], said: str, run: Path):
    with pytest.raises(ScenarioError, match=said):
        with_recorded_links(assemble(load(CONFIG, settings)), run)


def test_a_folder_that_is_not_there(tmp_path: Path):
    with pytest.raises(ScenarioError, match="there is no such run folder"):
        with_recorded_links(assemble(load(CONFIG)), tmp_path / "none")


@pytest.mark.parametrize("rule", [LATE, QUEUE], ids=["newest-stamp", "queue"])
def test_the_tables_of_a_run_that_stopped_are_continued_to_its_end(rule: list[str], tmp_path: Path):
    """They are drawn for some ticks at a time, of a run that diverges at 0.8 s up to 16.384 s."""
    grip = [f"components.master.parameters.{k}={v}" for k, v in (("k_p", 400), ("k_d", 20))]
    own = ["run.stop=20", "run.seed=7", *rule, *LOSS]
    with pytest.raises(RunError):
        simulate(load(CONFIG, [*own, *grip]), tmp_path / "stopped")
    scenario = load(CONFIG, ["run.stop=20"])
    simulate(
        scenario,
        tmp_path / "on",
        plan=with_recorded_links(assemble(scenario), tmp_path / "stopped"),
    )
    simulate(load(CONFIG, own), tmp_path / "whole")
    for name, path in Run.open(tmp_path / "whole").link_tables.items():
        found = load_table(Run.open(tmp_path / "on").link_tables[name])[1]
        assert np.array_equal(found, load_table(path)[1])
    with pytest.raises(ScenarioError, match=r"expected a run\.stop that is no later"):
        with_recorded_links(assemble(load(CONFIG, ["run.stop=21"])), tmp_path / "stopped")
