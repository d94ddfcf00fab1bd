"""Dynamics of serial chains: published numbers, C = NumPy, and what the equations promise."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest

from cosim.base.errors import FmuError, ScenarioError
from fmus.arms import chain, dynamics
from fmus.arms.joints import Joints
from fmus.models import planar2r
from tests.fmus.chains import ChainInC, compile_chain, energy, fr3, planar, random_chain

Q = np.array([0.1, -0.4, 0.2, -1.9, 0.3, 1.6, -0.5])
DQ = np.array([0.5, -0.4, 0.3, 0.8, -0.6, 0.7, -0.9])
DDQ = np.array([1.0, -2, 3, -1, 0.5, 2, -3])
# Computed with Pinocchio 4.1.0 from the same table, gravity -9.81 m/s2 along z.
FR3_TAU = [3.70335945, -17.75875659, 2.05642539, 19.95072202, 1.05294917, 1.56323078, -0.01795788]
FR3_G = [0, -12.18545103, -2.44713138, 18.64654214, 0.91451288, 1.66588101, -0.01402642]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return compile_chain(tmp_path_factory.mktemp("chain"))


def test_the_fr3_has_the_torques_that_pinocchio_gives_it(library: ctypes.CDLL) -> None:
    table, still = fr3(), np.zeros(7)
    in_c = ChainInC(table, library)
    for inverse in (in_c.inverse, lambda *motion: chain.inverse(table, *motion)):
        assert np.allclose(inverse(Q, DQ, DDQ), FR3_TAU, rtol=0, atol=5e-9)
        assert np.allclose(inverse(Q, still, still), FR3_G, rtol=0, atol=5e-9)


def test_the_hyperbolic_tangent_is_that_of_numpy(library: ctypes.CDLL) -> None:
    x = np.concatenate([10.0 ** np.linspace(-300, 2, 5000), np.linspace(0, 25, 5000)])
    x = np.concatenate([x, -x, [np.inf, -np.inf]])
    y = np.zeros_like(x)
    library.tangents(len(x), ctypes.c_void_p(x.ctypes.data), ctypes.c_void_p(y.ctypes.data))
    assert np.allclose(y, np.tanh(x), rtol=1e-15, atol=0)
    assert np.abs(y).max() == 1.0
    x[:] = np.nan
    library.tangents(len(x), ctypes.c_void_p(x.ctypes.data), ctypes.c_void_p(y.ctypes.data))
    assert np.isnan(y).all()


@pytest.mark.parametrize("n", [1, 2, 7, 16])
def test_c_and_numpy_agree_on_random_chains(library: ctypes.CDLL, n: int) -> None:
    rng = np.random.default_rng(n)
    for _ in range(6):
        table = random_chain(rng, n)
        chain.check(table, "chain")
        q, dq, ddq, tau = rng.uniform(-2, 2, (4, n))
        in_c = ChainInC(table, library)
        expected = chain.inverse(table, q, dq, ddq)
        assert np.allclose(in_c.inverse(q, dq, ddq), expected, rtol=1e-12, atol=1e-12)
        assert np.allclose(in_c.forward(q, dq, expected), ddq, rtol=1e-9, atol=1e-9)
        moved = chain.forward(table, q, dq, tau)
        assert np.allclose(in_c.forward(q, dq, tau), moved, rtol=1e-9, atol=1e-9)


def test_the_power_of_the_torques_changes_the_energy(library: ctypes.CDLL) -> None:
    """dE/dt = dq' tau, for any motion: the armature is not in E."""
    rng = np.random.default_rng(5)
    for _ in range(5):
        table = random_chain(rng, 5)
        q, dq, ddq = rng.uniform(-1, 1, (3, 5))
        h = 1e-4
        after, before = (
            sum(energy(table, q + s * dq + s**2 / 2 * ddq, dq + s * ddq)) for s in (h, -h)
        )
        power = dq @ ChainInC(table, library).inverse(q, dq, ddq)
        assert (after - before) / (2 * h) == pytest.approx(power, rel=1e-6)


@pytest.mark.parametrize("preset", sorted(planar2r.PRESETS))
def test_the_table_of_the_planar_arm_moves_as_the_planar_arm(
    library: ctypes.CDLL, preset: str
) -> None:
    theta = np.array(planar2r.PRESETS[preset]["theta"])
    theta_g = np.array(planar2r.PRESETS[preset].get("theta_g", (0.0, 0.0)))
    table, rng = planar(theta, theta_g), np.random.default_rng(1)
    in_c = ChainInC(table, library)
    for _ in range(20):
        q, dq, ddq = rng.uniform(-3, 3, (3, 2))
        tau = (
            dynamics.inertia(theta, q) @ ddq
            + dynamics.coriolis(theta, q, dq) @ dq
            + dynamics.gravity(theta_g, q)
        )
        assert np.allclose(in_c.inverse(q, dq, ddq), tau, rtol=1e-13, atol=1e-12)
        assert np.allclose(in_c.forward(q, dq, tau), ddq, rtol=1e-12, atol=1e-12)


def test_the_default_table_is_an_arm_of_equal_rods() -> None:
    declared = {v.name: np.reshape(v.starts, v.shape) for v in chain.variables(Joints(3))}
    table = chain.of_values(declared)
    chain.check(table, "chain")
    assert table.joints == 3
    assert np.linalg.eigvalsh(chain.mass_matrix(table, np.array([0.1, 0.5, -1.0])))[0] > 0
    assert np.array_equal(chain.inverse(table, *np.zeros((3, 3))), np.zeros(3))  # horizontal


def test_more_than_sixteen_joints_are_refused() -> None:
    with pytest.raises(FmuError, match="joints is 17; expected at most 16"):
        chain.variables(Joints(17))


def changed(table: chain.Table, name: str, index: tuple[int, ...], value: object) -> chain.Table:
    values = {key: array.copy() for key, array in table.values().items()}
    values[name][index] = value
    return chain.of_values(values)


@pytest.mark.parametrize(
    ("name", "index", "value", "message"),
    [
        ("inertia", (2, 0), -1.0, r"arm\.inertia\[2\]: the mass is -1 kg, expected at least 0"),
        ("inertia", (2, 0), 0.0, r"arm\.inertia\[2\]: without mass, expected all ten"),
        ("inertia", (3, 9), 0.9, r"arm\.inertia\[3\]: .*triangle inequality"),
        ("inertia", (1, 4), -0.1, r"arm\.inertia\[1\]: .*expected none below 0"),
        ("rotation", (4, 0, 0), 2.0, r"arm\.rotation\[4\]: .*expected a rotation matrix"),
    ],
)
def test_a_table_that_no_arm_has_is_refused(
    name: str, index: tuple[int, ...], value: float, message: str
) -> None:
    with pytest.raises(ScenarioError, match=message):
        chain.check(changed(fr3(), name, index, value), "arm")


def test_thin_rods_laminae_and_point_masses_are_bodies() -> None:
    for theta in (
        [1.0, 0.5, 0, 0, 0.0, 0, 1 / 3, 0, 0, 1 / 3],  # a rod
        [1.0, 0, 0, 0, 1.0, 0, 2.0, 0, 0, 3.0],  # a lamina
        [2.0, 1.0, 0, 0, 0, 0, 0.5, 0, 0, 0.5],  # a point at x = 0.5
        [0.0] * 10,
    ):
        assert chain.unphysical(np.array(theta)) is None
