"""A page computes what the command line does, to the last bit: in Node, and in wasmtime."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import RunError, ScenarioError
from cosim.engine.simulate import simulate
from cosim.live import bundle, digest
from cosim.loading.files import load
from cosim.record import Run
from tests.cosim.live.in_wasmtime import Simulator
from tests.cosim.live.node import computed

CONFIGS = Path(__file__).parents[3] / "configs"
#: Other laws, losses and semantics than the scenario has.
LOSSY = (
    "run.stop=2",
    'links.0.delay={law="constant",delay="200 ms"}',
    'links.0.loss={law="independent",p=0.1}',
    'links.0.semantics="newest-stamp"',
    'links.1.semantics="last-arrival"',
)
#: Queues that grow, and that drop.
QUEUES = (
    "run.stop=2",
    "components.slave_control.period=0.02",
    'links.0.semantics="queue"',
    "links.0.depth=30",
    'links.1.semantics="queue"',
    "links.1.depth=20",
    'links.1.drop="newest"',
    'links.1.take="all"',
)
#: All scenarios of `configs` that a page can compute.
WHOLE = (
    *("many", "network", "openarm", "six_axis", "six_axis_position", "six_axis_velocity"),
    *("task_space", "teaching", "teleoperation", "compare/networks/ring", "robots/fr3"),
    *("robots/turn", "vibration/joint2", "can/teleoperation-bus"),
)


def native(path: Path, folder: Path, *settings: str) -> str:
    """The digest of a run by the command line's engine."""
    simulate(load(path, settings), folder)
    return digest(Run.open(folder))


@pytest.mark.parametrize(
    ("name", "settings"),
    [("teleoperation", ["run.stop=3"]), ("teleoperation", ["run.stop=1.0005", "run.step=0.0005"]),
     ("teaching", ["run.stop=1"]), ("openarm", ["run.stop=0.2"]),
     ("teleoperation", ["run.stop=1", "run.record.every=7"]), ("teleoperation", LOSSY),
     ("teleoperation", QUEUES),
     ("network", ["run.stop=0.2"])],
)  # fmt: skip
def test_a_page_and_wasmtime_have_the_digest_of_the_command_line(name, settings, tmp_path):
    path = CONFIGS / f"{name}.toml"
    made = bundle(load(path, settings))
    (found,) = computed(made, [{}])
    assert found["failure"] is None
    assert found["digest"] == native(path, tmp_path / "run", *settings)
    assert Simulator(made).run() == found["digest"]


@pytest.mark.slow
@pytest.mark.parametrize("name", WHOLE)
def test_whole_scenarios_have_the_digest_of_the_command_line(name, tmp_path):
    path = CONFIGS / f"{name}.toml"
    made = bundle(load(path))
    (found,) = computed(made, [{}])
    assert found["digest"] == native(path, tmp_path / "run")
    assert Simulator(made).run() == found["digest"]


def test_a_second_run_in_a_page_has_the_same_bits(tmp_path):
    first, second = computed(bundle(load(CONFIGS / "teleoperation.toml", ["run.stop=1"])), [{}, {}])
    assert first["digest"] == second["digest"]


def drawn(bundle, rng):
    """Values of all keys, somewhere on their sliders; the bounds of a law in their order."""
    values = {}
    for key in bundle["keys"]:
        low, high = key["low"], key["high"]
        some = [c for c in key["choices"] if low <= c <= high]
        values[key["key"]] = float(rng.choice(some) if some else rng.uniform(low, high))
    for pair in bundle["ordered"]:
        both = sorted(values[pair[x]] for x in ("low", "high"))
        values[pair["low"]], values[pair["high"]] = both
    return {key: x for key, x in values.items() if rng.uniform() < 0.7}


def ordered(bundle, values):
    """False where one bound was moved beyond the other one."""
    all_ = {key["key"]: key["value"] for key in bundle["keys"]} | values
    return all(all_[pair["low"]] <= all_[pair["high"]] for pair in bundle["ordered"])


