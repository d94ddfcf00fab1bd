"""What a scenario says about a link, and the sentences that refuse it.

::

    delay = { law = "constant", delay = "100 ms" }
    delay = { law = "uniform", low = 0.3, high = 1.2, hold = "30 ms" }   # no hold: every sample
    delay = { law = "trace", file = "wifi.csv", lookup = "time", repeat = false }
    delay = { law = "table", file = "links/master-slave.parquet" }       # replay
    semantics = "signal" | "last-arrival" | "newest-stamp" | "fifo" | "playout"
    playout = 1.2                                                       # buffer, for playout only

Numbers are seconds; a text has its unit. Files are relative to the scenario.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec

from cosim.errors import CosimError, ScenarioError
from cosim.links.grid import Grid
from cosim.links.laws import Constant, Law, Uniform
from cosim.links.semantics import Packets, Playout, Rule, Signal
from cosim.links.storage import open_table
from cosim.links.table import DrawnTable, TableSpec
from cosim.links.traces import read_trace
from cosim.units import quantity

Seconds = int | float | str
Semantics = Literal["signal", "last-arrival", "newest-stamp", "fifo", "playout"]


class ConstantDelay(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="law", tag="constant"
):
    """T = delay."""

    delay: Seconds


class UniformDelay(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="law", tag="uniform"
):
    """T ~ U[low, high], drawn every `hold`, or for every sample."""

    low: Seconds
    high: Seconds
    hold: Seconds | None = None


class TraceDelay(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="law", tag="trace"
):
    """T from a file of measured delays (CSV or Parquet: t_send, delay)."""

    file: str
    lookup: Literal["time", "index"] = "time"
    repeat: bool = False


class TableDelay(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="law", tag="table"
):
    """The stored table of a link; what semantics says is in it already."""

    file: str


DelaySpec = ConstantDelay | UniformDelay | TraceDelay | TableDelay


def link_table(
    *,
    delay: DelaySpec | Mapping[str, Any],
    semantics: Semantics,
    playout: Seconds | None = None,
    name: str,
    seed: int,
    h: float,
    sender_period: int,
    receiver_period: int,
    folder: Path,
    place: str = "",
    ticks: int | None = None,
) -> TableSpec:
    """The table of one link.

    `name`: unique in the scenario, decides on the random numbers together with `seed`; `h`: base
    step (s); periods in ticks; `folder`: what files are relative to; `ticks`: length of the run,
    checked against the law if given. With the law "table", `semantics` and `playout` are not
    looked at. Raises ScenarioError that starts with `place`, the file and the path of the link.
    """
    try:
        grid = Grid(sender_period, receiver_period, h)
        delay = _decode(delay)
        table: TableSpec
        if isinstance(delay, TableDelay):
            table = open_table(folder / delay.file, name=name, grid=grid)
        else:
            rule = _rule(semantics, playout)
            table = DrawnTable(name, grid, _law(delay, folder), rule, seed)
        if ticks is not None:
            table.check(-(-ticks // receiver_period))
    except CosimError as error:
        raise ScenarioError(str(error), place) from None
    return table


def _decode(delay: DelaySpec | Mapping[str, Any]) -> DelaySpec:
    if not isinstance(delay, Mapping):
        return delay
    try:
        decoded: DelaySpec = msgspec.convert(delay, DelaySpec)
    except msgspec.ValidationError as error:
        message, _, path = str(error).partition(" - at `$")
        raise ScenarioError(message, f"delay{path.rstrip('`')}") from None
    return decoded


def _law(delay: ConstantDelay | UniformDelay | TraceDelay, folder: Path) -> Law:
    if isinstance(delay, ConstantDelay):
        return Constant(_seconds(delay.delay, "delay"))
    if isinstance(delay, UniformDelay):
        hold = None if delay.hold is None else _seconds(delay.hold, "hold")
        return Uniform(_seconds(delay.low, "low"), _seconds(delay.high, "high"), hold)
    return read_trace(folder / delay.file, lookup=delay.lookup, repeat=delay.repeat)


def _rule(semantics: Semantics, playout: Seconds | None) -> Rule:
    if semantics == "playout":
        if playout is None:
            raise ScenarioError('semantics = "playout" needs the length of its buffer, playout (s)')
        return Playout(_seconds(playout, "playout"))
    if playout is not None:
        raise ScenarioError(
            f'playout = {playout!r} is a buffer, but semantics = "{semantics}" has none;'
            ' expected semantics = "playout"'
        )
    return Signal() if semantics == "signal" else Packets(semantics)


def _seconds(value: Seconds, name: str) -> float:
    if not isinstance(value, str):
        return float(value)
    try:
        return quantity(value, "s")
    except CosimError as error:
        raise ScenarioError(f"{name} = {value!r}: {error}") from None
