"""Operators and inputs: their equations, when they begin and end, and what they do to an arm."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.component import Component
from cosim.base.errors import CosimError
from cosim.record import Column, Recorder
from fmus.models import decaying_push, endpoint_operator, grasp, minimum_jerk, planar2r, push
from fmus.models.decaying_push import DecayingPush
from fmus.models.endpoint_operator import EndpointOperator, endpoint, jacobian
from fmus.models.grasp import Grasp
from fmus.models.minimum_jerk import MinimumJerk
from fmus.models.push import Push
from fmus.models.replay import Replay
from tests.fmus.pairs import execute

H = 5e-3
Make = Callable[[], Component]
number = st.floats(-10.0, 10.0)
pair = st.tuples(number, number).map(np.array)


def played(component: Component, seconds: float, **values: object) -> dict[str, np.ndarray]:
    """Every output from t = 0 on, a row a step."""
    component.initialize({name: np.array(value, dtype=float) for name, value in values.items()})
    first = component.initial({})
    rows = [component.step(k * H, H, {}) for k in range(round(seconds / H))]
    assert all(np.array_equal(first[name], rows[0][name]) for name in first)
    return {name: np.array([row[name] for row in rows]) for name in first}


# ---- pushes -----------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [Push, push.kernel], ids=["numpy", "c"])
def test_a_push_lasts_from_its_first_to_before_its_last_instant(make: Make) -> None:
    """0.7 s and 1.1 s are no multiples of 5 ms in floating point, but are met all the same."""
    y = played(make(), 2.0, tau_p=[2.0, -1.0], f_p=3.0, t_0=0.7, t_1=1.1)
    on = np.zeros(400, dtype=bool)
    on[140:220] = True
    assert np.array_equal(y["tau_h"], np.where(on[:, None], [2.0, -1.0], 0.0))
    assert np.array_equal(y["f"], np.where(on, 3.0, 0.0))


@given(n=st.integers(1, 100_000), h=st.sampled_from([1e-3, 2e-3, 3e-3, 5e-3, 0.03, 0.1]))
def test_an_instant_that_is_a_multiple_of_the_step_is_met_in_that_step(n: int, h: float) -> None:
    moment = float(f"{n * h:.9g}")  # as a person would write it
    starts, changes = push.kernel(), grasp.kernel()
    starts.initialize({"t_0": np.array(moment)})
    changes.initialize({"times": np.array([moment] + [1e9] * 7), "released": np.array(1.0)})
    for component, name in ((starts, "f"), (changes, "grip")):
        around = [float(component.step(k * h, h, {})[name]) for k in (n - 1, n, n + 1)]
        assert around == [0.0, 1.0, 1.0]


@pytest.mark.parametrize("make", [DecayingPush, decaying_push.kernel], ids=["numpy", "c"])
def test_the_decaying_push_has_a_finite_norm_and_an_integral_without_bound(make: Make) -> None:
    """∫ f² = f_0² T (1 - 1/(t/T + 1)), ∫ f = f_0 T ln(t/T + 1)."""
    y = played(make(), 100.0, f_0=2.0, T=0.5, tau_0=[1.0, -4.0])
    t = np.arange(20_000) * H
    assert np.allclose(y["f"], 2.0 / (t / 0.5 + 1.0), rtol=1e-14)
    assert np.allclose(y["tau_h"], np.outer(y["f"] / 2.0, [1.0, -4.0]), rtol=1e-14)
    assert (y["f"] ** 2).sum() * H == pytest.approx(4.0 * 0.5, rel=0.02)
    assert y["f"].sum() * H == pytest.approx(2.0 * 0.5 * np.log(201.0), rel=0.01)


@pytest.mark.parametrize("make", [DecayingPush, decaying_push.kernel], ids=["numpy", "c"])
def test_the_decaying_push_says_where_it_does_not_exist(make: Make) -> None:
    component = make()
    component.initialize({})
    with pytest.raises(CosimError, match="time is"):
        component.step(-1.0, H, {})


def test_an_arm_that_is_pushed_drifts_at_the_rate_of_the_equations() -> None:
    """Under the paper's law, without a neighbour: v = lambda_M tau / (K alpha)."""
    run = execute(
        {
            "run": {"step": 1e-3, "stop": 80.0},
            "components": {
                "hand": {"model": "fmus.models.push", "parameters": {"tau_p": [0.8, 0.0]}},
                "arm": {
                    "model": "fmus.models.planar2r",
                    "inputs": {"tau": "control.tau", "tau_ext": "hand.tau_h"},
                },
                "control": {
                    "model": "fmus.models.teleoperation",
                    "period": 5e-3,
                    "start": {"w": [0.0]},
                    "inputs": {"q": "arm.q", "dq": "arm.dq"},
                },
            },
        }
    )
    q = run["arm.q"][:, 0]
    assert (q[-1] - q[-20_001]) / 20.0 == pytest.approx(10 * 0.8 / (16 * 0.5), rel=5e-3)