def set_by(bundle, values):
    """The settings that give values; of what the file leaves out, the whole list or table."""
    all_ = {key["key"]: key["value"] for key in bundle["keys"]} | values
    whole = {x: path for path, parts in bundle["added"].items() for x in parts if x in all_}
    settings = [f"{key}={x!r}" for key, x in values.items() if key not in whole]
    for path in dict.fromkeys(whole[key] for key in values if key in whole):
        parts = [repr(all_[x]) if x in all_ else x for x in bundle["added"][path]]
        settings.append(f"{path}={''.join(parts)}")
    return settings


NEWEST = [f'links.{i}.semantics="newest-stamp"' for i in (0, 1)]


@pytest.mark.parametrize(
    ("name", "settings", "seed"),
    [
        ("teleoperation", ["run.stop=2"], 1),
        ("teleoperation", ["run.stop=2", *NEWEST], 6),
        ("teleoperation", LOSSY, 2),
        ("teleoperation", QUEUES, 7),
        ("teaching", ["run.stop=0.5"], 3),
        pytest.param("openarm", ["run.stop=2"], 4, marks=pytest.mark.slow),
        pytest.param("network", ["run.stop=2"], 5, marks=pytest.mark.slow),
    ],
)
def test_moved_keys_give_the_digests_of_settings(name, settings, seed, tmp_path):
    path, rng = CONFIGS / f"{name}.toml", np.random.default_rng(seed)
    made = bundle(load(path, settings), settings)
    some = [v for v in (drawn(made, rng) for _ in range(12)) if ordered(made, v)][:6]
    assert made["keys"] and len(some) == 6
    for n, (values, found) in enumerate(zip(some, computed(made, some), strict=True)):
        moved = set_by(made, values)
        try:
            expected = native(path, tmp_path / f"{n}", *settings, *moved)
        except ScenarioError as error:  # inertias that no arm has
            told, expected = found["failure"]["text"], str(error)
            assert told.partition(":")[0] == expected.partition(":")[0]
            assert told.partition(" returned ")[2] == expected.partition(" returned ")[2] != ""
            continue
        except RunError as error:
            assert found["failure"]["text"] == str(error)
            expected = digest(Run.open(tmp_path / f"{n}"))
        assert found["digest"] == expected, moved


def test_masses_of_a_preset_and_losses_that_a_file_leaves_out_can_be_moved():
    settings = ["run.stop=1", *NEWEST]
    made = bundle(load(CONFIGS / "teleoperation.toml", settings), settings)
    keys = {key["key"]: key["value"] for key in made["keys"]}
    theta = [keys[f"components.slave.parameters.theta.{i}"] for i in range(3)]
    assert theta == [3.34, 1.2, 0.97]
    assert keys["links.0.loss.p"] == keys["links.1.loss.p"] == 0
    assert "components.slave.parameters.q.0" not in keys, "the start of the file is not a preset's"


def test_a_reason_is_given_where_a_link_cannot_lose():
    made = bundle(load(CONFIGS / "teleoperation.toml", ["run.stop=1"]), ["run.stop=1"])
    (reason,) = [x["reason"] for x in made["fixed"] if x["key"] == "links.0.loss.p"]
    assert 'packets cannot be lost with semantics = "signal"' in reason


def test_laws_that_c_does_not_draw_are_fixed_with_the_reason():
    gamma = 'links.0.delay={law="gamma",shift=0.02,shape=2,scale=0.005,maximum=0.2}'
    settings = ["run.stop=1", gamma]
    made = bundle(load(CONFIGS / "teleoperation.toml", settings), settings)
    reason = "delays of the law gamma are drawn beforehand"
    assert {"key": "links.0.delay", "reason": reason} in made["fixed"]
    assert not [key for key in made["keys"] if key["key"].startswith("links.0")]
