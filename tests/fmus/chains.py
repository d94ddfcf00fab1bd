"""Serial chains for tests: published robots, random ones, and the functions of the C headers."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fmus.arms.chain import Table, mass_matrix, placements
from fmus.build import toolchain

# Every function takes the number of joints, and pointers to doubles: the table first.
SOURCE = """
#include "chain_forward.h"
#include "export.h"
#include "hyperbolic.h"

static Chain view(int n, double *const *t) {
    const Chain chain = {n, t[0], t[1], t[2], t[3], t[4], t[5]};
    return chain;
}

EXPORT void inverse(int n, double *const *t, double *q, double *dq, double *ddq, double *tau) {
    const Chain chain = view(n, t);
    chain_inverse(&chain, q, dq, ddq, tau);
}

EXPORT int forward(int n, double *const *t, double *q, double *dq, double *tau, double *ddq) {
    const Chain chain = view(n, t);
    return chain_forward(&chain, q, dq, tau, ddq);
}

EXPORT void tangents(int n, const double *x, double *y) {
    for (int i = 0; i < n; i++) y[i] = hyperbolic_tangent(x[i]);
}

EXPORT void repeat(int n, double *const *t, double *q, double *dq, double *tau, double *ddq,
                   int times) {
    const Chain chain = view(n, t);
    for (int i = 0; i < times; i++) {
        chain_forward(&chain, q, dq, tau, ddq);
        q[0] += 1e-9 * ddq[n - 1];
    }
}
"""


class ChainInC:
    """The functions of ``chain.h`` and ``chain_forward.h`` for one table."""

    def __init__(self, table: Table, library: ctypes.CDLL) -> None:
        self.library = library
        self.n = table.joints
        self._held = [np.ascontiguousarray(a, dtype=float) for a in table.values().values()]
        self.table = (ctypes.c_void_p * 6)(*(a.ctypes.data for a in self._held))

    def _call(self, name: str, *arrays: np.ndarray) -> tuple[np.ndarray, int]:
        held = [np.array(a, dtype=float) for a in arrays]
        out = np.zeros(self.n)
        pointers = [ctypes.c_void_p(a.ctypes.data) for a in (*held, out)]
        return out, getattr(self.library, name)(self.n, self.table, *pointers)

    def inverse(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        return self._call("inverse", q, dq, ddq)[0]

    def forward(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
        ddq, positive = self._call("forward", q, dq, tau)
        assert positive
        return ddq


def compile_chain(folder: Path) -> ctypes.CDLL:
    """The functions of the headers as a library in `folder`."""
    (folder / "chain.c").write_text(SOURCE)
    include = Path(toolchain.__file__).parents[1] / "c"
    output = folder / f"chain{toolchain.shared_suffix()}"
    sources = [folder / "chain.c", include / "trig.c", include / "hyperbolic.c"]
    toolchain.compile_shared(sources, output, include=[include])
    return ctypes.CDLL(str(output))


def rpy(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Rotation about the fixed axes x, y, z in this order."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(z @ y @ x)


def parameters(m: float, centre: np.ndarray, about_centre: np.ndarray) -> np.ndarray:
    """The ten parameters of a link by mass, centre of mass and tensor there."""
    c = np.asarray(centre)
    tensor = about_centre + m * (c @ c * np.eye(3) - np.outer(c, c))
    entries = tensor[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    return np.array([m, *(m * c), *entries])


def symmetric(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float) -> np.ndarray:
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


# Franka FR3: mass, centre of mass, tensor there (xx xy xz yy yz zz), of franka_description.
FR3_LINKS = """
2.9274653454 4.128e-7 -0.0181251324 -0.0386035970 0.0239273165 1.33179e-5 -1.140477e-4 0.0224821613 -0.0019950321 0.0063500983
2.9355370338 0.0031828864 -0.0743221644 0.0088146084 0.0419389463 2.025733e-4 0.0040777842 0.0251451489 -0.0042252158 0.0617021447
2.2449013699 0.0407015686 -0.0048200565 -0.0289730823 0.0241014255 0.0024046946 -0.0028562693 0.0197405327 -0.0021042127 0.0190444945
2.6155955791 -0.0459100965 0.0630492960 -0.0085187868 0.0345299832 0.0132255227 0.0101514300 0.0288816219 -9.762834e-4 0.0412547117
2.3271207594 -0.0016039605 0.0292536262 -0.0972965990 0.0516102785 -0.0057151734 -0.0035673168 0.0478772971 0.0106739851 0.0164236256
1.8170376524 0.0597131221 -0.0410294666 -0.0101692726 0.0054123336 0.0061934564 0.0014219289 0.0140583295 -0.0013140754 0.0160808179
0.6271432862 0.0045225817 0.0086261921 -0.0161633251 2.109239e-4 -2.433299e-5 4.564480e-5 1.771857e-4 8.744070e-5 5.993191e-5
"""  # fmt: skip  # noqa: E501


def fr3() -> Table:
    """Franka FR3 without hand, on the floor."""
    right = np.pi / 2
    origins = [
        ((0, 0, 0.333), 0), ((0, 0, 0), -right), ((0, -0.316, 0), right),
        ((0.0825, 0, 0), right), ((-0.0825, 0.384, 0), -right), ((0, 0, 0), right),
        ((0.088, 0, 0), right),
    ]  # fmt: skip
    links = np.array([line.split() for line in FR3_LINKS.strip().splitlines()], dtype=float)
    return Table(
        joint_type=np.zeros(7),
        rotation=np.array([rpy(roll, 0, 0) for _, roll in origins]),
        origin=np.array([r for r, _ in origins], dtype=float),
        inertia=np.array([parameters(x[0], x[1:4], symmetric(*x[4:])) for x in links]),
        armature=np.zeros(7),
        g=np.array([0.0, 0.0, -9.81]),
    )


def planar(theta: np.ndarray, theta_g: np.ndarray) -> Table:
    """The planar arm of the lumped parameters `theta` (3,), upright if `theta_g` (2,) is not 0."""
    l1, m2, gravity = 1.0, 1.05 * theta[1] ** 2 / theta[2], 9.81 if theta_g.any() else 0.0
    inertia = np.zeros((2, 10))  # theta2 = m2 l1 lc2, theta_g1 = (m1 lc1 + m2 l1) gravity
    inertia[0, 0] = 5.0
    inertia[0, 1] = theta_g[0] / gravity - m2 * l1 if gravity else 0.0
    inertia[0, [6, 9]] = theta[0] - theta[2] - m2 * l1**2  # all mass on the x axis
    inertia[1, [0, 1]] = m2, theta[1] / l1
    inertia[1, [6, 9]] = theta[2]
    return Table(
        joint_type=np.zeros(2),
        rotation=np.array([np.eye(3), np.eye(3)]),
        origin=np.array([[0.0, 0, 0], [l1, 0, 0]]),
        inertia=inertia,
        armature=np.zeros(2),
        g=np.array([0.0, -gravity, 0.0]),
    )


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    return rpy(*rng.uniform(-np.pi, np.pi, 3))


def random_body(rng: np.random.Generator) -> np.ndarray:
    """The ten parameters of some point masses."""
    masses, points = rng.uniform(0.05, 0.5, 6), rng.uniform(-0.2, 0.2, (6, 3))
    bodies = zip(masses, points, strict=True)
    tensor = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in bodies)
    entries = np.asarray(tensor)[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    return np.array([masses.sum(), *(masses @ points), *entries])


def random_chain(rng: np.random.Generator, n: int) -> Table:
    """Revolute and prismatic joints in any order, gravity in any direction."""
    return Table(
        joint_type=(rng.random(n) < 0.3).astype(float),
        rotation=np.array([random_rotation(rng) for _ in range(n)]),
        origin=rng.uniform(-0.4, 0.4, (n, 3)),
        inertia=np.array([random_body(rng) for _ in range(n)]),
        armature=rng.choice([0.0, 0.02], n),
        g=random_rotation(rng) @ np.array([0.0, 0.0, -9.81]),
    )


def energy(table: Table, q: NDArray[np.float64], dq: NDArray[np.float64]) -> tuple[float, float]:
    """(kinetic, potential) energy, J, at q, dq (n,); the potential is 0 at the base's origin."""
    kinetic = 0.5 * dq @ mass_matrix(table, q) @ dq
    potential = 0.0
    for theta, (R, r) in zip(table.inertia, placements(table, q), strict=True):
        potential -= table.g @ (theta[0] * r + R @ theta[1:4])
    return float(kinetic), float(potential)
