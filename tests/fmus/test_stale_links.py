"""The age a link feeds makes the controllers cut it off, and take it up again."""

from __future__ import annotations

from typing import Any

import numpy as np

from cosim.engine.engine import Engine
from tests.cosim.scenarios import plan

DELAY, H = 0.2, 5e-3  # s
SIDES = {"master": [-1.0, -1.5], "slave": [-2.0, 1.0]}


def teleoperator(controller: dict[str, Any], delay: dict[str, Any]) -> dict[str, np.ndarray]:
    """Two arms for 3 s; the outputs of both controllers, (ticks, ...), by name."""
    components: dict[str, Any] = {}
    links = []
    for (side, q), other in zip(SIDES.items(), reversed(SIDES), strict=True):
        law, inputs = f"{side}_control", {"q": f"{side}.q", "dq": f"{side}.dq"}
        components[side] = {
            "model": "fmus.models.planar2r", "start": {"q": q}, "parameters": {"substeps": 5},
            "inputs": {"tau": f"{law}.tau"},
        }  # fmt: skip
        components[law] = {"model": "fmus.models.teleoperation", "inputs": inputs, **controller}
        link = {"from": f"{other}_control.xi", "to": f"{law}.xi_in[0]", "age": f"{law}.age[0]"}
        links.append({**link, "delay": delay})
    made = plan(components, links, step=H, stop=3.0)
    with Engine(made) as engine:
        engine.initialize()
        rows = np.empty((made.ticks + 1, made.n_signals))
        engine.run(made.ticks, rows)
    slots = made.slots()
    return {
        f"{law}.{port}": rows[:-1, slot.start : slot.start + slot.size]
        for law in ("master_control", "slave_control")
        for port in ("tau", "z", "theta_hat", "age")
        if (slot := slots[f"{law}.{port}"])
    }


def same(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> bool:
    return all(np.array_equal(a[name], b[name]) for name in a if not name.endswith("age"))


CONSTANT = {"law": "constant", "delay": DELAY}


def test_links_too_old_leave_two_arms_alone_that_do_not_adapt() -> None:
    cut = teleoperator({"parameters": {"age_max": -1.0}}, CONSTANT)
    alone = teleoperator({"parameters": {"Gamma": 0.0}, "start": {"w": [0.0]}}, CONSTANT)
    assert same(cut, alone)
    assert cut["master_control.age"].max() == DELAY


def test_links_younger_than_age_max_are_as_without_it() -> None:
    free, watched = (
        teleoperator({"parameters": {"age_max": age_max}}, CONSTANT) for age_max in (1e9, 0.21)
    )
    assert same(free, watched)


def test_adaptation_stands_still_while_the_other_side_is_not_heard_and_goes_on_after() -> None:
    law = {"law": "uniform", "low": 0.1, "high": 1.1, "hold": 0.5}
    seen = teleoperator({"parameters": {"age_max": 0.5}}, law)
    stale = seen["master_control.age"][:-1, 0] > 0.5
    moved = (np.diff(seen["master_control.theta_hat"], axis=0) != 0).any(axis=1)
    assert 0 < stale.sum() < len(stale)
    assert np.array_equal(moved[1:], ~stale[1:])  # at the start there is nothing to adapt to
    assert (np.diff(seen["master_control.z"], axis=0) != 0).any(axis=1).all()
