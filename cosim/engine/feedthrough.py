"""Direct feed-through of components: which of their outputs depend on an input at once."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import CosimError
from cosim.engine.binding import Vector, Views
from cosim.fmi import components
from cosim.fmi.failures import starting
from cosim.schedule.parts import Step

#: A change of an input that shows in an output, relative to the input or absolute if that is more.
CHANGE = 1e-6


def initial_outputs(step: Step, inputs: Mapping[str, Vector]) -> Vector:
    """All outputs of a component at the start for these inputs, (scalars,), in their units."""
    with starting(step.name):
        found = step.component.initial(inputs)
        return np.concatenate([np.zeros(0), *(np.ravel(found[s.port]) for s in step.outputs)])


def direct_outputs(step: Step, inputs: Views, ports: Collection[str]) -> NDArray[np.bool_]:
    """Which output scalars depend directly on one of the input `ports`, (scalars,).

    An FMU that declares its dependencies is believed. For others each input is changed while they
    are in their initial state, to which they return. `inputs`: the signals of the component.
    """
    declared = components.feedthrough(step.component)
    masks = [np.zeros(0, bool)]
    for slot in step.outputs:
        if slot.port not in declared:
            break
        masks.append(np.full(slot.size, bool(declared[slot.port] & set(ports))))
    else:
        return np.concatenate(masks)
    found = np.zeros(sum(s.size for s in step.outputs), bool)
    places = [(port, i) for port in sorted(ports) for i in range(inputs[port].size)]
    for column in changes(step, inputs, places)[1]:
        found |= column != 0.0
    return found


def changes(
    step: Step, inputs: Views, places: Sequence[tuple[str, int]]
) -> tuple[Vector, list[Vector]]:
    """Outputs at the start, (scalars,), and their derivatives by input scalars, by differences.

    `places`: (port, number) of each. All are in the units of the ports. The component returns to
    its inputs.
    """
    before = initial_outputs(step, inputs)
    columns = []
    for port, i in places:
        changed = {name: np.array(value) for name, value in inputs.items()}
        here = float(np.ravel(inputs[port])[i])
        change = CHANGE * max(1.0, abs(here))
        try:
            _put(changed[port], i, here + change)
            after = initial_outputs(step, changed)
        except CosimError:  # beyond its greatest value
            change = -change
            _put(changed[port], i, here + change)
            after = initial_outputs(step, changed)
        columns.append((after - before) / change)
    if places:
        initial_outputs(step, inputs)
    return before, columns


def _put(array: Vector, i: int, value: float) -> None:
    array[np.unravel_index(i, array.shape)] = value
