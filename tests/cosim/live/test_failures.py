"""A run that has to stop in a page comes back as natively: its reason, and the rows until then."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.base.errors import RunError
from cosim.engine.simulate import simulate
from cosim.live import LiveError, bundle, digest
from cosim.loading.files import load
from cosim.record import Run
from tests.cosim.live.node import computed

CONFIGS = Path(__file__).parents[3] / "configs"
STEEP = ("run.stop=1", "components.master.parameters.k_d=1e7")


def test_a_component_that_fails_is_named_with_its_reason(tmp_path):
    scenario = load(CONFIGS / "teleoperation.toml", STEEP)
    without = {"components.master.parameters.k_d": 0.0}
    found, fine, again = computed(bundle(scenario, STEEP), [{}, without, {}])
    with pytest.raises(RunError) as stopped:
        simulate(scenario, tmp_path / "run")
    assert found["failure"]["text"] == str(stopped.value)
    assert found["failure"]["component"] == "master"
    assert found["failure"]["time"] == stopped.value.time
    assert found["digest"] == again["digest"] == digest(Run.open(tmp_path / "run"))
    assert fine["failure"] is None and fine["rows"] == 1001


@pytest.fixture(scope="module")
def short():
    """The bundle of a short run."""
    return bundle(load(CONFIGS / "teleoperation.toml", ["run.stop=0.1"]), ["run.stop=0.1"])


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"links.0.delay.low": 9.0}, "links.0.delay.low = 9; expected 0 to 2.5"),
        ({"run.stop": 9.0}, "run.stop cannot be moved in this page"),
        ({"links.0.delay.hold": 0.0071}, "links.0.delay.hold = 0.0071; expected one of 0.005"),
        ({"links.0.delay.low": 2.0}, "links.0.delay.low = 2 is more than links.0.delay.high = 1.2"),
    ],
)
def test_values_that_a_page_cannot_compute_are_refused(short, values, sentence):
    with pytest.raises(AssertionError) as refused:
        computed(short, [values])
    assert f"RangeError: {sentence}" in str(refused.value)


@pytest.mark.parametrize(
    ("config", "sentence"),
    [("mujoco/teleoperation", r"\w+: is a scene of a simulator, which a page cannot compute")],
)
def test_a_scenario_that_a_page_cannot_compute_gives_a_sentence(config, sentence):
    pytest.importorskip("mujoco")
    with pytest.raises(LiveError, match=sentence):
        bundle(load(CONFIGS / f"{config}.toml"))


def test_a_python_component_is_named(tmp_path):
    scenario = tmp_path / "s.toml"
    scenario.write_text(
        '[run]\nstep = "1 ms"\nstop = "1 s"\n[components.push]\n'
        'model = "tests.cosim.live.test_failures:Nothing"\n',
        encoding="utf-8",
    )
    with pytest.raises(LiveError, match="push: is a Python component, which a page cannot compute"):
        bundle(load(scenario))


class Nothing:
    """A component without ports."""

    kind = "continuous"
    inputs = outputs = parameters = ()

    def initialize(self, values):
        pass

    def initial(self, u):
        return {}

    def step(self, t, h, u):
        return {}
