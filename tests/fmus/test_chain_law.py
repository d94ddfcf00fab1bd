"""Y theta and Y' s of serial chains: published numbers, C = NumPy, what the laws need of them."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np
import pytest

from fmus.arms import chain
from fmus.arms.chain import Table
from fmus.arms.chain_law import regressor
from fmus.build import toolchain
from tests.fmus.chains import fr3, planar, random_body, random_chain

SOURCE = """
#include "chain_law.h"
#include "export.h"

EXPORT void law(int n, double *const *t, double *theta, double *base, double *q, double *dq,
                double *z, double *dz, double *s, double *tau, double *Ys) {
    const Chain chain = {n, t[0], t[1], t[2], t[3], t[4], t[5]};
    Pose pose[CHAIN_MOST];
    chain_pose(&chain, q, pose);
    chain_law(&chain, pose, theta, base, dq, z, dz, s, tau, Ys);
}
"""
Q = np.array([0.1, -0.4, 0.2, -1.9, 0.3, 1.6, -0.5])
DQ = np.array([0.5, -0.4, 0.3, 0.8, -0.6, 0.7, -0.9])
Z = np.array([0.1, 0.2, -0.3, 0.4, -0.5, 0.6, -0.7])
# C(q, dq) z of the FR3, computed with Pinocchio 4.1.0 (computeCoriolisMatrix).
FR3_CZ = [0.03545828, -0.19853209, 0.0192215, 0.15623883, 0.0196771, 0.01441545, 0.00044708]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    folder = tmp_path_factory.mktemp("law")
    (folder / "law.c").write_text(SOURCE)
    include = Path(toolchain.__file__).parents[1] / "c"
    output = folder / f"law{toolchain.shared_suffix()}"
    toolchain.compile_shared([folder / "law.c", include / "trig.c"], output, include=[include])
    return ctypes.CDLL(str(output))


def in_c(
    library: ctypes.CDLL, table: Table, theta: np.ndarray, g: np.ndarray, *motion: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """tau (n,) and Y's (n, 10) at the motion q, dq, z, dz, s."""
    n = table.joints
    held = [np.ascontiguousarray(a, dtype=float) for a in table.values().values()]
    pointers = (ctypes.c_void_p * 6)(*(a.ctypes.data for a in held))
    given = [np.ascontiguousarray(a, dtype=float) for a in (theta, [0, 0, 0, *-g], *motion)]
    tau, Ys = np.zeros(n), np.zeros((n, 10))
    library.law(n, pointers, *(ctypes.c_void_p(a.ctypes.data) for a in (*given, tau, Ys)))
    return tau, Ys


def drawn(rng: np.random.Generator, n: int) -> list[np.ndarray]:
    return [rng.uniform(-2.0, 2.0, n) for _ in range(5)]


def test_coriolis_torques_of_the_fr3_are_those_of_pinocchio(library: ctypes.CDLL) -> None:
    table, none = fr3(), np.zeros(7)
    by_numpy = np.einsum("nik,ik->n", regressor(table, Q, DQ, Z, none, none[:3]), table.inertia)
    by_c, _ = in_c(library, table, table.inertia, none[:3], Q, DQ, Z, none, none)
    for found in (by_numpy, by_c):
        assert np.allclose(found, FR3_CZ, rtol=0, atol=5e-9)


@pytest.mark.parametrize("n", [1, 3, 7])
def test_c_numpy_and_the_dynamics_agree_on_random_chains(library: ctypes.CDLL, n: int) -> None:
    rng = np.random.default_rng(n)
    for _ in range(5):
        table, (q, dq, z, dz, s) = random_chain(rng, n), drawn(rng, n)
        theta = np.array([random_body(rng) for _ in range(n)])
        Y = regressor(table, q, dq, z, dz, table.g)
        tau, Ys = in_c(library, table, theta, table.g, q, dq, z, dz, s)
        assert np.allclose(tau, np.einsum("nik,ik->n", Y, theta), rtol=1e-11, atol=1e-11)
        assert np.allclose(Ys, np.einsum("nik,n->ik", Y, s), rtol=1e-11, atol=1e-11)
        other = Table(**{**table.values(), "inertia": theta, "armature": np.zeros(n)})
        tau, _ = in_c(library, table, theta, table.g, q, dq, dq, dz, s)
        assert np.allclose(tau, chain.inverse(other, q, dq, dz), rtol=1e-11, atol=1e-11)


def test_the_matrix_of_christoffel_symbols_has_its_two_properties() -> None:
    """C(q, dq) z = C(q, z) dq, and dM/dt - 2 C is skew-symmetric."""
    rng = np.random.default_rng(4)
    table = random_chain(rng, 5)
    q, dq, *_ = drawn(rng, 5)
    none = np.zeros(3)

    def coriolis(rate: np.ndarray, z: np.ndarray) -> np.ndarray:
        Y = regressor(table, q, rate, z, np.zeros(5), none)
        return np.asarray(np.einsum("nik,ik->n", Y, table.inertia))

    z = rng.uniform(-2, 2, 5)
    assert np.allclose(coriolis(dq, z), coriolis(z, dq), rtol=0, atol=1e-13)
    C = np.stack([coriolis(dq, unit) for unit in np.eye(5)], axis=1)
    step = 1e-5
    ahead, behind = (chain.mass_matrix(table, q + x * dq) for x in (step, -step))
    skew = (ahead - behind) / (2 * step) - 2 * C
    assert np.allclose(skew, -skew.T, rtol=0, atol=1e-8)


def test_the_planar_arm_is_the_one_of_the_paper(library: ctypes.CDLL) -> None:
    from fmus.arms.dynamics import gravity_regressor
    from fmus.arms.dynamics import regressor as planar_regressor

    rng = np.random.default_rng(8)
    theta, theta_g = np.array([3.34, 1.20, 0.97]), np.array([24.525, 11.772])
    table = planar(theta, theta_g)
    q, dq, z, dz, s = drawn(rng, 2)
    tau, _ = in_c(library, table, table.inertia, table.g, q, dq, z, dz, s)
    expected = planar_regressor(q, dq, z, dz) @ theta + gravity_regressor(q) @ theta_g
    assert np.allclose(tau, expected, rtol=0, atol=1e-12)
