"""Random networks of the tests' blocks, and a run of a plan in chunks."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from cosim.engine.engine import Engine
from cosim.schedule.plan import Plan

NAMES = ("a", "b", "c", "d", "e")
STEP = 0.25


@st.composite
def networks(draw, models=("Gain", "Integrator"), least=2):
    """Components by name: any wires, rates of 1 to 3 ticks; loops are allowed."""
    names = NAMES[: draw(st.integers(least, len(NAMES)))]
    components = {}
    for name in names:
        model = draw(st.sampled_from(models))
        value = round(draw(st.floats(-1.0, 1.0)), 9)  # files hold no numbers near 1e-300
        spec = {"model": model, "period": STEP * draw(st.integers(1, 3))}
        spec["parameters" if model == "Gain" else "start"] = {
            "gain" if model == "Gain" else "x": value
        }
        source = draw(st.sampled_from([None, *names]))
        if source:
            factor = draw(st.sampled_from([1.0, -0.5]))
            spec["inputs"] = {"u": {"from": f"{source}.y", "gain": factor}}
        components[name] = spec
    return components


def record(plan: Plan, sizes=()) -> np.ndarray:
    """A plan's recording, (ticks + 1, n_signals), run in chunks of `sizes` and the rest."""
    rows = np.empty((plan.ticks + 1, plan.n_signals))
    with Engine(plan) as engine:
        engine.initialize()
        for n in (*sizes, plan.ticks):
            first = engine.tick
            engine.run(min(n, plan.ticks - first), rows[first:])
        rows[plan.ticks] = engine.signals
    return rows


def column(plan: Plan, rows: np.ndarray, name: str) -> np.ndarray:
    """The column of a scalar signal."""
    return rows[:, plan.slots()[name].start]
