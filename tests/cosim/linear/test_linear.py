"""Linear models against closed forms, against runs, and what has none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.component import Port
from cosim.base.errors import RunError, ScenarioError
from cosim.base.toml import as_toml
from cosim.engine.memory_run import Change, changed, trace
from cosim.engine.simulate import simulate
from cosim.linear.loop import operating_point
from cosim.linear.model import LinearModel
from cosim.linear.poles import near_the_circle
from cosim.linear.scenario import linearized
from cosim.links.storage import load_table
from cosim.loading.files import load
from cosim.record import Run
from cosim.scenario.assemble import assemble
from fmus.arms.dynamics import inertia
from fmus.models import planar2r
from tests.cli.command import Command
from tests.cli.conftest import cosim as cosim  # the command as a fixture
from tests.cosim.blocks import Gain

TELEOPERATION = Path(__file__).parents[3] / "configs" / "teleoperation.toml"
M, B, KP, KD, H = 2.0, 0.7, 20.0, 2.0, 0.01
MASS = f"""
[run]
step = "2 ms"
stop = "1 s"
[components.mass]
model = "fmus.models.pointmass"
parameters = {{ m = {M}, b = {B} }}
start.x = 0.1
inputs.f = "control.f"
[components.control]
model = "tests.cosim.linear.test_linear:Feedback"
period = "{H} s"
"""
WIRED = MASS + 'inputs = { x = "mass.x", dx = "mass.dx" }\n'
LINK = """
[[links]]
from = "mass.{0}"
to = "control.{0}"
delay = {{ law = "constant", delay = 0.034 }}
"""
LINKED = MASS + LINK.format("x") + LINK.format("dx")


class Feedback(Gain):
    """Sampled: f = -KP x - KD dx."""

    inputs: Any = (Port("x", (), "m"), Port("dx", (), "m/s"))
    outputs = (Port("f", (), "N"),)

    def initial(self, u: Any) -> Any:
        return {"f": 0.0}

    def step(self, t: float, h: float, u: Any) -> Any:
        return {"f": -KP * u["x"] - KD * u["dx"]}


class Sign(Feedback):
    """Sampled: a switch instead of a spring."""

    def step(self, t: float, h: float, u: Any) -> Any:
        return {"f": -float(np.sign(u["x"]))}


class Slow(Feedback):
    """Sampled: remembers more than its outputs say."""

    past = 0.0

    def initialize(self, values: Any) -> None:
        self.past = 0.0

    def step(self, t: float, h: float, u: Any) -> Any:
        last, self.past = self.past, u["x"]
        return {"f": -KP * last}


def model(folder: Path, text: str, **options: Any) -> LinearModel:
    path = folder / "mass.toml"
    path.write_text(text)
    return linearized(path, **options)


def held(h: float) -> tuple[Any, Any]:
    """A (2, 2) and B (2, 1) of the mass under a force held for `h` s."""
    decay = np.exp(-B * h / M)
    A = np.array([[1.0, (1.0 - decay) * M / B], [0.0, decay]])
    return A, np.array([[h / B - M / B**2 * (1.0 - decay)], [(1.0 - decay) / B]])


def by_name(found: LinearModel, *names: str) -> list[int]:
    states = [name for name, _ in found.states]
    return [states.index(name) for name in names]


def test_mass_under_sampled_pd_at_two_rates_has_the_closed_form(tmp_path: Path) -> None:
    found = model(tmp_path, WIRED, inputs=["mass.f"], outputs=["mass.x", "control.f"])
    A, b = held(H)
    K = np.array([[KP, KD]])
    order = by_name(found, "mass.x", "mass.dx")
    assert found.period == pytest.approx(H) and len(found.states) == 2
    assert found.A[np.ix_(order, order)] == pytest.approx(A - b @ K, abs=1e-10)
    assert found.B[order] == pytest.approx(b, abs=1e-10)
    assert found.C[:, order] == pytest.approx(np.vstack([[[1.0, 0.0]], -K]), abs=1e-8)
    assert pytest.approx(0.0, abs=1e-10) == found.D
    closed = sorted(np.linalg.eigvals(A - b @ K), key=lambda z: z.imag)
    pole = found.modes()[0]
    assert pole.z == pytest.approx(closed[-1], abs=1e-8)
    s = np.log(closed[-1]) / H
    assert pole.frequency == pytest.approx(abs(s) / (2 * np.pi), rel=1e-8)
    assert pole.damping == pytest.approx(-s.real / abs(s), rel=1e-7)
    assert dict(found.states)["mass.dx"] == "m/s" and found.inputs == (("mass.f", "N"),)


def test_delay_of_a_link_is_in_the_model(tmp_path: Path) -> None:
    found = model(tmp_path, LINKED, inputs=["mass.f"], outputs=["mass.x"])
    A, b = held(0.002)
    n = 17  # 34 ms, in steps of the mass
    late = np.zeros((2 * n + 2, 2 * n + 2))
    late[2:, :-2] = np.eye(2 * n)
    late[:2, :2] = A
    period = late.copy()
    for _ in range(4):
        period = late @ period
    force = np.zeros((1, 2 * n + 2))
    force[0, -2:] = -KP, -KD  # what the controller has at the start of its period
    B5 = sum(np.linalg.matrix_power(A, k) @ b for k in range(5))
    shifted = np.zeros((2 * n + 2, 1))
    for age in range(5):
        shifted[2 * age : 2 * age + 2] = sum(
            (np.linalg.matrix_power(A, k) @ b for k in range(5 - age)), np.zeros((2, 1))
        )
    assert shifted[:2] == pytest.approx(B5)
    closed = np.linalg.eigvals(period + shifted @ force)
    slow = [pole for pole in found.modes() if abs(pole.z) > 0.01]  # faster ones are defective
    assert len(slow) >= 2
    for pole in slow:
        assert np.abs(closed - pole.z).min() < 1e-8


def test_planar_arm_at_a_grip_has_the_model_derived_by_hand(tmp_path: Path) -> None:
    q, k_p, k_d, h = np.array([0.4, 0.9]), 30.0, 3.0, 0.001
    text = f"""
    [run]
    step = "{h} s"
    stop = "0.1 s"
    [components.arm]
    model = "fmus.models.planar2r"
    parameters = {{ k_p = {k_p}, k_d = {k_d}, q_h = {as_toml(q.tolist())} }}
    start.q = {as_toml(q.tolist())}
    """
    found = model(tmp_path, text, inputs=["arm.tau_ext"], outputs=["arm.q"], component="arm")
    theta = next(p.default for p in planar2r.model().parameters() if p.name == "theta")
    inverse = np.linalg.inv(inertia(np.array(theta), q))
    A = np.zeros((6, 6))
    A[:2, 2:4] = np.eye(2)
    A[2:4] = inverse @ np.hstack([-k_p * np.eye(2), -k_d * np.eye(2), np.eye(2)])
    expected = np.eye(6) + sum(
        (
            np.linalg.matrix_power(A * h, k) / float(np.prod(np.arange(1, k + 1)))
            for k in range(1, 9)
        ),
        np.zeros((6, 6)),
    )
    order = by_name(found, "arm.q[0]", "arm.q[1]", "arm.dq[0]", "arm.dq[1]")
    assert len(found.states) == 4
    assert found.A[np.ix_(order, order)] == pytest.approx(expected[:4, :4], abs=1e-9)
    assert found.B[order] == pytest.approx(expected[:4, 4:], abs=1e-9)


def test_adaptive_teleoperation_with_delay_moves_as_its_model_says() -> None:
    settings = [
        "run.stop=21.0",
        *(f'links.{i}.delay={{law="constant",delay=0.1}}' for i in (0, 1)),
    ]
    at, periods, n = 20000, 150, 5  # ticks, periods of the controllers, ticks in one
    pushes = 1e-4 * np.random.default_rng(0).standard_normal((periods, 2))
    found = linearized(
        TELEOPERATION, settings, 20.0, "", ["master.tau_ext"], ["master.q", "slave.dq"]
    )
    plan = assemble(load(TELEOPERATION, settings))
    forces = np.vstack([np.zeros((at, 2)), np.repeat(pushes, n, axis=0)])
    signals = ["master.q", "slave.dq"]
    runs = [
        trace(changed(plan, Change(len(forces) * plan.h, {}, {"master.tau_ext": f})), signals, n)
        for f in (forces, 0.0 * forces)
    ]
    seen = runs[0].less(runs[1])
    x, y = np.zeros(len(found.states)), []
    for u in pushes:
        y.append(found.C @ x + found.D @ u)
        x = found.A @ x + found.B @ u
    run = np.hstack([seen.columns[name] for name in signals])[at // n : at // n + periods]
    scale = np.abs(run).max(axis=0)
    error = np.abs(run - np.array(y)) / scale
    assert (scale > 1e-9).all()  # also the slave, behind the delay
    assert error.max() < 1e-4, error.max()


def test_component_that_remembers_more_than_it_shows_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"control: cannot be linearized .* start values"):
        model(tmp_path, WIRED.replace(":Feedback", ":Slow"))
    ring = (
        WIRED
        + """
    [components.hand]
    model = "fmus.models.reaction"
    period = "20 ms"
    inputs.q = "other.q"
    [components.other]
    model = "fmus.models.planar2r"
    """
    )
    with pytest.raises(RunError, match=r"hand: cannot be linearized .* ring of samples"):
        model(tmp_path, ring)


ENCODER = """
[run]
step = "1 ms"
stop = "0.2 s"
[components.arm]
model = "fmus.models.arm"
sizes.joints = 1
start.q = [0.3]
inputs.tau = "control.tau"
parameters = { damping = [0.2], inertia = [[1.0, 0.0, 0.0, 0.0, 0.3, 0.0, 0.3, 0.0, 0.0, 0.5]] }
[components.encoder]
model = "fmus.models.encoder"
sizes.joints = 1
period = "2 ms"
parameters.T = 0.01
inputs.q = "arm.q"
[components.control]
model = "fmus.models.pd"
sizes.joints = 1
period = "2 ms"
parameters = { K_p = [20.0], K_d = [2.0] }
inputs = { q = "encoder.q_m", dq = "encoder.dq_m" }
start.q_j = [0.0]
start.dq_j = [0.0]
"""


def test_an_encoder_that_remembers_more_than_its_outputs_has_the_closed_form(
    tmp_path: Path,
) -> None:
    """q_m and dq_m of the last step are remembered: two states besides those of the arm."""
    found = model(tmp_path, ENCODER, inputs=["arm.tau_ext"], outputs=["arm.q"])
    h, T, inertia_, damping = 2e-3, 0.01, 0.5, 0.2
    decay = np.exp(-damping * h / inertia_)
    A = np.array([[1.0, (1.0 - decay) * inertia_ / damping], [0.0, decay]])
    b = np.array([h / damping - inertia_ / damping**2 * (1 - decay), (1 - decay) / damping])
    a = h / (h + T)
    loop = np.zeros((4, 4))  # q, dq; q_m, dq_m of the step before
    velocity = np.array([a / h, 0.0, -a / h, 1.0 - a])
    torque = -20.0 * np.array([1.0, 0.0, 0.0, 0.0]) - 2.0 * velocity
    loop[:2, :2] = A
    loop[:2] += np.outer(b, torque)
    loop[2, 0] = 1.0
    loop[3] = velocity
    closed = np.linalg.eigvals(loop)
    slow = [mode for mode in found.modes() if abs(mode.z) > 1e-3]
    assert len(slow) == 2 and np.count_nonzero(np.abs(closed) > 1e-3) == 3  # one is of a pair
    for mode in slow:
        assert np.abs(closed - mode.z).min() < 1e-7


def test_switch_is_reported_as_not_smooth(tmp_path: Path) -> None:
    text = WIRED.replace(":Feedback", ":Sign").replace("start.x = 0.1", "start.x = 0.0")
    assert model(tmp_path, text, time=0.0).errors["control"] > 0.1
    assert max(model(tmp_path, WIRED).errors.values()) < 1e-6


def test_names_and_times_that_are_not_there_are_refused(tmp_path: Path) -> None:
    for options, words in (
        ({"inputs": ["mass.g"]}, "input"),
        ({"outputs": ["mass.y"]}, "signal"),
        ({"component": "mas"}, "component"),
        ({"time": 3.0}, "0 to 1 s"),
    ):
        with pytest.raises(ScenarioError, match=words):
            model(tmp_path, WIRED, **options)


def test_too_many_values_in_flight_are_refused(tmp_path: Path) -> None:
    text = LINKED.replace("0.034", "10.0").replace('stop = "1 s"', 'stop = "10.2 s"')
    with pytest.raises(ScenarioError, match=r"10\d\d\d of them values on their way"):
        model(tmp_path, text)


def test_poles_of_a_loop_with_thousands_of_samples_in_flight_are_exact(tmp_path: Path) -> None:
    """x+ = A x + b f and f = -K x, 1700 steps ago: z^1700 det(z - A) + K adj(z - A) b = 0."""
    text = LINKED.replace("0.034", "3.4").replace('stop = "1 s"', 'stop = "3.6 s"')
    found = model(tmp_path, text.replace(f'period = "{H} s"', 'period = "2 ms"'))
    assert len(found.states) > 3000
    A, b = held(0.002)
    K = np.array([[KP, KD]])
    poles = [mode.z for mode in found.modes()]
    assert len(poles) > 40
    for z in poles:
        back = K @ np.linalg.solve(z * np.eye(2) - A, b)
        assert complex(back[0, 0]) * z ** (-1700) == pytest.approx(-1.0, abs=1e-5)


@pytest.mark.slow
def test_sparse_poles_are_those_of_the_whole_matrix() -> None:
    """All that are near z = 1, with the estimates that integrate; and no others."""
    settings = ["run.stop=20.5", *(f'links.{i}.delay={{law="constant",delay=0.3}}' for i in (0, 1))]
    found = linearized(TELEOPERATION, settings, 20.0)
    dense = np.linalg.eigvals(found.A)
    sparse = near_the_circle(found.A)
    upper = dense[dense.imag >= 0.0]
    nearest = upper[np.argsort(np.abs(upper - 1.0))]
    away = [z for z in nearest if abs(z - 1.0) > 1e-6]
    for z in away[:12]:
        assert np.abs(sparse.z - z).min() < 1e-7
    for z in sparse.z:
        assert np.abs(dense - z).min() < 1e-6
    ones = np.count_nonzero(np.abs(dense - 1.0) < 1e-6)
    assert sparse.integrals + np.count_nonzero(np.abs(sparse.z - 1.0) < 1e-6) <= ones


def test_command_prints_poles_and_writes_both_files(cosim: Command, tmp_path: Path) -> None:
    (tmp_path / "mass.toml").write_text(WIRED)
    done = cosim(
        "analyze",
        "mass.toml",
        "--linear",
        "--inputs",
        "mass.f",
        "--json",
        "m.json",
        "--mat",
        "m.mat",
    )
    assert done.code == 0, done.err
    assert "2 states, 1 inputs, 2 outputs" in done.out and "±" in done.out
    data = json.loads((tmp_path / "m.json").read_text())
    from scipy.io import loadmat

    mat = loadmat(str(tmp_path / "m.mat"))
    assert np.array_equal(mat["A"], np.array(data["A"])) and mat["period"].item() == H
    assert mat["states"][0][1].item() == data["states"][0]["unit"]


@pytest.mark.parametrize("time", [0.0, 1.0, 1.0225, 5.0, 30.0])
def test_samples_in_flight_are_those_of_the_run_at_any_time(time: float, tmp_path: Path) -> None:
    """The tables of links are drawn in stretches, at whose borders no time of a user's is."""
    scenario = load(TELEOPERATION, ["run.stop=30"])
    plan = assemble(scenario)
    at = operating_point(plan, time)
    simulate(scenario, tmp_path / "run")
    assert at.tick == int(time / plan.h) // 5 * 5
    paths = Run.open(tmp_path / "run").link_tables
    assert set(paths) == {link.name for link in plan.links} == set(at.tables)
    for link in plan.links:
        hit = at.tick // plan.component(link.target.component).period
        _, rows = load_table(paths[link.name])
        held = at.tables[link.name]
        assert held[: len(rows) - hit] == rows[hit : hit + len(held)].tolist()
