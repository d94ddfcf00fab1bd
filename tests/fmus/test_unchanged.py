"""Golden trajectories: what the kernels gave once they give for ever, to the last bit.

The numbers were taken from the arm without gravity and the controller of eqs (76)-(81) alone; every
option added since has to leave them as they are. The digests hold for every compiler, processor
and system. Inputs come from exact arithmetic, not from a library that may change.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from hashlib import sha256

import numpy as np
import pytest

from cosim.base.component import Component
from fmus.models import operator, planar2r, teleoperation, xi

H, STEPS = 5e-3, 2000
Q_H = np.array([3.5, 3.0])
DRAWN = ("tau", "tau_ext", "q", "dq", "xi_in", "w")

ARM = {
    "q": np.array([-1.0, 0.5]),
    "k_p": np.array([10.0, 5.0]),
    "k_d": np.array([5.0, 4.0]),
    "k_w": np.array([200.0, 50.0]),
    "b_w": np.array([0.0, 3.0]),
    "q_w": np.array([0.75, -0.25]),
    "substeps": np.array(2.0),
}
CONTROLLER = {
    "Gamma": np.array([1.0, 0.5, 0.125]),
    "tau_max": np.full(2, 48.0),
    "z": np.array([0.5, -0.5]),
    "theta_hat": np.array([3.0, 1.0, 1.0]),
}
LAW = "tau xi s z theta_hat"


def dyadic() -> Iterator[float]:
    """Numbers in [-3, 3), each exact in binary, by a linear congruence modulo 2^32."""
    state = 1
    while True:
        state = (1664525 * state + 1013904223) % 2**32
        yield (state >> 8) / 2**24 * 6.0 - 3.0


def held(component: Component) -> dict[str, np.ndarray]:
    """What every input holds when nothing is wired to it."""
    return {p.name: np.reshape(p.default or [0.0] * p.size, p.shape) for p in component.inputs}


def alone(component: Component, values: dict[str, np.ndarray], outputs: str) -> str:
    """Outputs of a component whose inputs jump about."""
    numbers, digest, u = dyadic(), sha256(), held(component)
    if "q_h" in u:
        u["q_h"] = Q_H
    component.initialize(values)
    for k in range(STEPS):
        for name in (name for name in u if name in DRAWN):
            u[name] = np.reshape([next(numbers) for _ in range(u[name].size)], u[name].shape)
        y = component.step(k * H, H, u)
        for name in outputs.split():
            digest.update(np.array(y[name], dtype="<f8").tobytes())
    return digest.hexdigest()[:32]


def pair(lambda_M: float) -> str:
    """The teleoperator of Sec. VII-C in a grip and at a wall, the links 0.75 s late each way."""
    grip = {"k_p": np.full(2, 10.0), "k_d": np.full(2, 5.0), "substeps": np.array(5.0)}
    wall = {"k_w": np.full(2, 200.0), "q_w": np.full(2, 1.0), "substeps": np.array(5.0)}
    starts = (grip | {"q": np.array([-1.0, -1.5])}, wall | {"q": np.array([-2.0, 1.0])})
    arms, laws = [planar2r.kernel() for _ in "12"], [teleoperation.kernel() for _ in "12"]
    for arm, law, start in zip(arms, laws, starts, strict=True):
        arm.initialize(start)
        law.initialize({"lambda_M": np.array(lambda_M)})
    inside, seen = [held(arm) for arm in arms], [held(law) for law in laws]
    inside[0]["q_h"] = Q_H
    y = [arm.initial(u) for arm, u in zip(arms, inside, strict=True)]
    sent: list[list[np.ndarray]] = [[], []]
    digest = sha256()
    for k in range(STEPS):
        for i in range(2):
            sent[i].append(np.array(y[i]["dq"]) + 0.5 * np.array(y[i]["q"]))
        for i in range(2):
            received = sent[1 - i][max(0, k - 150)].reshape(1, 2)
            seen[i] |= {"q": y[i]["q"], "dq": y[i]["dq"], "xi_in": received}
            inside[i]["tau"] = laws[i].step(k * H, H, seen[i])["tau"]
        y = [arms[i].step(k * H, H, inside[i]) for i in range(2)]
        for each in y:
            for name in ("q", "dq", "tau_h", "tau_e"):
                digest.update(np.array(each[name], dtype="<f8").tobytes())
    return digest.hexdigest()[:32]


@pytest.mark.parametrize(
    ("component", "values", "outputs", "expected"),
    [
        (planar2r.kernel, ARM, "q dq tau_h tau_e", "d56600a2f9d6d63bdcc538d4d0cc1fee"),
        (teleoperation.kernel, CONTROLLER, LAW, "5060e684a757d1350f628732cf4e6d2d"),
        (partial(teleoperation.kernel, 2), CONTROLLER, LAW, "93cdd3f9ecbf9cae6c8d70117a3822ed"),
        (operator.kernel, {}, "tau_h", "79cd9ecb8d4c2b453f762f9384235fbe"),
        (xi.kernel, {}, "xi", "9df6450443f7c908ca0f2b965a7aa531"),
    ],
    ids=["planar2r", "teleoperation", "teleoperation_n2", "operator", "xi"],
)
def test_a_kernel_gives_what_it_always_gave(
    component: Callable[[], Component], values: dict[str, np.ndarray], outputs: str, expected: str
) -> None:
    assert alone(component(), values, outputs) == expected


@pytest.mark.parametrize(
    ("lambda_M", "expected"),
    [(10.0, "0c24876a4bcd292d3427989ab3fe63d9"), (1.0, "0302f77ae6aae300700e86c275f85437")],
)
def test_a_teleoperator_moves_as_it_always_moved(lambda_M: float, expected: str) -> None:
    assert pair(lambda_M) == expected
