"""Direct feed-through of components: which of their outputs depend on an input at once."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import CosimError
from cosim.engine.binding import Vector, Views
from cosim.fmi import components
from cosim.fmi.failures import starting
from cosim.schedule.parts import Step

#: Changes of an input that show in an output, relative to the input or absolute if that is more:
#: what depends on its cube is seen by a large one only.
CHANGES = (1e-6, -1e-6, 1.0)


def initial_outputs(step: Step, inputs: Mapping[str, Vector]) -> Vector:
    """All outputs of a component at the start for these inputs, (scalars,), in their units."""
    with starting(step.name):
        found = step.component.initial(inputs)
        return np.concatenate([np.zeros(0), *(np.ravel(found[s.port]) for s in step.outputs)])


def direct_outputs(
    step: Step, inputs: Views, ports: Collection[str]
) -> dict[str, NDArray[np.bool_]]:
    """Masks (scalars,) of the outputs that depend directly on each of the input `ports`.

    An FMU that declares its dependencies is believed. For others each input is changed while they
    are in their initial state, to which they return. `inputs`: the signals of the component.
    """
    n = sum(s.size for s in step.outputs)
    found = {port: np.zeros(n, bool) for port in sorted(ports)}
    declared = components.feedthrough(step.component)
    if all(slot.port in declared for slot in step.outputs):
        for port, mask in found.items():
            masks = [np.full(s.size, port in declared[s.port]) for s in step.outputs]
            mask[:] = np.concatenate([np.zeros(0, bool), *masks])
        return found
    places = [(port, i) for port in found for i in range(inputs[port].size)]
    for (port, _), depends in zip(places, dependent_outputs(step, inputs, places), strict=True):
        found[port] |= depends
    return found


def dependent_outputs(
    step: Step, inputs: Views, places: Sequence[tuple[str, int]]
) -> list[NDArray[np.bool_]]:
    """For some input scalars, which outputs of a component change with them, (scalars,).

    `places`: (port, number) of each; `inputs`: in the units of the ports. The component returns to
    them.
    """
    before = initial_outputs(step, inputs)
    found = [_dependent(step, inputs, place, before) for place in places]
    if places:
        initial_outputs(step, inputs)
    return found


def _dependent(
    step: Step, inputs: Views, place: tuple[str, int], before: Vector
) -> NDArray[np.bool_]:
    port, i = place
    here = float(np.ravel(inputs[port])[i])
    found = np.zeros(len(before), bool)
    for change in CHANGES:
        changed = {name: np.array(value) for name, value in inputs.items()}
        place_ = np.unravel_index(i, changed[port].shape)
        changed[port][place_] = here + change * max(1.0, abs(here))
        with suppress(CosimError):  # it may be beyond the limits of the input
            found |= initial_outputs(step, changed) != before
    return found
