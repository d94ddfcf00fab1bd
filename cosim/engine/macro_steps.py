"""Groups with macro steps as ``macro_steps.c`` sees them, and what they have done."""

from __future__ import annotations

import copy
import ctypes as c
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.engine.binding import Vector, Views
from cosim.engine.feedthrough import direct_outputs
from cosim.engine.macro_loops import DirectOutputs, Feedthrough, LoopBinding
from cosim.fmi import components
from cosim.native import shared, structs
from cosim.native.enums import OutputRole, StateMove
from cosim.schedule.macro import BondWires, MacroGroup
from cosim.schedule.operations import group_copies
from cosim.schedule.parts import Step
from cosim.schedule.plan import Plan


def coupled_inputs(group: MacroGroup, step: Step) -> frozenset[str]:
    """Ports of a component that the group feeds, and whose values change within a period."""
    ports = {w.target.port for w in group.wires if w.target.component == step.name}
    return frozenset(ports - step.discrete)


def measure(plan: Plan, inputs: Sequence[Views]) -> Feedthrough:
    """The feed-through of all groups.

    All must be in their initial states. `inputs`: the signals of each component.
    """
    return {
        plan.components[i].name: direct_outputs(plan.components[i], inputs[i], ports)
        for group in plan.groups
        for i in group.components
        if (ports := coupled_inputs(group, plan.components[i]))
    }


class MacroBinding:
    """The structs of all groups of a plan, and the memory to which they point.

    `units`: of each component, which are told that their steps are repeated. `failed` is called
    with an exception of a Python component.
    """

    def __init__(
        self,
        plan: Plan,
        units: c.Array[structs.UnitStruct],
        signals: Vector,
        direct: Feedthrough,
        failed: Callable[[BaseException], None],
    ) -> None:
        self._plan, self._units, self._signals, self._direct = plan, units, signals, direct
        self._failed = failed
        self._alive: list[Any] = []
        self._states: dict[tuple[int, int], object] = {}
        self.macros = (structs.MacroStruct * len(plan.groups))()
        self._bonds: list[c.Array[structs.BondStruct]] = []
        self._found_loops: list[LoopBinding] = []
        self._members = [self._group(i, group) for i, group in enumerate(plan.groups)]

    def saved(self) -> dict[int, list[int]]:
        """Handles of the states that FMUs have saved, by component, once."""
        found: dict[int, list[int]] = {}
        for members in self._members:
            for r in members:
                states = [state for state in r.states if state]
                if states:
                    found[r.unit] = states
                r.states[0] = r.states[1] = None
        return found

    def _group(self, index: int, group: MacroGroup) -> c.Array[structs.RollbackStruct]:
        plan, settings = self._plan, self._plan.adaptive
        assert settings is not None
        steps = [plan.components[i] for i in group.components]
        roles = {step.name: self._roles(step) for step in steps}
        members = (structs.RollbackStruct * len(steps))(
            *(
                self._member(group, i, roles[self._plan.components[i].name])
                for i in group.components
            )
        )
        first = 0
        for member, step in zip(members, steps, strict=True):
            own = [i for i, w in enumerate(group.wires) if w.target.component == step.name]
            member.wire, member.n_wires = (own[0] if own else 0), len(own)
            member.input = sum(w.target.size for w in group.wires[: member.wire])
            member.first, first = first, first + sum(s.size for s in step.outputs)
        direct, loops = self._loops(group, roles)
        operations = group_copies(group, {s.name: s.discrete for s in steps})
        wires = np.zeros(len(operations), np.dtype(structs.OperationStruct))
        for name, _ in structs.OperationStruct._fields_:
            wires[name] = [getattr(op, name) for op in operations]
        start = [self._signals[s.start : s.start + s.size] for x in steps for s in x.outputs]
        largest = np.abs(np.concatenate([np.zeros(0), *start]))
        n_inputs, n_outputs = sum(op.count for op in operations), len(largest)
        memory = np.zeros(max(1, 2 * n_inputs + 5 * n_outputs))
        memory[2 * n_inputs + 4 * n_outputs :][:n_outputs] = largest
        bonds = (structs.BondStruct * len(group.bonds))(
            *(self._bond(group, b) for b in group.bonds)
        )
        self.macros[index] = structs.MacroStruct(
            members=c.addressof(members), n_members=len(members), wires=wires.ctypes.data,
            n_wires=len(wires), bonds=c.addressof(bonds), n_bonds=len(bonds),
            memory=memory.ctypes.data, n_inputs=n_inputs, n_outputs=n_outputs,
            period=group.period, steps=group.steps.start, rejections=group.rejections.start,
            size=group.size.start, tolerance=settings.tolerance, absolute=settings.absolute,
            halvings=group.halvings, iterations=settings.iterations,
            direct=direct.ctypes.data, n_direct=len(direct),
            loops=c.addressof(loops.structs), n_loops=len(loops.structs),
        )  # fmt: skip
        self._alive += [members, wires, memory]
        self._bonds.append(bonds)
        self._found_loops.append(loops)
        return members

    def _loops(
        self, group: MacroGroup, roles: Mapping[str, NDArray[np.uint8]]
    ) -> tuple[NDArray[np.int32], LoopBinding]:
        """The members of a group with direct feed-through, in their order, and their loops."""
        steps = [self._plan.components[i] for i in group.components]
        number = {step.name: i for i, step in enumerate(steps)}
        sets = DirectOutputs(self._plan, group, self._direct, roles).sets()
        direct = np.array([number[name] for one in sets for name in one.names], np.int32)
        outputs = [s.start + i for step in steps for s in step.outputs for i in range(s.size)]
        return direct, LoopBinding(sets, direct, {place: i for i, place in enumerate(outputs)})

    def _roles(self, step: Step) -> NDArray[np.uint8]:
        """``ROLE_`` of its outputs, (scalars,)."""
        jumps = components.jumping_outputs(step.component)
        roles = [
            OutputRole.HELD if s.port in jumps else OutputRole.COUNTED
            for s in step.outputs
            for _ in range(s.size)
        ]
        found = np.array(roles, np.uint8)
        counted = found == OutputRole.COUNTED
        for mask in self._direct.get(step.name, {}).values():
            found[mask & counted] = OutputRole.DIRECT
        return found

    def _member(
        self, group: MacroGroup, index: int, role: NDArray[np.uint8]
    ) -> structs.RollbackStruct:
        step, unit = self._plan.components[index], self._units[index]
        found = structs.RollbackStruct(unit=index, coupled=bool(coupled_inputs(group, step)))
        unit.repeats = 1
        found.roles = role.ctypes.data
        fmu = components.stepped_fmu(step.component)
        if fmu is None:
            call = shared.SAVING(self._call_back(step))
            found.call = shared.address(call)
            self._alive.append(call)
        else:
            found.save, found.restore = fmu.instance.state_functions()
        blocks = _engine_memory(unit)
        size = max(1, sum(size for _, size in blocks))
        copies = [(c.c_char * size)() for _ in range(2)]
        array = (structs.BlockStruct * len(blocks))(*(structs.BlockStruct(*b) for b in blocks))
        found.blocks, found.n_blocks = c.addressof(array), len(array)
        for end in range(2):
            found.copies[end] = c.addressof(copies[end])
        self._alive += [role, array, copies]
        return found

    def _call_back(self, step: Step) -> Callable[[int, int], int]:
        """Saves the state of a Python component; it may keep what it is given, and change it."""

        def call(unit: int, what: int) -> int:
            key = unit, what // StateMove.SAVE_END
            try:
                if what in (StateMove.BACK, StateMove.BACK_END):
                    step.component.set_state(copy.deepcopy(self._states[key]))
                else:
                    self._states[key] = copy.deepcopy(step.component.get_state())
            except BaseException as error:
                self._failed(error)
                return 1
            return 0

        return call

    def _bond(self, group: MacroGroup, bond: BondWires) -> structs.BondStruct:
        first, place = {}, 0
        for i in group.components:
            for slot in self._plan.components[i].outputs:
                first[slot.name] = place - slot.start
                place += slot.size
        effort, flow = bond.effort, bond.flow
        starts = [
            w.source.start + first[f"{w.source.component}.{w.source.port}"] for w in (effort, flow)
        ]
        return structs.BondStruct(
            effort.source.start, effort.target.start, flow.source.start, flow.target.start,
            *starts, effort.target.size, bond.residual.start, effort.gain, flow.gain,
        )  # fmt: skip

    def loop_failure(self, name: str) -> str:
        """The sentence on the algebraic loop that begins at a component, after it was given up."""
        return next(
            loops.failure(i)
            for loops in self._found_loops
            for i, one in enumerate(loops.sets)
            if one.names[0] == name
        )

    def facts(self) -> list[dict[str, Any]]:
        """The steps of each group by their sizes (s), kept and done again."""
        return [
            _facts(self._plan, group, macro, bonds) | {"loops": loops.facts()}
            for group, macro, bonds, loops in zip(
                self._plan.groups, self.macros, self._bonds, self._found_loops, strict=True
            )
        ]


