"""Encoders: counts, and a velocity of differences that a filter smooths and delays."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.component import Component
from fmus.models import encoder
from fmus.models.encoder import Encoder

H = 1e-3
pytestmark = pytest.mark.usefixtures("compiled_once")


@pytest.fixture(params=[Encoder, encoder.kernel], ids=["numpy", "c"])
def encoders(request: pytest.FixtureRequest) -> Component:
    made: Component = request.param()
    return made


def follow(component: Component, motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """q_m and dq_m of the first joint at 0, h, ..., of its positions; the second one rests."""
    at = np.stack([motion, np.zeros_like(motion)], axis=1)
    component.initial({"q": at[0]})
    seen = [component.step(k * H, H, {"q": q}) for k, q in enumerate(at)]
    assert all(not np.any(np.asarray(y[name])[1]) for y in seen for name in y)
    return tuple(np.array([np.asarray(y[name])[0] for y in seen]) for name in ("q_m", "dq_m"))


def test_positions_are_the_nearest_counts(encoders: Component) -> None:
    count = encoder.PRESETS["14-bit"]["resolution"]
    encoders.initialize({"resolution": np.full(2, count)})
    motion = np.array([0.0, 0.4, 0.6, 1.5, 2.5, -0.6, -1.4, 1e4]) * count
    q_m, _ = follow(encoders, motion)
    assert np.allclose(q_m / count, [0, 0, 1, 2, 2, -1, -1, 1e4], rtol=0, atol=1e-9)


def test_without_filter_the_velocity_is_a_whole_number_of_counts_per_step(
    encoders: Component,
) -> None:
    count = 1e-3
    encoders.initialize({"resolution": np.full(2, count)})
    _, dq_m = follow(encoders, 0.25 * H * np.arange(400))
    assert set(np.round(dq_m / (count / H), 9)) == {0.0, 1.0}
    assert dq_m[0] == 0.0
    assert dq_m.mean() == pytest.approx(0.25, rel=0.02)


def test_the_filter_smooths_and_is_late_by_its_time_constant(encoders: Component) -> None:
    encoders.initialize({"T": np.array(0.02)})
    _, dq_m = follow(encoders, 0.5 * (H * np.arange(400)) ** 2)  # dq = t
    t = H * 399
    assert dq_m[-1] == pytest.approx(t - 0.02 - H / 2, abs=1e-6)


def test_numpy_and_c_agree(encoders: Component) -> None:
    rng = np.random.default_rng(3)
    values = {"resolution": np.array([0.0, 1e-3]), "T": np.array(0.01)}
    motion = rng.uniform(-3, 3, (200, 2))
    found = []
    for component in (Encoder(), encoder.kernel()):
        component.initialize(values)
        component.initial({"q": motion[0]})
        found.append([component.step(k * H, H, {"q": q}) for k, q in enumerate(motion)])
    for a, b in zip(*found, strict=True):
        assert all(np.allclose(a[name], b[name], rtol=0, atol=1e-12) for name in a)
