"""Position errors aligned by the delay: traces whose integral is known, and runs of two arms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isnan, nan, sqrt
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cosim.base.errors import ScenarioError
from cosim.comparison.aligned import AlignedError
from cosim.comparison.variants_file import read
from tests.cosim.comparison.parts import SMALL, compared, stored, written

Array = NDArray[np.float64]
COLUMNS = """
[columns.aligned]
kind = "rms_aligned"
of = ["master.q"]
target = "slave.q"
[columns.delay]
kind = "rms_aligned"
of = ["master.q"]
target = "slave.q"
part = "delay_s"
[columns.rms]
kind = "rms_free"
of = ["master.q"]
target = "slave.q"
contact = ["slave.tau_e"]
[stable]"""


@dataclass(frozen=True)
class TwoArms:
    """Positions of two arms, one joint each."""

    t: Array
    columns: Mapping[str, Array]

    def array(self, prefix: str) -> Array:
        return self.columns[prefix][:, None]

    def entries(self, prefix: str) -> tuple[str, ...]:
        return (f"{prefix}[0]",)

    def unit(self, prefix: str) -> str:
        return "rad"


def measured(delay: float, shift: float, apart: float = 0.0) -> tuple[float, Mapping[str, float]]:
    """Of x_2(t) = x_1(t - `shift`) + `apart`, x_1 a ramp, over 4 s."""
    t = np.linspace(0.0, 4.0, 401)
    arms = TwoArms(t, {"m.q": 2.0 * t, "s.q": 2.0 * (t - shift) + apart})
    found = AlignedError("aligned", "m.q", "s.q", "master->slave").evaluate(arms, delay)
    return found.value, found.parts


def test_what_the_delay_explains_is_no_error() -> None:
    assert measured(0.5, 0.5)[0] == pytest.approx(0.0, abs=1e-12)
    assert measured(0.5, 0.5, apart=0.3)[0] == pytest.approx(0.3)
    assert measured(0.505, 0.5)[0] == pytest.approx(0.01)  # between two rows
    assert measured(0.0, 0.5)[0] == pytest.approx(1.0)


@pytest.mark.parametrize("delay", [nan, 4.0, 5.0])
def test_a_link_without_a_delay_within_the_run_has_no_number(delay: float) -> None:
    value, parts = measured(delay, 0.5)
    assert isnan(value)
    assert parts["delay_s"] == pytest.approx(delay, nan_ok=True)


def test_the_delay_is_the_mean_age_of_what_the_receiver_had(tmp_path: Path) -> None:
    """Looks every 2 ticks of 0.1 s at samples of every tick: ages 2, 2 and 5 ticks."""
    facts = {"name": "a->b", "sender_period": 1, "receiver_period": 2, "h": 0.1}
    assert stored(tmp_path, facts, [-1, 0, 2, 1]).mean_age == pytest.approx(0.3)
    assert isnan(stored(tmp_path, facts, [-1]).mean_age)


def test_controllers_that_send_no_position_have_it_too(tmp_path: Path) -> None:
    """The arms of `paper` follow each other later; aligned they are closer. T is the link's."""
    paper = """
[controllers.paper]
model = "fmus.models.teleoperation"
sizes = { neighbours = 1 }
parameters = { K = 16.0, Gamma = 1.0, alpha = 0.5, lambda_M = 10.0, lambda = 2.0 }
receives = { "xi_in[0]" = "controller.xi" }
"""
    text = SMALL.replace("[stable]", paper + COLUMNS).replace("run.stop=2 s", "run.stop=6 s")
    (outcome,) = compared(written(tmp_path, text), ["paper"]).outcomes
    value = {name: number for name, (number, _) in outcome.numbers.items()}
    assert value["delay"] == pytest.approx(0.1)
    assert 0 < value["aligned"] < value["rms"]
    assert value["aligned"] > value["rms"] / sqrt(10)


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ('of = ["master.q"]', 'of = ["master.q", "slave.q"]', "columns.aligned.of"),
        ('of = ["master.q"]', 'of = ["hand.q"]', "columns.aligned.of"),
        ('target = "slave.q"', 'target = "master.q"', "columns.aligned.target"),
        ('target = "slave.q"', "", "columns.aligned"),
    ],
)
def test_a_column_without_two_arms_is_refused(
    tmp_path: Path, old: str, new: str, place: str
) -> None:
    text = SMALL.replace("[stable]", COLUMNS.replace(old, new, 1))
    with pytest.raises(ScenarioError) as refused:
        read(written(tmp_path, text))
    assert place in str(refused.value)