# ---- targets ----------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [MinimumJerk, minimum_jerk.kernel], ids=["numpy", "c"])
def test_minimum_jerk_goes_from_rest_to_rest(make: Make) -> None:
    y = played(
        make(), 4.0, q_0=[1.0, -1.0], q_f=[3.0, 0.0], x_0=[2.0, 0.0], x_f=[0.0, 1.0], t_0=0.5, T=3.0
    )
    q, t = y["q_h"], np.arange(800) * H
    assert np.array_equal(q[0], [1.0, -1.0])
    assert np.allclose(q[-1], [3.0, 0.0], rtol=1e-15)
    assert np.allclose(q[t == 2.0], [[2.0, -0.5]])  # half of the way at half of the time
    assert not y["dq_h"][t <= 0.5].any() and not y["dq_h"][t >= 3.5].any()
    assert y["dq_h"].max() == pytest.approx(30 / 16 * 2.0 / 3.0)  # in the middle
    share = (q[:, 0] - 1.0) / 2.0
    assert np.allclose(y["x_h"], np.outer(1 - share, [2.0, 0.0]) + np.outer(share, [0.0, 1.0]))


@pytest.mark.parametrize("make", [MinimumJerk, minimum_jerk.kernel], ids=["numpy", "c"])
def test_its_velocity_is_that_of_its_position(make: Make) -> None:
    y = played(make(), 4.0, T=3.0)
    for position, velocity in (("q_h", "dq_h"), ("x_h", "dx_h")):
        central = (y[position][2:] - y[position][:-2]) / (2 * H)
        assert np.allclose(y[velocity][1:-1], central, atol=1e-3)


# ---- hands ------------------------------------------------------------------------------------


@given(times=st.lists(st.integers(1, 300), max_size=8), released=st.booleans())
def test_a_grasp_changes_at_each_of_its_times(times: list[int], released: bool) -> None:
    listed = [n * H for n in times] + [1e9] * (8 - len(times))
    for component in (Grasp(), grasp.kernel()):
        grip = played(component, 2.0, times=listed, released=float(released))["grip"]
        changes = np.array([sum(n <= k for n in times) for k in range(400)])
        assert np.array_equal(grip, (1 + released + changes) % 2)


@given(q=pair, dq=pair, x_h=pair, dx_h=pair)
def test_the_hand_at_the_endpoint_is_a_spring_and_a_damper_there(
    q: np.ndarray, dq: np.ndarray, x_h: np.ndarray, dx_h: np.ndarray
) -> None:
    lengths, u = np.array([1.0, 0.7]), {"q": q, "dq": dq, "x_h": x_h, "dx_h": dx_h}
    for hand in (EndpointOperator(), endpoint_operator.kernel()):
        hand.initialize({"l": lengths, "K_h": np.array([100.0, 50.0]), "B_h": np.array([8.0, 4.0])})
        y = hand.step(0.0, H, u)
        dx = (endpoint(lengths, q + 1e-6 * dq) - endpoint(lengths, q - 1e-6 * dq)) / 2e-6
        force = [100.0, 50.0] * (x_h - y["x"]) + [8.0, 4.0] * (dx_h - dx)
        assert np.allclose(y["x"], endpoint(lengths, q))
        assert np.allclose(y["f"], force, rtol=1e-6, atol=1e-6)
        assert np.dot(y["tau_h"], dq) == pytest.approx(np.dot(y["f"], dx), rel=1e-6, abs=1e-5)


