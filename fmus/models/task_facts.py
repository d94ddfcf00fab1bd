"""Facts of the law in the coordinates of a tip, and of what acts there."""

from __future__ import annotations

from collections.abc import Sequence

from cosim.base.copies import replace
from cosim.predict.facts import DynamicFeedback, TipContact, TipTask, Values
from fmus.arms import task_space
from fmus.model.numeric import Array, np
from fmus.models import serial_facts


def arm_task(values: Values) -> DynamicFeedback:
    """The paper's law for a tip, alone or with neighbours."""
    x = _shaped(values)
    m = len(x["lacks"])
    scale = task_space.scales(x)[:, None]

    def jacobian(q: Sequence[float]) -> Array:
        return np.asarray(scale * task_space.rows(x, np.asarray(q, dtype=np.float64)))

    def feedback(q: Sequence[float]) -> Array:
        J = jacobian(q)
        return np.asarray(np.diag(x["K"]) + J.T @ (x["K_x"][:, None] * J))

    def regular(q: Sequence[float]) -> float:
        rows = task_space.rows(x, np.asarray(q, dtype=np.float64))
        return float(task_space.inverse(x, rows)[1] / x["sigma_0"])

    listens = np.reshape(values.get("listens", ()), (-1, m)).tolist()
    task = TipTask(
        jacobian=jacobian,
        feedback=feedback,
        regular=regular,
        lacks=values["lacks"],
        listens=tuple(tuple(row) for row in listens),
        posture=any(values["k_n"]),
    )
    return replace(serial_facts.adaptive(values), regressor=0.0, task=task)


def arm_tip(values: Values) -> TipContact:
    """A hand and a wall at the tip."""
    table, point = serial_facts.table_of(values), np.asarray(values["tip"])
    return TipContact(
        hand=(max(values["K_h"]), min(values["B_h"])),
        wall=(values["k_w"][0], values["b_w"][0]),
        jacobian=lambda q: task_space.jacobian(table, point, np.asarray(q, dtype=np.float64)),
    )


def _shaped(values: Values) -> dict[str, Array]:
    """The part of the flat `values` that ``task_space`` needs, each of its shape."""
    scalars, vectors = ("scale", "sigma_0", "length"), ("K", "K_x", "lacks", "tip", "x_0", "q_0")
    x = {**serial_facts.table_of(values).values(), "frame": np.reshape(values["frame"], (-1, 3))}
    x |= {name: np.asarray(values[name][0]) for name in scalars if name in values}
    return x | {name: np.asarray(values[name]) for name in vectors if name in values}
