"""The intent of a person: the delayed integral in closed form, limits, tremor and refusals."""

from __future__ import annotations

from collections.abc import Callable
from math import pi, sin

import numpy as np
import pytest

from cosim.base.component import Component
from cosim.base.errors import RunError
from fmus.models import reaction
from fmus.models.reaction import Reaction

H = 5e-3
Make = Callable[[], Component]


@pytest.fixture(params=[Reaction, reaction.kernel], ids=["numpy", "c"])
def intent(request: pytest.FixtureRequest) -> Component:
    make: Make = request.param
    return make()


def followed(intent: Component, steps: int, **values: object) -> np.ndarray:
    """q_h (steps, 2) of a person whose arm follows at once: q = q_h of the step before."""
    given = {"q_g": np.array([1.0, -1.0]), "v_max": np.array(100.0), **values}
    intent.initialize(given)  # type: ignore[arg-type]
    q = np.zeros(2)
    found = [np.asarray(intent.initial({"q": q})["q_h"], dtype=float)]
    for k in range(steps):
        q = found[-1]
        found.append(np.asarray(intent.step(k * H, H, {"q": q})["q_h"], dtype=float).copy())
    return np.array(found[1:])


def test_without_reaction_time_the_error_decays_with_the_crossover_frequency(
    intent: Component,
) -> None:
    q = followed(intent, 400, reaction=np.array(0.0), omega_c=np.array(2.0))
    t = H * np.arange(400)
    assert q[:, 0] == pytest.approx(1 - np.exp(-2 * t), abs=0.015)
    assert q[:, 1] == pytest.approx(-q[:, 0])


def test_the_person_acts_on_what_was_seen_a_reaction_time_ago(intent: Component) -> None:
    """A goal seen at t = 0; q(0) until τ, so p = ω_c t there, and slower only after τ."""
    q = followed(intent, 60, reaction=np.array(0.15), omega_c=np.array(2.0))[:, 0]
    t = H * np.arange(60)
    early = t <= 0.15
    assert q[early] == pytest.approx(2.0 * t[early], abs=1e-12)
    late = (t > 0.15) & (t <= 0.3)  # dp/dt = 2 (1 - 2 (t - τ)), the sampling adds a step
    s = t[late] - 0.15
    assert q[late] == pytest.approx(0.3 + 2 * s - 2 * s**2, abs=0.011)


@pytest.mark.parametrize(("omega_c", "grows"), [(0.8 * pi / 2 / 0.2, False),
                                                (1.3 * pi / 2 / 0.2, True)])  # fmt: skip
def test_the_loop_is_stable_up_to_half_pi(intent: Component, omega_c: float, grows: bool) -> None:
    """ω_c τ < π/2, τ = 0.2 s with the sample that the arm adds."""
    given = {"reaction": np.array(0.19), "omega_c": np.array(omega_c), "v_max": np.array(1e6)}
    e = np.abs(followed(intent, 2000, **given)[:, 0] - 1)
    assert (e[-400:].max() > e[400:800].max()) == grows


def test_speed_is_limited_and_a_tremor_added(intent: Component) -> None:
    given = {"v_max": np.array(0.1), "tremor": np.array(0.01), "f": np.array(9.0)}
    q = followed(intent, 100, **given)[:, 0]
    shake = [0.01 * sin(2 * pi * 9.0 * k * H) for k in range(100)]
    assert q - shake == pytest.approx(0.1 * H * np.arange(100), abs=1e-12)


def test_too_long_a_reaction_is_refused(intent: Component) -> None:
    intent.initialize({"reaction": np.array(0.4)})
    intent.initial({"q": np.zeros(2)})
    with pytest.raises(RunError, match="more than 63 steps"):
        intent.step(0.0, H, {"q": np.zeros(2)})