@given(q=pair)
def test_the_jacobian_is_the_derivative_of_the_endpoint(q: np.ndarray) -> None:
    lengths = np.array([1.0, 0.7])
    for i, e in enumerate(np.eye(2) * 1e-6):
        slope = (endpoint(lengths, q + e) - endpoint(lengths, q - e)) / 2e-6
        assert np.allclose(jacobian(lengths, q)[:, i], slope, atol=1e-8)


def test_a_hand_leads_the_endpoint_along_a_path() -> None:
    """A target of least jerk, a hand that follows it, an arm that follows the hand."""
    run = execute(
        {
            "run": {"step": 1e-3, "stop": 12.0},
            "components": {
                "target": {"model": "fmus.models.minimum_jerk"},
                "hand": {
                    "model": "fmus.models.endpoint_operator",
                    "inputs": {
                        "q": "arm.q",
                        "dq": "arm.dq",
                        "x_h": "target.x_h",
                        "dx_h": "target.dx_h",
                    },
                },
                "arm": {
                    "model": "fmus.models.planar2r",
                    "start": {"q": [0.0, 0.1]},
                    "inputs": {"tau_ext": "hand.tau_h"},
                },
            },
        }
    )
    assert run.failure is None
    assert np.allclose(run["hand.x"][0], [2.0, 0.0], atol=0.2)
    assert np.allclose(run["hand.x"][-1], [0.0, 1.0], atol=0.1)


def test_a_plain_pd_follows_the_joints_of_a_target() -> None:
    run = execute(
        {
            "run": {"step": 1e-3, "stop": 15.0},
            "components": {
                "target": {"model": "fmus.models.minimum_jerk", "period": 5e-3},
                "hand": {
                    "model": "fmus.models.pd",
                    "preset": "PD(50,10)",
                    "period": 5e-3,
                    "inputs": {
                        "q": "arm.q",
                        "dq": "arm.dq",
                        "q_j": "target.q_h",
                        "dq_j": "target.dq_h",
                    },
                },
                "arm": {"model": "fmus.models.planar2r", "inputs": {"tau": "hand.tau"}},
            },
        }
    )
    assert np.abs(run["arm.q"] - run["target.q_h"]).max() < 0.2
    assert np.allclose(run["arm.q"][-1], [3.5, 3.0], atol=1e-3)


def test_an_arm_that_is_released_goes_on_and_is_caught_again() -> None:
    """The hand of the arm takes the signal: no torque of the operator between the two times."""
    hand = {"k_p": 10.0, "k_d": 5.0, "q_h": [3.5, 3.0]}
    run = execute(
        {
            "run": {"step": 1e-3, "stop": 6.0},
            "components": {
                "when": {
                    "model": "fmus.models.grasp",
                    "parameters": {"times": [0.5, 1.0, *[1e9] * 6]},
                },
                "arm": {
                    "model": "fmus.models.planar2r",
                    "parameters": hand,
                    "inputs": {"grip": "when.grip"},
                },
            },
        }
    )
    tau_h = np.abs(run["arm.tau_h"]).max(axis=1)
    assert tau_h[:500].min() > 0.1
    assert not tau_h[502:1000].any()
    assert tau_h[1002] > 0.1


# ---- recordings -------------------------------------------------------------------------------


def recording(folder: Path) -> Path:
    """A run folder with a vector and a scalar, five rows a quarter of a second apart."""
    columns = [
        Column("m.tau_h[0]", "N.m", 0),
        Column("m.tau_h[1]", "N.m", 1),
        Column("m.f", "N", 2),
    ]
    recorder = Recorder(folder, columns, h=0.25, every=1, rows_per_chunk=8, n_signals=3)
    buffer = recorder.buffer()
    buffer[:5] = np.arange(15.0).reshape(5, 3)
    recorder.submit(buffer, 0, 5)
    recorder.close()
    return folder


