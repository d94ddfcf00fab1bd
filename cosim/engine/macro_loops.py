"""Components with direct feed-through in a group with macro steps: their order, and their loops."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cosim.native import enums, structs
from cosim.native.enums import OutputRole
from cosim.schedule.macro import MacroGroup
from cosim.schedule.order import sequence, strongly_connected
from cosim.schedule.parts import Slot, Step, Wire
from cosim.schedule.plan import Plan

#: Of the components in groups, by name: which outputs depend directly on each input from the group,
#: (scalars,) by port.
Feedthrough = Mapping[str, Mapping[str, NDArray[np.bool_]]]

#: Passes over a loop that are remembered, at most.
KEPT = 20
#: Components, and wires, of a loop that are named.
NAMED = 6


@dataclass(frozen=True, slots=True)
class DirectSet:
    """Components that wait for each other, in the order in which they are passed over; or one.

    `loop`: the wires by which they wait, of one component: for itself; without any it is no loop.
    `outputs`: their signals with direct feed-through; first the `fed_back` ones, which a component
    takes that comes before theirs, or theirs.
    """

    names: tuple[str, ...]
    loop: tuple[Wire, ...]
    outputs: tuple[int, ...]
    fed_back: int


@dataclass(frozen=True, slots=True)
class DirectOutputs:
    """The outputs with direct feed-through of a group. `roles`: ``ROLE_`` of all, (scalars,), by
    component.
    """

    plan: Plan
    group: MacroGroup
    feedthrough: Feedthrough
    roles: Mapping[str, NDArray[np.uint8]]

    def sets(self) -> list[DirectSet]:
        """Each after those whose outputs it needs at once."""
        names = [self.plan.components[i].name for i in self.group.components]
        direct = {name for name in names if any(mask.any() for mask in self._masks(name).values())}
        edges = [
            (w.source.component, w.target.component)
            for w in self.group.wires
            if w.source.component in direct and self._depends(w.source)
        ]
        waits = [w for w in self.group.wires if self._passes_on(w)]
        pairs = [(w.source.component, w.target.component) for w in waits]
        found = [
            part
            for block in strongly_connected(direct, edges)
            for part in strongly_connected(block, pairs)
        ]
        place = {name: i for i, part in enumerate(found) for name in part}
        loops: defaultdict[int, list[Wire]] = defaultdict(list)
        for w in waits:
            if place[w.source.component] == place[w.target.component]:
                loops[place[w.source.component]].append(w)
        return [self._set(part, loops[i]) for i, part in enumerate(found)]

    def _set(self, names: tuple[str, ...], loop: Sequence[Wire]) -> DirectSet:
        order = sequence(names, [(w.source.component, w.target.component) for w in loop])
        back = {
            place
            for w in loop
            if order.index(w.source.component) >= order.index(w.target.component)
            for place in self._direct(w.source)
        }
        others = {
            place
            for name in order
            for slot in self.plan.component(name).outputs
            for place in self._direct(slot)
        }
        places = (*sorted(back), *sorted(others - back))
        return DirectSet(order, tuple(loop), places, len(back))

    def _masks(self, name: str) -> Mapping[str, NDArray[np.bool_]]:
        return self.feedthrough.get(name, {})

    def _passes_on(self, wire: Wire) -> bool:
        """True if it ends at an input on which outputs depend at once, and begins at such one."""
        name = wire.target.component
        mask = self._masks(name).get(wire.target.port)
        if mask is None or not self._direct(wire.source):
            return False
        return bool((self.roles[name][mask] == OutputRole.DIRECT).any())

    def _depends(self, slot: Slot) -> bool:
        part = _part(self.plan.component(slot.component), slot)
        return any(bool(mask[part].any()) for mask in self._masks(slot.component).values())

    def _direct(self, slot: Slot) -> list[int]:
        """The signals of a slot with direct feed-through."""
        step = self.plan.component(slot.component)
        roles = self.roles[step.name][_part(step, slot)]
        return [slot.start + i for i, role in enumerate(roles) if role == OutputRole.DIRECT]


def _part(step: Step, slot: Slot) -> slice:
    """The place of a slot among all outputs of its component."""
    first = slot.start - step.outputs[0].start
    return slice(first, first + slot.size)


class LoopBinding:
    """The structs of the loops of a group, and the memory to which they point.

    `members`: components of the group in the order of `direct`, as C has them; `places`: of each
    output signal, where it is in the vectors of the group.
    """

    def __init__(
        self, sets: Sequence[DirectSet], direct: NDArray[np.int32], places: Mapping[int, int]
    ) -> None:
        self.sets = [one for one in sets if one.loop]
        self.structs = (structs.LoopStruct * len(self.sets))()
        self._alive: list[NDArray[np.generic]] = [direct]
        first = count = 0
        for one in sets:
            if one.loop:
                self.structs[count] = self._struct(one, direct[first:], places)
                count += 1
            first += len(one.names)

    def _struct(
        self, one: DirectSet, members: NDArray[np.int32], places: Mapping[int, int]
    ) -> structs.LoopStruct:
        n, fed, kept = len(one.outputs), one.fed_back, min(one.fed_back, KEPT)
        outputs = np.array(one.outputs, np.int64)
        found = np.array([places[i] for i in one.outputs], np.int64)
        memory = np.zeros(4 * n + 2 * fed + kept * (n + fed + 1))
        self._alive += [outputs, found, memory]
        return structs.LoopStruct(
            members=members.ctypes.data, outputs=outputs.ctypes.data, places=found.ctypes.data,
            memory=memory.ctypes.data, n_members=len(one.names), n_outputs=n, n_fed_back=fed,
            n_kept=kept,
        )  # fmt: skip

    def facts(self) -> list[dict[str, object]]:
        """The number of solutions of each loop, and the passes that they took."""
        return [
            {"components": list(one.names), "solved": x.solved, "passes": x.passes}
            for one, x in zip(self.sets, self.structs, strict=True)
        ]

    def failure(self, index: int) -> str:
        """The sentence on the loop number `index` after it was given up."""
        one = self.sets[index]
        wires = [f"{w.source.name} -> {w.target.name}" for w in one.loop]
        return (
            f"outputs of {_listed(one.names)} depend on each other at once, by {_listed(wires)}; "
            f"{enums.LOOP_PASSES} passes over this algebraic loop did not make them agree (the "
            f"last one changed them by {self.structs[index].left:.3g} tolerances), and shorter "
            "steps do not help: solve the loop inside one component, or let one of the outputs "
            "depend on a state instead of its input"
        )


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more
