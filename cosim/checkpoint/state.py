"""The state of a run between two ticks: of the engine, its components, and their texts and logs."""

from __future__ import annotations

import ctypes as c
import json
from collections.abc import Iterator, Mapping
from struct import Struct

from cosim.base.errors import ScenarioError
from cosim.checkpoint import memory, python_state
from cosim.engine.engine import Engine
from cosim.fmi import components
from cosim.native import fmu_log, structs
from cosim.schedule.plan import Plan

Blobs = Mapping[str, bytes]


def refuse(plan: Plan) -> None:
    """Raise ScenarioError, which names all that cannot be saved, if there is any."""
    found = [
        f"{step.name} {reason}"
        for step in plan.components
        if (reason := components.reason_not_serialized(step.component))
    ]
    if plan.buses and not found:
        found = ["a simulated bus is in the plan; expected no bus"]
    if found:
        more = f"; and {len(found) - 6} more" if len(found) > 6 else ""
        raise ScenarioError(
            f"found what a checkpoint cannot save: {'; '.join(found[:6])}{more}", "--checkpoint"
        )


def is_between_ticks(engine: Engine) -> bool:
    """True if all parts of the plan stand at the same tick."""
    divided = engine.bound.divided
    return divided is None or bool((divided.parts["tick"] == engine.tick).all())


def save(engine: Engine) -> dict[str, bytes]:
    """The state at :attr:`Engine.tick`, by name. Raises ScenarioError, FmuError."""
    found = {f"memory/{piece[0]}": memory.save(piece) for piece in memory.pieces(engine)}
    found["drawn"] = json.dumps(engine.drawn).encode()
    texts = components.numbered_texts(step.component for step in engine.plan.components)
    found["texts"] = json.dumps([] if texts is None else texts.all()).encode()
    for step in engine.plan.components:
        if components.stepped_fmu(step.component) is None:
            found[f"python/{step.name}"] = python_state.saved(step.name, step.component)
            continue
        found[f"fmu/{step.name}"], ticked = components.serialized(step.component)
        if ticked:
            found[f"ticked/{step.name}"] = json.dumps(ticked).encode()
        log = components.logged(step.component)
        if log is not None:
            found[f"log/{step.name}"] = c.string_at(c.addressof(log), _LOG + log.used)
    for name, happened, times in _event_times(engine):
        found[f"events/{name}"] = _COUNT.pack(happened.count) + bytes(times)
    return found


def restore(engine: Engine, tick: int, state: Blobs) -> None:
    """Bring an engine that has been initialised to `tick` with the `state` saved there.

    Rows of tables that it has not drawn are drawn again, and kept as in a run. Raises
    ScenarioError, FmuError, RunError; then the engine is of no use.
    """
    try:
        if (drawn := tuple(json.loads(state["drawn"]))) != engine.drawn:
            engine.draw_again(*drawn)
        for step in engine.plan.components:
            if components.stepped_fmu(step.component) is None:
                data = state[f"python/{step.name}"]
                step.component.set_state(python_state.read(step.name, step.component, data))
                continue
            ticked = json.loads(state.get(f"ticked/{step.name}", b"{}"))
            components.set_serialized(step.component, state[f"fmu/{step.name}"], ticked)
            log = components.logged(step.component)
            if log is not None:
                _restore_log(log, state[f"log/{step.name}"])
        texts = components.numbered_texts(step.component for step in engine.plan.components)
        if texts is not None:
            texts.take(json.loads(state["texts"]))
        for piece in memory.pieces(engine):
            memory.restore(piece, state[f"memory/{piece[0]}"])
        for name, happened, _ in _event_times(engine):
            data = state[f"events/{name}"]
            (happened.count,) = _COUNT.unpack_from(data)
            c.memmove(happened.times, data[_COUNT.size :], len(data) - _COUNT.size)
    except (KeyError, ValueError) as error:
        raise ScenarioError(
            f"the checkpoint does not fit this run ({error}); expected one of the same version"
        ) from error
    engine.state.tick = tick


_COUNT = Struct("<q")
_LOG = c.sizeof(structs.LogStruct)
_STEP = structs.LogStruct.step.offset


def _restore_log(log: fmu_log.Log, data: bytes) -> None:
    """Write lines and text into a log; `step` is a pointer, and stays."""
    c.memmove(c.addressof(log), data[:_STEP], _STEP)
    c.memmove(c.addressof(log) + _LOG, data[_LOG:], len(data) - _LOG)


def _event_times(
    engine: Engine,
) -> Iterator[tuple[str, structs.EventTimesStruct, c.Array[c.c_double]]]:
    """The times of events of each FMU that records them."""
    for step, unit in zip(engine.plan.components, engine.bound.units, strict=True):
        typed = structs.TypedStruct.from_address(unit.typed) if unit.typed else None
        if typed is not None and typed.happened:
            found = structs.EventTimesStruct.from_address(typed.happened)
            n = min(found.count, found.room)
            times = (c.c_double * n).from_address(found.times)
            yield step.name, found, times
