"""What a scenario says about a link, and the sentences that refuse it.

::

    delay = { law = "constant", delay = "100 ms" }
    delay = { law = "uniform", low = 0.3, high = 1.2, hold = "30 ms" }   # no hold: every sample
    delay = { law = "gamma", shift = "20 ms", shape = 2, scale = "5 ms", maximum = "200 ms" }
    delay = { law = "lognormal", shift = "20 ms", median = "8 ms", sigma = 0.8, maximum = 0.2 }
    delay = { law = "markov", levels = [0.05, 0.2], dwell = [2.0, 0.5], step = "10 ms" }
    delay = { law = "trace", file = "wifi.csv", lookup = "time", repeat = false }
    delay = { law = "table", file = "links/master-slave.parquet" }       # replay
    loss = { law = "independent", p = "1 %" }                            # beside any but "table"
    loss = { law = "gilbert-elliott", p = 0.01, r = 0.1, 1-h = 0.7, 1-k = 0.001 }
    loss = { law = "outage", length = 0.3, every = 5.0, start = 2.0 }    # or rate = "0.2 Hz"
    semantics = "signal" | "last-arrival" | "newest-stamp" | "fifo" | "playout"
    playout = 1.2                                                       # buffer, for playout only

Numbers are seconds; a text has its unit. Files are relative to the scenario. The modules of losses,
and of laws other than the first two, are imported when a link names one of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from cosim.base.errors import CosimError, ScenarioError
from cosim.base.units import quantity
from cosim.links.grid import Grid
from cosim.links.laws import Constant, Law, Uniform
from cosim.links.semantics import PacketSemantics, PlayoutSemantics, Rule, SignalSemantics
from cosim.links.semantics_names import Semantics as Semantics
from cosim.links.storage import open_table
from cosim.links.table import DrawnTable, TableSpec

if TYPE_CHECKING:
    from cosim.links.losses import Loss

Seconds = int | float | str
Number = int | float | str  # without a dimension, or with the one that is said


class _Law(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="law"):
    """One of several, told apart by `law`; strict about keys."""


class ConstantDelay(_Law, frozen=True, tag="constant"):
    """T = delay."""

    delay: Seconds


class UniformDelay(_Law, frozen=True, tag="uniform"):
    """T ~ U[low, high], drawn every `hold`, or for every sample."""

    low: Seconds
    high: Seconds
    hold: Seconds | None = None


class GammaDelay(_Law, frozen=True, tag="gamma"):
    """T = min(shift + scale·g, maximum), g ~ Gamma(shape), drawn every `hold`."""

    shift: Seconds
    shape: Number
    scale: Seconds
    maximum: Seconds
    hold: Seconds | None = None


class LognormalDelay(_Law, frozen=True, tag="lognormal"):
    """T = min(shift + median·exp(sigma·g), maximum), g ~ N(0, 1), drawn every `hold`."""

    shift: Seconds
    median: Seconds
    sigma: Number
    maximum: Seconds
    hold: Seconds | None = None


class MarkovDelay(_Law, frozen=True, tag="markov"):
    """T jumps between levels every `step`, by probabilities or by mean times on each level."""

    levels: tuple[Seconds, ...]
    step: Seconds
    transitions: tuple[tuple[float, ...], ...] | None = None
    dwell: Seconds | tuple[Seconds, ...] | None = None


class TraceDelay(_Law, frozen=True, tag="trace"):
    """T from a file of measured delays (CSV or Parquet: t_send, delay)."""

    file: str
    lookup: Literal["time", "index"] = "time"
    repeat: bool = False


class TableDelay(_Law, frozen=True, tag="table"):
    """The stored table of a link; what semantics says is in it already."""

    file: str


class IndependentLoss(_Law, frozen=True, tag="independent"):
    """Each packet is lost with probability p."""

    p: Number


class GilbertElliottLoss(
    _Law, frozen=True, tag="gilbert-elliott", rename={"bad": "1-h", "good": "1-k"}
):
    """netem's ``loss gemodel p [r [1-h [1-k]]]``, with its defaults: r = 1 - p, 1, 0."""

    p: Number
    r: Number | None = None
    bad: Number = 1
    good: Number = 0


class OutageLoss(_Law, frozen=True, tag="outage"):
    """Outages of `length`: one `every` so often (first at `start`), or at random with `rate`."""

    length: Seconds
    every: Seconds | None = None
    start: Seconds | None = None
    rate: Number | None = None


DelaySpec = (
    ConstantDelay
    | UniformDelay
    | GammaDelay
    | LognormalDelay
    | MarkovDelay
    | TraceDelay
    | TableDelay
)
LossSpec = IndependentLoss | GilbertElliottLoss | OutageLoss


