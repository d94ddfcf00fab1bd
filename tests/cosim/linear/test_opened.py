"""Loops with their links cut: poles for any delay, against models of the whole loop and runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.linear.loop import CutLink
from cosim.linear.opened import OpenLoop
from cosim.linear.scenario import linearized, opened
from cosim.loading.files import load
from cosim.scenario.spec import build
from tests.cosim.linear.test_linear import LINKED, B, H, M

Document = dict[str, Any]


def document(delay: float, weight: float = 10.0, hand: float = 0.0) -> Document:
    """Two planar arms at rest in one posture; `hand` N.m/rad holds the first there."""
    q = [0.5, 0.9]
    components: Document = {}
    for name, k_p in (("a", hand), ("b", 0.0)):
        components[name] = {
            "model": "fmus.models.planar2r",
            "parameters": {"k_p": k_p, "k_d": k_p / 4},
            "start": {"q": q, "q_h": q},
            "inputs": {"tau": f"{name}_c.tau"},
        }
        components[f"{name}_c"] = {
            "model": "fmus.models.teleoperation",
            "period": 0.005,
            "parameters": {
                "K": 16.0,
                "Gamma": 1.0,
                "alpha": 1.0,
                "lambda_M": 4.0,
                "lambda": weight,
            },
            "inputs": {"q": f"{name}.q", "dq": f"{name}.dq"},
        }
    links = [
        {"from": f"{x}_c.xi", "to": f"{y}_c.xi_in[0]", "delay": {"law": "constant", "delay": delay}}
        for x, y in (("a", "b"), ("b", "a"))
    ]
    run = {"step": 0.001, "stop": 1.0}
    return {"run": run, "components": components, "links": links}


def loop(content: Document) -> OpenLoop:
    return opened(build(content, Path("pair.toml")))


def growing(F: Any, period: float, growth: float) -> int:
    return int(np.count_nonzero(np.abs(np.linalg.eigvals(F)) > np.exp(growth * period)))


def test_a_closed_loop_has_the_poles_of_the_whole_model(tmp_path: Path) -> None:
    """The mass at 2 ms, the controller at 10 ms, and 34 ms on the way between them."""
    (tmp_path / "mass.toml").write_text(LINKED)
    whole = linearized(tmp_path / "mass.toml", outputs=["mass.x"])
    cut = opened(load(tmp_path / "mass.toml"))
    assert cut.period == pytest.approx(H) and len(cut.states) == 2 and cut.held == 2
    assert [c.sent.shape for c in cut.links] == [(5, 1), (5, 1)]
    F, names = cut.closed([17, 17])
    assert len(names) == len(F) == 2 + 4 * 10  # periods before, ten samples in each
    found = np.linalg.eigvals(F)
    slow = [mode for mode in whole.modes() if abs(mode.z) > 0.01]
    assert len(slow) >= 2
    for mode in slow:
        assert np.abs(found - mode.z).min() < 1e-7


def test_poles_are_counted_without_the_samples_on_their_way() -> None:
    """Turns of the determinant against all eigenvalues, stable and not."""
    counted = set()
    for weight in (2.0, 30.0, 250.0):
        cut = loop(document(0.005, weight))
        for delays in ([5, 5], [40, 40], [5, 300], [150, 220]):
            F, _ = cut.closed(delays)
            for growth in (-0.3, 0.05, 2.0):
                expected = growing(F, cut.period, growth)
                counted.add(expected)
                assert cut.unstable(delays, growth) == expected
    assert len(counted) > 3


@pytest.mark.parametrize("joints", [1, 2, 3])
def test_joints_alike_have_poles_at_one_place(joints: int) -> None:
    """x[k+1] = x[k] - a x[k-d] is stable up to a = 2 cos(d pi / (2 d + 1)) (Levin and May 1976).

    Of two joints, the zeros of the determinant beside the circle turn it by 2 pi at one place.
    """
    one, both = np.eye(joints), np.arange(joints)[None]
    names = (("", ""),) * joints
    for d in (*range(2, 40, 3), 80, 200):
        for share, expected in ((1.0 - 1e-4, 0), (1.0 + 1e-4, 2 * joints)):
            a = share * 2.0 * np.cos(d * np.pi / (2 * d + 1))
            link = CutLink("x", 1, 1, both, both)
            cut = OpenLoop(0.0, 0.005, 1, names, (link,), (), (), one, -a * one, one, 0 * one, ())
            assert cut.unstable([d], 1e-6) == expected, d


@pytest.mark.parametrize(
    ("weight", "delays"), [(30.0, [5, 300]), (250.0, [5, 5]), (250.0, [5, 80])]
)
def test_the_fastest_pole_is_found_without_the_samples_on_their_way(
    weight: float, delays: list[int]
) -> None:
    """Against all eigenvalues of the closed loop, and the greatest entry of the eigenvector."""
    cut = loop(document(0.005, weight))
    F, names = cut.closed(delays)
    z, vectors = np.linalg.eig(F)
    i = int(np.argmax(np.abs(z)))
    pole, state = cut.fastest(delays, 0.01)
    expected = np.log(z[i]) / cut.period
    assert pole == pytest.approx(complex(expected.real, abs(expected.imag)), rel=1e-4)
    own = {name[2:] for name, x in zip(names, np.abs(vectors[: len(cut.A), i]), strict=False)
           if x > 0.999 * np.abs(vectors[: len(cut.A), i]).max()}  # fmt: skip
    assert state[2:] in own


@pytest.mark.parametrize("late", [(1, 60), (30, 44)])
def test_the_growth_with_drawn_samples_is_that_of_the_pole_where_they_are_one_delay(
    late: tuple[int, int],
) -> None:
    """Samples that are so many periods of 5 ms old, against all eigenvalues."""
    cut = loop(document(0.005, 30.0))
    looks = np.arange(2000)
    rows = [np.maximum(looks - periods, -1) for periods in late]
    F, _ = cut.closed([5 * periods for periods in late])
    expected = np.log(np.abs(np.linalg.eigvals(F)).max()) / cut.period
    assert expected > 1.0 and cut.drawn_growth(rows) == pytest.approx(expected, rel=0.02)


def test_the_fastest_pole_may_be_one_without_a_link() -> None:
    one = np.eye(1)
    link = CutLink("x", 1, 1, np.zeros((1, 1), int), np.zeros((1, 1), int))
    names = (("x", ""), ("y", ""))
    for links in ((link,), ()):
        B, C = (np.eye(2)[:, :1], np.eye(2)[:1]) if links else (np.zeros((2, 0)), np.zeros((0, 2)))
        D = 0.0 * one[: len(links), : len(links)]
        A = np.diag([0.5, np.exp(0.01)])
        cut = OpenLoop(0.0, 0.005, 1, names, links, (), (), A, -0.1 * B, C, D, ())
        assert cut.unstable([3] * len(links), 0.1) == 1
        assert cut.fastest([3] * len(links), 0.1) == (pytest.approx(2.0), "y")


def test_what_does_not_change_the_poles_is_neutral() -> None:
    """Free arms rest anywhere together, whatever they estimate; a held one rests at the hand."""
    for hand, agree in ((0.0, 2), (20.0, 0)):
        cut = loop(document(0.005, hand=hand))
        X, Y = cut.neutral()
        assert X.shape == (len(cut.states), 6 + agree)
        F, names = cut.closed([60, 60])
        back = (len(names) - len(X)) // cut.sent
        still = np.vstack([X, *[Y] * back])
        assert F @ still == pytest.approx(still, abs=1e-7)
        rest = np.linalg.eigvals(F)
        assert np.count_nonzero(np.abs(rest - 1.0) < 1e-6) >= 6 + agree


def test_differences_give_the_poles_that_are_left() -> None:
    """W(k) = -(v(k) + ... + v(k-d+1)): all poles of the loop but the neutral ones at z = 1."""
    cut, d = loop(document(0.005)), 7
    gone = cut.differences()
    n, p = len(gone.A), cut.sent
    late = np.zeros((n + (d - 1) * p,) * 2)
    row = np.zeros((p, len(late)))
    row[:, :n] = gone.C
    w = -np.hstack([gone.C, *[np.eye(p)] * (d - 1)])
    late[:n, :n] = gone.A
    late[:n] += gone.B @ w
    late[n : n + p] = row + gone.D @ w
    late[n + p :, n:-p] = np.eye((d - 2) * p)
    found = np.linalg.eigvals(late)
    F, _ = cut.closed([5 * d, 5 * d])
    left = [z for z in np.linalg.eigvals(F) if abs(z - 1.0) > 1e-6 and abs(z) > 0.05]
    assert max(np.abs(found)) < 1.0 and len(left) > 10
    for z in left:
        assert np.abs(found - z).min() < 1e-5


def test_response_is_that_of_a_held_force_on_a_mass() -> None:
    """X over f of M ddx = f - b dx, f held for a period: b (z - A)^-1."""
    content: Document = {
        "run": {"step": 0.002, "stop": 0.1},
        "components": {
            "mass": {"model": "fmus.models.pointmass", "parameters": {"m": M, "b": B}},
            "slow": {"model": "fmus.models.operator", "period": H, "inputs": {}},
        },
    }
    cut = opened(build(content, Path("mass.toml")), None, ["mass.f"], ["mass.x"])
    z = np.exp(1j * np.array([0.01, 0.3, 2.0]))
    decay = np.exp(-B * H / M)
    A = np.array([[1.0, (1.0 - decay) * M / B], [0.0, decay]])
    b = np.array([H / B - M / B**2 * (1.0 - decay), (1.0 - decay) / B])
    expected = [np.linalg.solve(x * np.eye(2) - A, b)[0] for x in z]
    assert cut.response([], z)[:, 0, 0] == pytest.approx(expected, rel=1e-7)
