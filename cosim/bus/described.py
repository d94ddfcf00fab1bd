"""Conversion of the settings of a simulated bus to the structs that its C code reads."""

from __future__ import annotations

import ctypes as c
from collections.abc import Iterable, Sequence
from typing import Any

from cosim.base.errors import CosimError
from cosim.bus.frames import BusEvent
from cosim.bus.settings import (
    BusNodeSettings,
    Disturbance,
    ErrorRate,
    Interruption,
    LineLevel,
    ScriptedError,
)
from cosim.bus.structs import (
    BusFilterStruct,
    BusInterruptionStruct,
    BusNodeSettingsStruct,
    BusRateStruct,
    BusScriptStruct,
    BusSettingsStruct,
)
from cosim.bus.timing import BusTiming

MOST_NODES = 4096


class BusSimulationError(CosimError, ValueError):
    """A request that a simulated bus cannot take, or settings that cannot be."""


def bit_ps(bitrate: float) -> int:
    """A bit of this rate (bit/s) in ps, to the nearest."""
    return int(1e12 / bitrate + 0.5)


class DescribedBus:
    """``bus_settings_t`` of a bus, with all that it points to."""

    def __init__(
        self,
        timing: BusTiming,
        nodes: Sequence[BusNodeSettings],
        disturbances: Sequence[Disturbance],
        seed: int,
        record: Iterable[BusEvent],
    ) -> None:
        if not 1 <= len(nodes) <= MOST_NODES:
            raise BusSimulationError(f"found {len(nodes)} nodes, expected 1 to {MOST_NODES}")
        for d in disturbances:
            _check(d, len(nodes))
        self._arrays = {
            "nodes": _nodes(nodes),
            "filters": _filters(nodes),
            "scripts": _array(BusScriptStruct, map(_script, _of(ScriptedError, disturbances))),
            "interruptions": _array(
                BusInterruptionStruct, map(_interruption, _by_start(disturbances))
            ),
            "rates": _array(BusRateStruct, map(_rate, _of(ErrorRate, disturbances))),
        }
        counts = {f"n_{name}": len(array) for name, array in self._arrays.items()}
        places = {name: c.addressof(array) for name, array in self._arrays.items()}
        self.struct = BusSettingsStruct(
            bit=bit_ps(timing.bitrate),
            data_bit=bit_ps(timing.data_bitrate or timing.bitrate),
            seed=seed & (1 << 64) - 1,
            record=sum(1 << kind for kind in set(record)),
            **places,
            **counts,
        )


def _of(kind: type[Any], disturbances: Sequence[Disturbance]) -> list[Any]:
    return [d for d in disturbances if isinstance(d, kind)]


def _by_start(disturbances: Sequence[Disturbance]) -> list[Interruption]:
    return sorted(_of(Interruption, disturbances), key=lambda x: x.start_ps)


def _array(kind: type[c.Structure], values: Iterable[c.Structure]) -> Any:
    rows = list(values)
    return (kind * len(rows))(*rows)


def _nodes(nodes: Sequence[BusNodeSettings]) -> Any:
    rows, first = [], 0
    for node in nodes:
        rows.append(
            BusNodeSettingsStruct(
                queue=node.queue,
                queue_length=node.queue_length,
                receive_length=node.receive_length,
                first_filter=first,
                n_filters=len(node.filters),
                one_shot=node.one_shot,
                recovers=node.recovers,
                inbox=node.inbox,
                tec=node.tec,
                rec=node.rec,
                clock_ppb=round(node.clock_ppm * 1000),
                sample_point=round(node.sample_point * 1000),
                sjw=round(node.sjw * 1000),
            )
        )
        first += len(node.filters)
    return _array(BusNodeSettingsStruct, rows)


def _filters(nodes: Sequence[BusNodeSettings]) -> Any:
    return _array(
        BusFilterStruct,
        (
            BusFilterStruct(
                id=f.identifier,
                mask=f.mask,
                flags=16 * bool(f.extended),
                flag_mask=16 * (f.extended is not None),
            )
            for node in nodes
            for f in node.filters
        ),
    )


def _node(node: int | None) -> int:
    return -1 if node is None else node


def _script(s: ScriptedError) -> BusScriptStruct:
    return BusScriptStruct(
        id=s.identifier,
        extended=s.extended,
        attempt=s.attempt,
        bit=s.bit,
        length=s.length,
        node=_node(s.node),
        level=s.level,
    )


def _interruption(x: Interruption) -> BusInterruptionStruct:
    place = {"from": x.start_ps, "to": x.end_ps}
    return BusInterruptionStruct(node=_node(x.node), level=x.level, **place)


def _rate(r: ErrorRate) -> BusRateStruct:
    return BusRateStruct(rate=r.rate, length=r.length, node=_node(r.node))


def _check(d: Disturbance, nodes: int) -> None:
    if d.node is not None and not 0 <= d.node < nodes:
        raise BusSimulationError(f"found node {d.node} disturbed, expected 0 to {nodes - 1}")
    if isinstance(d, ErrorRate):
        wrong = not 0 <= d.rate < 1 or d.length < 1
        found = f"a rate of {d.rate:g} and a length of {d.length} bits"
        expected = "a rate from 0 to less than 1 and a length of at least 1 bit"
    elif isinstance(d, ScriptedError):
        width = 29 if d.extended else 11
        wrong = d.bit < 0 or d.length < 1 or d.attempt < 0 or d.level == LineLevel.DISCONNECTED
        wrong |= not 0 <= d.identifier < 1 << width
        found = f"identifier {d.identifier:#x}, bit {d.bit}, attempt {d.attempt}, {d.length} bits"
        found += f" {d.level.name.lower()}"
        expected = f"an identifier of {width} bits, bit and attempt of at least 0, at least 1 bit"
        expected += ", and no disconnection"
    else:
        wrong = d.start_ps > d.end_ps or (d.level == LineLevel.DISCONNECTED and d.node is None)
        found = f"an interruption from {d.start_ps / 1e12:g} s to {d.end_ps / 1e12:g} s"
        found += f" ({d.level.name.lower()}, {'the bus' if d.node is None else f'node {d.node}'})"
        expected = "a start before the end, and a node to disconnect"
    if wrong:
        raise BusSimulationError(f"found {found}, expected {expected}")
