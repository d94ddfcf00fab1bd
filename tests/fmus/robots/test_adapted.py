"""Adaptation of an independent set of parameters, and of chosen ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import ScenarioError
from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.record import Run
from fmus.arms import chain_law
from fmus.arms.adapted import base_set, chosen
from fmus.arms.options import prepare
from fmus.arms.serial import Robot, serial
from fmus.models import arm_pd, arm_teleoperation, arm_wang2014

ROBOTS = Path(__file__).parents[3] / "configs" / "robots"


@pytest.fixture(scope="module")
def fr3() -> Robot:
    return serial(ROBOTS / "fr3.urdf", "link0", "link7")


def test_the_numbers_of_base_parameters_are_those_of_the_literature(fr3: Robot) -> None:
    """43 of an arm whose first axis is vertical; 45 of OpenArm, whose first axis is level."""
    assert base_set(fr3.table).sum() == 43
    openarm = serial(ROBOTS / "openarm_right.urdf", "body", "hand")
    assert base_set(openarm.table).sum() == 45


def test_the_base_parameters_give_every_torque_of_the_arm(fr3: Robot) -> None:
    """Y theta = Y_base beta, in motions that were not used to find the set."""
    rng, table = np.random.default_rng(5), fr3.table
    kept = base_set(table).ravel() > 0.0
    states = rng.uniform(-2.0, 2.0, (60, 4, 7))
    for g in (table.g, np.zeros(3)):
        each = (chain_law.regressor(table, q, dq, z, dz, g) for q, dq, z, dz in states)
        W = np.vstack([Y.reshape(7, -1) for Y in each])
        torque = W @ table.inertia.ravel()
        beta = np.linalg.lstsq(W[:, kept], torque, rcond=None)[0]
        assert W[:, kept] @ beta == pytest.approx(torque, abs=1e-9)


def options(**more: object) -> dict[str, object]:
    return {"urdf": "fr3.urdf", "base": "link0", "tip": "link7", **more}


def test_options_make_gamma(fr3: Robot) -> None:
    made = prepare(arm_wang2014.model, options(adapt=["m[6]", 5], gain=[2.0, 0.5, 0.1]), ROBOTS)
    gamma = np.array(made.values["Gamma"])
    assert gamma[6].tolist() == [2.0] + 9 * [0.0]
    assert gamma[5].tolist() == [2.0] + 3 * [0.5] + 6 * [0.1]
    assert not gamma[:5].any()
    every = np.array(prepare(arm_teleoperation.model, options(adapt="all"), ROBOTS).values["Gamma"])
    assert (every == np.array([1.0] + 3 * [0.1] + 6 * [0.01])).all()
    base = np.array(prepare(arm_teleoperation.model, options(adapt="base"), ROBOTS).values["Gamma"])
    assert ((base > 0.0) == (chosen(fr3.table, "base") > 0.0)).all()
    assert "Gamma" not in prepare(arm_teleoperation.model, options(), ROBOTS).values


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        ({"adapt": "some"}, "expected 'all', 'base' or a list"),
        ({"adapt": []}, "expected 'all', 'base' or a list"),
        ({"adapt": [7]}, "expected the number of a link, 0 to 6"),
        ({"adapt": ["m[7]"]}, "expected the number of a link, 0 to 6"),
        ({"adapt": ["mass[2]"]}, "expected one of m, mx"),
        ({"adapt": [True]}, "expected the number of a link"),
        ({"gain": [1.0, -1.0, 1.0]}, "nothing below 0"),
    ],
    ids=str,
)
def test_what_cannot_be_adapted_is_refused(more: dict[str, object], reason: str) -> None:
    with pytest.raises(ScenarioError, match=reason):
        prepare(arm_teleoperation.model, options(**more), ROBOTS)
    with pytest.raises(ScenarioError, match="adapts nothing"):
        prepare(arm_pd.model, options(adapt="all"), ROBOTS)


def test_two_arms_track_with_the_base_set_as_with_all_parameters(tmp_path: Path) -> None:
    """Two FR3 whose estimates begin at 0; the slave carries 1 kg."""
    ends = {}
    for what in ("all", "base"):
        settings = ["run.stop='12 s'", "run.record.every=10"]
        for arm in ("master", "slave"):
            settings += [f"components.{arm}_control.options.adapt={what}"]
        simulate(load(ROBOTS / "fr3.toml", settings), tmp_path / what)
        run = Run.open(tmp_path / what)
        s = run.array("slave_control.s")
        apart = np.abs(run.array("master.q")[-1] - run.array("slave.q")[-1]).max()
        ends[what] = np.abs(s[-1]).max() / np.abs(s).max(), apart
        estimate = run.array("slave_control.theta_hat")[-1].reshape(7, 10)
        adapted = chosen(serial(ROBOTS / "fr3.urdf", "link0", "link7").table, what) > 0.0
        assert not estimate[~adapted].any() and np.abs(estimate[adapted]).max() > 0.01
    for settled, apart in ends.values():
        assert settled < 0.015 and apart < 5e-3, ends
