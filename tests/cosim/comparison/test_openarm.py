"""Comparisons of a scenario with its own variants, whose controllers take options."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cosim.base.errors import ScenarioError
from cosim.comparison.documents import check, read_base
from cosim.comparison.variants_file import read, variants_path
from tests.cli.command import Command
from tests.cli.conftest import cosim as cosim  # the command as a fixture

OPENARM = Path(__file__).parents[3] / "configs" / "openarm.toml"


def test_the_variants_of_a_scenario_have_its_name_or_that_of_no_other(tmp_path: Path) -> None:
    def files(*names: str) -> Path:
        for name in names:
            path = tmp_path / name
            path.parent.mkdir(exist_ok=True)
            path.touch()
        return tmp_path / "a.toml"

    files("a.toml", "b.toml", "compare/b.toml", "compare/others.toml")
    assert variants_path(tmp_path / "a.toml").name == "others.toml"
    assert variants_path(tmp_path / "b.toml").name == "b.toml"
    files("compare/a.toml")
    assert variants_path(tmp_path / "a.toml").name == "a.toml"
    files("compare/more.toml")
    with pytest.raises(ScenarioError, match=r"found more\.toml, others\.toml"):
        variants_path(tmp_path / "c.toml")
    assert variants_path(OPENARM.with_name("teleoperation.toml")).name == "bilateral.toml"


def test_every_controller_gets_the_robot_by_its_options() -> None:
    known = read(variants_path(OPENARM))
    plans = check(read_base(OPENARM, known, ()), known, known.default)
    assert len(plans) >= 7
    for plan in plans:
        for side in ("master_control", "slave_control"):
            step = plan.component(side)
            assert step.inputs[0].shape == (7,)
            assert max(step.values["tau_max"]) == 40.0  # N.m, of the file


@pytest.mark.slow
def test_what_compensated_friction_and_delay_do_to_the_symmetric_pd(cosim: Command) -> None:
    chosen = ("--controllers", "openarm,paper", "--operators", "hand,friction")
    done = cosim("compare", OPENARM, *chosen, "--links", "cable,constant", "--out", "out", "-q")
    assert done.code == 0, done.err
    runs = json.loads(Path("out/table.json").read_text())["runs"]
    stable = {(r["controller"], r["operator"], r["link"]): r["stable"] for r in runs}
    assert not stable["openarm", "hand", "cable"]  # compensates friction that is not there
    assert stable["openarm", "friction", "cable"]
    assert not stable["openarm", "friction", "constant"]  # 0.3 s of delay
    assert all(stable[key] for key in stable if key[0] == "paper")


def test_laws_that_know_nothing_of_an_arm_hold_it_with_gravity_beside_them(
    cosim: Command,
) -> None:
    """Wave variables and time-domain passivity on seven joints, for two seconds on a cable."""
    rivals = OPENARM.parent / "compare" / "rivals" / "openarm.toml"
    known = read(rivals)
    assert check(read_base(OPENARM, known, ()), known, known.default)
    done = cosim(
        *("compare", OPENARM, "--variants", rivals, "--controllers", "wave,tdpa-drift,p+d"),
        *("--links", "cable", "--set", "run.stop=2 s", "--no-plot", "--out", "out", "-q"),
    )
    assert done.code == 0, done.err
    for run in json.loads(Path("out/table.json").read_text())["runs"]:
        assert 0.0 < run["numbers"]["apart"] < 0.35, run  # 0.3 rad at the start


TURN = OPENARM.parent / "robots" / "turn.toml"


def test_arms_that_differ_have_options_of_their_own() -> None:
    """Seven joints on the left, six on the right; their links carry coordinates of tips."""
    known = read(variants_path(TURN))
    plans = check(read_base(TURN, known, ()), known, known.default)
    shapes = {tuple(p.component(f"{side}_control").inputs[0].shape[0] for side in known.roles)
              for p in plans}  # fmt: skip
    assert shapes == {(7, 6)}


@pytest.mark.slow
def test_only_the_feedback_of_the_tip_reflects_the_force(cosim: Command) -> None:
    chosen = ("--controllers", "tips,tips-joints", "--operators", "floor", "--links", "paper")
    done = cosim("compare", TURN, *chosen, "--out", "out", "-q")
    assert done.code == 0, done.err
    runs = json.loads(Path("out/table.json").read_text())["runs"]
    shares = {r["controller"]: r["numbers"]["pressed"] / r["numbers"]["holding"] for r in runs}
    assert 0.9 < shares["tips"] < 1.0
    assert shares["tips-joints"] < 0.35