def _facts(
    plan: Plan,
    group: MacroGroup,
    macro: structs.MacroStruct,
    bonds: c.Array[structs.BondStruct],
) -> dict[str, Any]:
    period = group.period * plan.h
    sizes = [
        {"size": period / 2**k, "accepted": macro.accepted[k], "rejected": macro.rejected[k]}
        for k in range(group.halvings + 1)
        if macro.accepted[k] or macro.rejected[k]
    ]
    return {
        "components": [plan.components[i].name for i in group.components],
        "accepted": sum(macro.accepted),
        "rejected": sum(macro.rejected),
        "sizes": sizes,
        "largest_error": macro.worst,
        "forced": macro.forced,
        "forced_at": macro.forced_at if macro.forced else None,
        "bonds": [
            {"name": b.name, "signal": b.residual.name, "total": x.total, "largest": x.largest}
            for b, x in zip(group.bonds, bonds, strict=True)
        ],
    }


def _engine_memory(unit: structs.UnitStruct) -> list[tuple[int, int]]:
    """(address, bytes) of what the engine itself keeps of the state of an FMU."""
    blocks = []
    if unit.typed:
        typed = structs.TypedStruct.from_address(unit.typed)
        blocks.append((unit.typed + structs.TypedStruct.next_event.offset, 8))
        accesses = (structs.AccessStruct * typed.n_discrete).from_address(typed.discrete)
        blocks += [(a.held, 8 * a.count) for a in accesses]
    if unit.exchange:
        blocks.append((unit.exchange + structs.ExchangeStruct.now.offset, 16))
    return blocks
