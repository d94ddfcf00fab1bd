"""Rows of arrays and enumerators that are written by hand are those of the C headers."""

from __future__ import annotations

import ctypes as c
from enum import IntEnum
from typing import Any

import numpy as np
import pytest

import bridge.native.structs as native
from bridge.native import faults
from bridge.native.enums import FRAME_DATA
from bridge.native.frame import frame_dtype
from bridge.wiring.wiring import heard_dtype, row_dtype
from cosim.bus import enums, frames, settings, structs
from tests.bridge.deployments import named
from tests.c_probe import enums_in

KINDS = enums_in(frames, settings)


def places(row: np.dtype[Any], struct: type[c.Structure]) -> dict[str, tuple[int, int]]:
    """Offset and size (bytes) in C of the fields of `row` that `struct` has."""
    fields = {name: getattr(struct, name, None) for name in row.names or ()}
    return {name: (field.offset, field.size) for name, field in fields.items() if field}


def own(row: np.dtype[Any]) -> dict[str, tuple[int, int]]:
    """Offset and size (bytes) of the fields of `row`."""
    assert row.fields is not None
    return {name: (offset, kind.itemsize) for name, (kind, offset, *_) in row.fields.items()}


@pytest.mark.parametrize(
    ("row", "struct"),
    [
        (frames.FRAME, structs.CanFrameStruct),
        (frames.REQUEST, structs.BusRequestStruct),
        (frames.EVENT, structs.BusEventStruct),
        (frames.RECEIVED, structs.BusReceivedStruct),
        (faults.INJECTED, native.InjectedStruct),
        (frame_dtype(FRAME_DATA), native.Frame),
    ],
    ids=["frame", "request", "event", "received", "injected", "frame of the bridge"],
)
def test_a_row_is_the_struct_of_c(row: np.dtype[Any], struct: type[c.Structure]) -> None:
    assert places(row, struct) == own(row)
    assert row.itemsize == c.sizeof(struct)


def test_rows_of_journals_begin_with_the_structs_of_c() -> None:
    system = named("can")
    for name, plan in system.nodes.items():
        row, heard = row_dtype(plan), heard_dtype(system, name)
        inlet = row["inlets"].base
        assert places(inlet, native.InletRowStruct) == own(inlet)
        assert inlet.itemsize == c.sizeof(native.InletRowStruct)
        for journal, struct, after in (
            (row, native.RowStruct, "inlets"),
            (heard, native.HeardStruct, "values"),
        ):
            head = {field: place for field, place in own(journal).items()
                    if place[0] < own(journal)[after][0]}  # fmt: skip
            assert places(journal, struct) == head
            assert own(journal)[after][0] == c.sizeof(struct)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_an_enumeration_of_the_bus_is_that_of_c(kind: type[IntEnum]) -> None:
    prefix = KINDS[kind]
    there = {name: value for name, value in vars(enums).items() if name.startswith(prefix)}
    assert {prefix + name: member.value for name, member in kind.__members__.items()} == there
