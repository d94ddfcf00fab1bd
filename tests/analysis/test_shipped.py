"""Every shipped scenario: what `analyze` finds lies beside its closed form within what is said.

What is said is the uncertainty of the number itself (links and graphs that switch), and that of the
closed form, which is continuous: `docs/analysis.md`, section 3.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from cosim.analysis.analysis import Analysis, analyse
from cosim.analysis.analyzed_port import of_scenario
from cosim.analysis.quantity import Quantity

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
#: Scenes and elastic joints state no facts, so that nothing has a closed form.
POLICY = ROOT / "examples/policy/policy.toml"
WITHOUT_FACTS = [*CONFIGS.glob("mujoco/*.toml"), *CONFIGS.glob("vibration/*.toml"), POLICY]
#: Laws in the coordinates of tips: closed forms are of joints.
TIPS = [CONFIGS / "task_space.toml", CONFIGS / "robots" / "turn.toml"]
#: Serial arms; tests of their ports take minutes (there is a small one in test_serial_arm.py).
ARMS = [
    CONFIGS / "openarm.toml",
    *CONFIGS.glob("six_axis*.toml"),
    *(path for path in CONFIGS.glob("robots/*.toml") if path not in TIPS),
]
SHIPPED = sorted({*CONFIGS.glob("*.toml"), *CONFIGS.glob("can/*.toml")} - {*ARMS, *TIPS})
#: Scenarios in which nobody holds an arm, and the arm to analyze.
UNHELD = {
    "configs/compare/networks/ring.toml": "robot1",
    "examples/own_controller/scenario.toml": "arm",
}
#: Shares by which a closed form may be off: ωT_s/4 at 60 rad/s and 5 ms where it is not sampled,
#: the time that a push takes to become a straight line, what is left of a decay.
UNSAMPLED, STRAIGHT, ROUNDED = 0.075, 0.04, 2e-3
ALLOWED: Mapping[str, float] = {
    "degree": STRAIGHT / 4,
    "push_degree": STRAIGHT,
    **{f"{part}_{tag}": UNSAMPLED for part in ("real_part", "inertia_quickly", "damping_quickly")
       for tag in ("started", "known")},
}  # fmt: skip
AT_MOST = ("gain", "push_share")


def off(q: Quantity) -> float:
    """How far a number is from its closed form, over what is allowed; at most 1 is right."""
    values, expected = np.broadcast_arrays(np.array(q.values), np.array(q.expected))
    error = np.broadcast_to(np.array(q.error or (0.0,)), values.shape)
    if q.name in AT_MOST or "at most" in q.formula:
        return float((values / expected / (1 + 1e-3)).max())
    allowed = error + ALLOWED.get(q.name, ROUNDED) * np.abs(expected)
    return float((np.abs(values - expected) / allowed).max())


def check(found: Analysis, least: int) -> None:
    """All numbers with a closed form are beside it, and there are at least so many."""
    given = [q for q in found.quantities if q.expected and not q.missing]
    beside = [q for q in given if np.isfinite(q.expected).all()]  # a grip of any stiffness is not
    assert len(beside) >= least
    wrong = [(q.name, q.text, q.expected_text, off(q)) for q in beside if not off(q) <= 1.0]
    assert not wrong


def test_the_single_arm_is_beside_its_closed_forms() -> None:
    check(analyse(of_scenario(CONFIGS / "teaching.toml")), 12)


@pytest.mark.slow
@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_shipped_scenario_is_beside_its_closed_forms(path: Path) -> None:
    check(analyse(of_scenario(path)), 10)


def test_these_are_all_shipped_scenarios() -> None:
    files = [path for folder in ("configs", "examples") for path in (ROOT / folder).rglob("*.toml")]
    scenarios = [path for path in files if "\n[components." in path.read_text(encoding="utf-8")]
    unheld = [ROOT / name for name in UNHELD]
    assert sorted(scenarios) == sorted([*SHIPPED, *ARMS, *TIPS, *unheld, *WITHOUT_FACTS])


@pytest.mark.slow
def test_a_ring_that_nobody_holds_is_beside_its_closed_forms() -> None:
    check(analyse(of_scenario(CONFIGS / "compare/networks/ring.toml", chosen="robot1")), 6)


@pytest.mark.slow
def test_an_own_controller_is_felt_as_its_spring(monkeypatch: pytest.MonkeyPatch) -> None:
    """PD with 20 N.m/rad, also by a push: the motion that it makes by itself is subtracted."""
    monkeypatch.chdir(ROOT / "examples/own_controller")
    monkeypatch.syspath_prepend(str(ROOT / "examples/own_controller"))
    found = analyse(of_scenario("scenario.toml", chosen="arm"))
    by_name = {q.name: q for q in found.quantities}
    assert by_name["push_stiffness"].values == pytest.approx((20.0, 20.0), rel=1e-3)


@pytest.mark.parametrize("path", [*SHIPPED, *ARMS], ids=lambda path: path.stem)
def test_the_run_of_every_shipped_scenario_is_beside_its_closed_forms(path: Path) -> None:
    slow = path.stem in ("many", "fr3")  # too slow for a rate of approach
    least = 1 if slow else 2
    check(analyse(of_scenario(path), tests=False), least)
