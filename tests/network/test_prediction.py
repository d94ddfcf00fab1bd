"""What ``cosim ping --scenario`` predicts of a network, and the rehearsal that follows on it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.cli.paths.path import _path_trace
from bridge.ping.prediction import ScenarioPrediction, parts, predict
from bridge.relay.network import RelayNetwork
from cosim.measure import declared_metrics
from cosim.measure.metrics import evaluate
from cosim.record import Run
from tests.bridge.zenoh.rehearsed import CONFIGS
from tests.network.hosts import PATIENT, Case, Found, rehearse
from tests.network.test_laws import during
from tests.network.test_ping import drawn_link, measured

pytestmark = pytest.mark.slow

STOP, CASES = 15.0, 5
SCENARIO = CONFIGS / "teleoperation.toml"
LINKS = {"near>far": "master>slave", "far>near": "slave>master"}
Specs = Mapping[str, Mapping[str, Any]]


def predicted(specs: Specs, folder: Path) -> ScenarioPrediction:
    """Of a ping of some seconds between two hosts on such a network."""
    with RelayNetwork(("near", "far"), folder.with_suffix(".packets"), seed=5) as network:
        for link, spec in specs.items():
            network.set(link, **spec)
        result, _, _ = measured(network, 1000.0, 20e-6, questions=600)
    return predict(SCENARIO, _path_trace("udp", result), "", [f'run.stop="{STOP} s"'])


def numbers(found: Found) -> dict[str, float]:
    """The same numbers of a rehearsal."""
    run = Run.open(found.folder)
    results = evaluate(declared_metrics.metrics(found.system.scenario), run)
    return {label: value for (_, label, _), value in parts(results)}


@pytest.mark.parametrize("seed", range(4))
def test_settling_and_effort_of_a_rehearsal_are_within_the_predicted_interval(
    seed: int, tmp_path: Path
) -> None:
    """Of 25 numbers, some may be outside of intervals for 99 %, but not far; that three are has a
    chance of 1 in 500.
    """
    rng = np.random.default_rng([20261125, seed])
    names = [f"{seed}-{i}" for i in range(CASES)]
    specs = {name: {link: drawn_link(rng) for link in LINKS} for name in names}
    said = {name: predicted(specs[name], tmp_path / name) for name in names}
    ran = rehearse(
        {
            name: Case(STOP, during(STOP, {LINKS[k]: v for k, v in specs[name].items()}), PATIENT)
            for name in names
        },
        tmp_path,
    )
    outside = []
    for name in names:
        real = numbers(ran[name])
        for number in said[name].numbers:
            value, half = real[number.label], (number.most - number.least) / 2
            assert number.least - half <= value <= number.most + half, (specs[name], number, value)
            if not number.least <= value <= number.most:
                outside.append((specs[name], number, value))
            if number.label == "operator effort":  # the interval says something
                assert number.most - number.least < 0.02 * number.value
                assert not number.least <= number.ideal <= number.most
    assert len(outside) < 3, outside
