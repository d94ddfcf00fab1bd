"""Two masses on springs with dampers, divided in three ways, and their exact motion.

Each mass is integrated exactly for a held force by the exponential of its matrix, so that every
error is one of the coupling. The coupling spring is a component of its own without a state
(``Spring``), or part of the second mass (``MassWithSpring``): in both its force depends directly on
the positions that come in (Schweizer and Lu 2014 call the second force-displacement coupling).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from cosim.base.component import Parameter, Port

#: Mass (kg), stiffness (N/m) and damping (N.s/m) to the wall; of the coupling.
M, K, D = 1.0, 1.0, 0.1
K_C, D_C = 4.0, 0.2
#: Positions and velocities at the start.
START = (1.0, 0.0, 0.0, 0.5)


def exponential(matrix: np.ndarray) -> np.ndarray:
    """exp(matrix), by scaling and squaring of its series."""
    scaled, term = matrix / 64.0, np.eye(len(matrix))
    total = term.copy()
    for n in range(1, 20):
        term = term @ scaled / n
        total = total + term
    for _ in range(6):
        total = total @ total
    return total


@lru_cache(maxsize=200)
def _held(h: float, k: float, d: float) -> np.ndarray:
    """The step of (x, v, force) with a held force."""
    return exponential(h * np.array([[0.0, 1.0, 0.0], [-k / M, -d / M, 1.0 / M], [0.0, 0.0, 0.0]]))


def exact(t: np.ndarray, k_c: float = K_C, d_c: float = D_C, start=START) -> np.ndarray:
    """x1, v1, x2, v2 at times t (n,), which are multiples of t[1]: (n, 4)."""
    a = np.array([
        [0, 1, 0, 0],
        [-(K + k_c) / M, -(D + d_c) / M, k_c / M, d_c / M],
        [0, 0, 0, 1],
        [k_c / M, d_c / M, -(K + k_c) / M, -(D + d_c) / M],
    ])  # fmt: skip
    step, rows = exponential(float(t[1]) * a), [np.array(start)]
    for _ in t[1:]:
        rows.append(step @ rows[-1])
    return np.array(rows)


class Mass:
    """A mass on a spring and a damper, and the force on it."""

    kind = "continuous"
    inputs = (Port("force"),)
    outputs = (Port("x"), Port("v"))
    parameters = (Parameter("x0", (0.0,)), Parameter("v0", (0.0,)))

    def initialize(self, values):
        self.state = np.array([float(values.get("x0", 0.0)), float(values.get("v0", 0.0))])

    def initial(self, u):
        return {"x": self.state[0], "v": self.state[1]}

    def step(self, t, h, u):
        self.state[:] = (_held(h, K, D) @ [*self.state, float(u["force"])])[:2]
        return {"x": self.state[0], "v": self.state[1]}

    def get_state(self):
        return self.state  # not a copy: what keeps it must make one

    def set_state(self, state):
        self.state = state


class Spring:
    """Force of a spring and a damper between two ends: on the first, and on the second."""

    kind = "continuous"
    inputs = (Port("x1"), Port("v1"),
              Port("x2"), Port("v2"))  # fmt: skip
    outputs = (Port("force", (2,)),)
    parameters = (Parameter("k", (K_C,)), Parameter("d", (D_C,)))

    def initialize(self, values):
        self.k, self.d = float(values.get("k", K_C)), float(values.get("d", D_C))

    def initial(self, u):
        force = self.k * (u["x2"] - u["x1"]) + self.d * (u["v2"] - u["v1"])
        return {"force": [float(force), float(-force)]}

    def step(self, t, h, u):
        return self.initial(u)

    def get_state(self):
        return None

    def set_state(self, state):
        del state


class MassWithSpring(Mass):
    """The second mass, with the coupling spring: it gives the force on the first one."""

    inputs = (Port("x1"), Port("v1"))
    outputs = (*Mass.outputs, Port("force"))

    def _outputs(self, u):
        x, v = self.state
        force = K_C * (x - u["x1"]) + D_C * (v - u["v1"])
        return {"x": x, "v": v, "force": float(force)}

    def initial(self, u):
        return self._outputs(u)

    def step(self, t, h, u):
        given = K_C * u["x1"] + D_C * u["v1"]
        self.state[:] = (_held(h, K + K_C, D + D_C) @ [*self.state, float(given)])[:2]
        return self._outputs(u)


BLOCKS = "tests.cosim.algorithms.masses"


def with_spring(k: float = K_C, d: float = D_C) -> dict:
    """Two masses and a spring between them: three components."""
    x1, v1, x2, v2 = START
    return {
        "first": {"model": f"{BLOCKS}:Mass", "start": {"x0": x1, "v0": v1},
                  "inputs": {"force": "spring.force[0]"}},
        "second": {"model": f"{BLOCKS}:Mass", "start": {"x0": x2, "v0": v2},
                   "inputs": {"force": "spring.force[1]"}},
        "spring": {"model": f"{BLOCKS}:Spring", "parameters": {"k": k, "d": d},
                   "inputs": {"x1": "first.x", "v1": "first.v", "x2": "second.x",
                              "v2": "second.v"}},
    }  # fmt: skip


def force_displacement() -> dict:
    """A mass, and one with the spring: two components."""
    x1, v1, x2, v2 = START
    return {
        "first": {"model": f"{BLOCKS}:Mass", "start": {"x0": x1, "v0": v1},
                  "inputs": {"force": "second.force"}},
        "second": {"model": f"{BLOCKS}:MassWithSpring", "start": {"x0": x2, "v0": v2},
                   "inputs": {"x1": "first.x", "v1": "first.v"}},
    }  # fmt: skip