def link_table(
    *,
    delay: DelaySpec | Mapping[str, Any],
    loss: LossSpec | Mapping[str, Any] | None = None,
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
    checked against the law if given. `loss` is drawn besides the delays and does not change them.
    With the law "table", `semantics` and `playout` are not looked at, and a `loss` is an error.
    Raises ScenarioError that starts with `place`, the file and the path of the link.
    """
    try:
        grid = Grid(sender_period, receiver_period, h)
        spec: DelaySpec = _decode(delay, DelaySpec, "delay")
        table: TableSpec
        if isinstance(spec, TableDelay):
            if loss is not None:
                raise ScenarioError(
                    'delay.law = "table" replays losses as well; expected no key loss'
                )
            table = open_table(folder / spec.file, name=name, grid=grid)
        else:
            law = delay_law(spec, folder)
            if loss is not None:
                from cosim.links.losses import Lossy

                law = Lossy(law, loss_model(loss))
            table = DrawnTable(name, grid, law, _rule(semantics, playout), seed)
        if ticks is not None:
            table.check(-(-ticks // receiver_period))
    except CosimError as error:
        raise ScenarioError(str(error), place) from None
    return table


def _decode(value: Any, kind: Any, key: str) -> Any:
    if not isinstance(value, Mapping):
        return value
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        message, _, path = str(error).partition(" - at `$")
        raise ScenarioError(message, f"{key}{path.rstrip('`')}") from None


def delay_law(delay: DelaySpec | Mapping[str, Any], folder: Path) -> Law:
    """The law that `delay` names; files relative to `folder`. Raises ScenarioError."""
    spec: DelaySpec = _decode(delay, DelaySpec, "delay")
    match spec:
        case ConstantDelay() as d:
            return Constant(si(d.delay, "delay"))
        case UniformDelay() as d:
            return Uniform(si(d.low, "low"), si(d.high, "high"), _optional(d.hold, "hold"))
        case GammaDelay() as d:
            from cosim.links.skewed import Gamma

            shift, scale = si(d.shift, "shift"), si(d.scale, "scale")
            shape, maximum = si(d.shape, "shape", "1"), si(d.maximum, "maximum")
            return Gamma(shift, shape, scale, maximum, _optional(d.hold, "hold"))
        case LognormalDelay() as d:
            from cosim.links.skewed import Lognormal

            shift, median = si(d.shift, "shift"), si(d.median, "median")
            sigma, maximum = si(d.sigma, "sigma", "1"), si(d.maximum, "maximum")
            return Lognormal(shift, median, sigma, maximum, _optional(d.hold, "hold"))
        case MarkovDelay() as d:
            return _markov(d)
        case TraceDelay() as d:
            from cosim.links.traces import read_trace

            return read_trace(folder / d.file, lookup=d.lookup, repeat=d.repeat)
        case TableDelay():
            raise ScenarioError('delay.law = "table" is a table already, not a law')


def _markov(d: MarkovDelay) -> Law:
    from cosim.links.markov import Markov

    levels = tuple(si(x, f"levels[{i}]") for i, x in enumerate(d.levels))
    step = si(d.step, "step")
    if d.transitions is not None and d.dwell is None:
        return Markov(levels, d.transitions, step)
    if d.dwell is None or d.transitions is not None:
        raise ScenarioError('delay.law = "markov" needs either transitions or dwell')
    dwell = d.dwell if isinstance(d.dwell, tuple) else (d.dwell,)
    return Markov.dwelling(levels, tuple(si(x, "dwell") for x in dwell), step)


def loss_model(loss: LossSpec | Mapping[str, Any]) -> Loss:
    """The model that `loss` names. Raises ScenarioError."""
    from cosim.links.losses import GilbertElliott, Independent

    spec: LossSpec = _decode(loss, LossSpec, "loss")
    match spec:
        case IndependentLoss() as d:
            return Independent(si(d.p, "p", "1"))
        case GilbertElliottLoss() as d:
            p = si(d.p, "p", "1")
            r = 1 - p if d.r is None else si(d.r, "r", "1")
            return GilbertElliott(p, r, si(d.bad, "1-h", "1"), si(d.good, "1-k", "1"))
        case OutageLoss() as d:
            return _outage(d)


def _outage(d: OutageLoss) -> Loss:
    from cosim.links.outages import Outage, RandomOutage

    length = si(d.length, "length")
    if d.rate is not None and d.every is None and d.start is None:
        return RandomOutage(length, si(d.rate, "rate", "1/s"))
    if d.every is None or d.rate is not None:
        raise ScenarioError('loss.law = "outage" needs either every (and start) or rate')
    every = si(d.every, "every")
    return Outage(length, every, every if d.start is None else si(d.start, "start"))


def _rule(semantics: Semantics, playout: Seconds | None) -> Rule:
    if semantics == "playout":
        if playout is None:
            raise ScenarioError('semantics = "playout" needs the length of its buffer, playout (s)')
        return PlayoutSemantics(si(playout, "playout"))
    if playout is not None:
        raise ScenarioError(
            f'playout = {playout!r} is a buffer, but semantics = "{semantics}" has none;'
            ' expected semantics = "playout"'
        )
    return SignalSemantics() if semantics == "signal" else PacketSemantics(semantics)


def si(value: Number, name: str, unit: str = "s") -> float:
    """A number as it is, a text in `unit`. Raises ScenarioError that calls it `name`."""
    if not isinstance(value, str):
        return float(value)
    try:
        return quantity(value, unit)
    except CosimError as error:
        raise ScenarioError(f"{name} = {value!r}: {error}") from None


def _optional(value: Number | None, name: str) -> float | None:
    return None if value is None else si(value, name)