TEXT = "t,m.tau_h[0],m.tau_h[1],m.f\n" + "".join(
    f"{0.25 * k},{3 * k},{3 * k + 1},{3 * k + 2}\n" for k in range(5)
)


@pytest.mark.parametrize("kind", ["folder", "parquet", "csv"])
def test_a_recording_is_held_from_row_to_row(kind: str, tmp_path: Path) -> None:
    folder = recording(tmp_path)
    (tmp_path / "run.csv").write_text(TEXT)
    path = {"folder": folder, "parquet": folder / "trajectories.parquet", "csv": folder / "run.csv"}
    signals = {"tau_h": "m.tau_h", "f": "m.f"}
    replay = Replay(path[kind], signals, {"tau_h": "N.m", "f": "N"})
    assert [(p.name, p.shape, p.unit) for p in replay.outputs] == [
        ("tau_h", (2,), "N.m"),
        ("f", (), "N"),
    ]
    replay.initialize({})
    assert np.array_equal(replay.initial({})["tau_h"], [0.0, 1.0])
    for k in range(40):
        row = min(k * 20 // 50, 4)
        y = replay.step(k * 0.1, 0.1, {})
        assert np.array_equal(y["tau_h"], [3 * row, 3 * row + 1]) and y["f"] == 3 * row + 2


def test_an_arm_under_its_recorded_torque_moves_as_it_did(tmp_path: Path) -> None:
    """A hand holds the arm; its torque, played back without the hand, gives the same motion."""
    arm = {"model": "fmus.models.planar2r", "inputs": {"tau": "hand.tau_h"}}
    hand = {"model": "fmus.models.operator", "inputs": {"q": "arm.q", "dq": "arm.dq"}}
    run = {"step": 1e-3, "stop": 1.0}
    first = execute({"run": run, "components": {"arm": arm, "hand": hand}})
    rows = [f"{k / 1000!r},{a!r},{b!r}" for k, (a, b) in enumerate(first["hand.tau_h"].tolist())]
    (tmp_path / "hand.csv").write_text("\n".join(["t,tau[0],tau[1]", *rows]))
    replay = Replay(tmp_path / "hand.csv", {"tau_h": "tau"}, {"tau_h": "N.m"})
    alone = planar2r.kernel()
    alone.initialize({})
    for k in range(len(rows) - 1):
        tau = np.array(replay.step(k * 1e-3, 1e-3, {})["tau_h"])
        q = alone.step(k * 1e-3, 1e-3, {"tau": tau, "tau_ext": np.zeros(2)})["q"]
        assert np.array_equal(q, first["arm.q"][k + 1])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,m.f\n0,1\n1\n", r"run\.csv:3: 1 entries, expected 2"),
        ("t,m.f\n0,1\n1,abc\n", r"run\.csv:3: .*abc"),
        ("m.f\n1\n", "no column 't'"),
        ("t,m.f\n", "no rows"),
        ("t,m.f\n0,1\n0,2\n", "not increasing"),
        ("t,m.f\n0,1\n1,nan\n", "m.f is not finite in row 1"),
        ("t,m.g\n0,1\n", "no signal 'm.f'; did you mean 'm.g'"),
        ("t,m.f[0],m.f[2]\n0,1,2\n", r"m.f lacks its entry \[1\]"),
    ],
)
def test_a_recording_that_cannot_be_played_is_refused(
    text: str, message: str, tmp_path: Path
) -> None:
    (tmp_path / "run.csv").write_text(text)
    with pytest.raises(CosimError, match=message):
        Replay(tmp_path / "run.csv", {"f": "m.f"})


def test_a_recording_that_is_not_there_is_named(tmp_path: Path) -> None:
    for name in ("none.csv", "none"):
        with pytest.raises(CosimError, match=name):
            Replay(tmp_path / name, {"f": "m.f"})
