"""Delay laws and loss models from the links of a scenario, with error messages for bad values.

::

    delay = { law = "constant", delay = "100 ms" }
    delay = { law = "uniform", low = 0.3, high = 1.2, hold = "30 ms" }   # no hold: every sample
    delay = { law = "gamma", shift = "20 ms", shape = 2, scale = "5 ms", maximum = "200 ms" }
    delay = { law = "lognormal", shift = "20 ms", median = "8 ms", sigma = 0.8, maximum = 0.2 }
    delay = { law = "markov", levels = [0.05, 0.2], dwell = [2.0, 0.5], step = "10 ms" }
    delay = { law = "normal", mean = "100 ms", sd = "25 ms", maximum = "250 ms" }
    delay = { law = "hyperexponential", shift = 0.07, weights = [0.7, 0.3],
              means = ["37 ms", "12 ms"], maximum = 1.0 }
    delay = { law = "sum", of = [{ law = "constant", delay = 0.02 }, { law = "gamma", … }] }
    delay = { law = "trace", file = "wifi.csv", lookup = "time", repeat = false }
    delay = { law = "preset", name = "wifi6" }                           # with its losses
    delay = { law = "frozen", name = "lte-up", repeat = false }          # a trace with a sum
    delay = { law = "table", file = "links/master-slave.parquet" }       # replay
    loss = { law = "independent", p = "1 %" }                            # beside any but "table"
    loss = { law = "gilbert-elliott", p = 0.01, r = 0.1, 1-h = 0.7, 1-k = 0.001 }
    loss = { law = "outage", length = 0.3, every = 5.0, start = 2.0 }    # or rate = "0.2 Hz"
    loss = { law = "outage", length = 0, longest = 3.0, pause = 8.5 }
    loss = { law = "pareto-bursts", stay = [0.95, 0.9], shape = [4.4, 5.0], scale = [1.6, 0.3] }
    semantics = "signal" | "last-arrival" | "newest-stamp" | "fifo" | "playout"
    playout = 1.2                                                       # buffer, for playout only

Numbers are seconds; a text has its unit. Files are relative to the scenario. The modules of losses,
and of laws other than the first two, are imported when a link names one of them.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, get_args

import msgspec

from cosim.base.convert import sentence
from cosim.base.errors import CosimError, ScenarioError
from cosim.base.units import quantity
from cosim.links.grid import Grid
from cosim.links.keys import (
    ConstantDelay,
    FrozenDelay,
    GammaDelay,
    GilbertElliottLoss,
    HyperexponentialDelay,
    IndependentLoss,
    LognormalDelay,
    MarkovDelay,
    NormalDelay,
    Number,
    OutageLoss,
    ParetoBurstLoss,
    PresetDelay,
    Seconds,
    SumDelay,
    TableDelay,
    TraceDelay,
    UniformDelay,
)
from cosim.links.keys import DelaySpec as DelaySpec
from cosim.links.keys import LossSpec as LossSpec
from cosim.links.laws import Constant, Law, Uniform
from cosim.links.semantics import PacketSemantics, PlayoutSemantics, Rule, SignalSemantics
from cosim.links.semantics_names import Semantics as Semantics
from cosim.links.storage import open_table
from cosim.links.table import DrawnTable, TableSpec

if TYPE_CHECKING:
    from cosim.links.losses import Loss


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
    known: dict[Hashable, DrawnTable] | None = None,
) -> TableSpec:
    """The table of one link.

    `name`: unique in the scenario, determines the random numbers together with `seed`; `h`: base
    step (s); periods in ticks; `folder`: to which paths are relative; `ticks`: length of the run,
    checked against the law if given. `loss` is drawn separately and does not change the delays.
    `known`: tables of other links, of which it takes over what is equal, and is put in itself.
    With the law "table", `semantics` and `playout` are ignored, and a `loss` is an error. Raises
    ScenarioError that starts with `place`, the file and the path of the link.
    """
    key = (repr(delay), repr(loss), semantics, playout, sender_period, receiver_period, h, ticks)
    if known is not None and key in known:
        return known[key].of(name, seed)
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
                law = _lossy(law, loss)
            table = DrawnTable(name, grid, law, _rule(semantics, playout), seed)
        if ticks is not None:
            table.check(-(-ticks // receiver_period))
    except CosimError as error:
        raise ScenarioError(str(error), place) from None
    if known is not None and isinstance(table, DrawnTable):
        known[key] = table
    return table


def bus_table(
    law: Law, semantics: Semantics, name: str, h: float, periods: tuple[int, int], place: str
) -> DrawnTable:
    """The table of a link on a simulated bus, with the delays in `law`.

    `periods`: of sender and receiver, ticks of `h` (s). Raises ScenarioError at `place`.
    """
    try:
        return DrawnTable(name, Grid(*periods, h), law, _rule(semantics, None), 0)
    except CosimError as error:
        raise ScenarioError(str(error), place) from None


def _lossy(law: Law, loss: LossSpec | Mapping[str, Any]) -> Law:
    from cosim.links.losses import Lossy

    if isinstance(law, Lossy):
        raise ScenarioError("the preset already defines losses; expected no key loss")
    return Lossy(law, loss_model(loss))


def _decode(value: Any, kind: Any, key: str) -> Any:
    if not isinstance(value, Mapping):
        return value
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        message, inside = sentence(error, _tagged(kind, value) or kind, value)
        raise ScenarioError(message, f"{key}{inside}") from None


def _tagged(kind: Any, value: Mapping[str, Any]) -> type[msgspec.Struct] | None:
    """The struct of a union that the value names, if it names one."""
    for struct in get_args(kind):
        config = struct.__struct_config__
        if config.tag is not None and value.get(config.tag_field) == config.tag:
            return cast(type[msgspec.Struct], struct)
    return None


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
        case NormalDelay() | HyperexponentialDelay() | SumDelay() as d:
            return _mixture(d, folder)
        case PresetDelay() as d:
            from cosim.links.presets import preset

            found = preset(d.name)
            law = delay_law(found.delay, folder)
            return law if found.loss is None else _lossy(law, found.loss)
        case TraceDelay() as d:
            from cosim.links.traces import read_trace

            return read_trace(folder / d.file, lookup=d.lookup, repeat=d.repeat)
        case FrozenDelay() as d:
            from cosim.links.frozen_traces import frozen

            name = f"frozen {d.name}"
            return frozen(d.name).trace(lookup=d.lookup, repeat=d.repeat, name=name)
        case TableDelay():
            raise ScenarioError('delay.law = "table" is a table already, not a law')


def _mixture(d: NormalDelay | HyperexponentialDelay | SumDelay, folder: Path) -> Law:
    from cosim.links.mixtures import Hyperexponential, Normal, Sum

    if isinstance(d, SumDelay):
        return Sum(tuple(delay_law(each, folder) for each in d.of))
    maximum, hold = si(d.maximum, "maximum"), _optional(d.hold, "hold")
    if isinstance(d, NormalDelay):
        mean, sd, minimum = si(d.mean, "mean"), si(d.sd, "sd"), si(d.minimum, "minimum")
        return Normal(mean, sd, minimum, maximum, hold)
    means = tuple(si(x, f"means[{i}]") for i, x in enumerate(d.means))
    return Hyperexponential(si(d.shift, "shift"), d.weights, means, maximum, hold)


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
        case ParetoBurstLoss() as d:
            from cosim.links.bursts import ParetoBursts

            return ParetoBursts(d.stay, d.shape, d.scale)


def _outage(d: OutageLoss) -> Loss:
    from cosim.links.outages import Outage, RandomOutage, UniformOutage

    length = si(d.length, "length")
    keys = ("every", "start", "rate", "longest", "pause")
    given = {key for key in keys if getattr(d, key) is not None}
    if d.longest is not None and d.pause is not None and given <= {"longest", "pause"}:
        return UniformOutage(length, si(d.longest, "longest"), si(d.pause, "pause"))
    if d.rate is not None and given <= {"rate"}:
        return RandomOutage(length, si(d.rate, "rate", "1/s"))
    if d.every is None or not given <= {"every", "start"}:
        raise ScenarioError(
            'loss.law = "outage" needs either every (and start) or rate, or longest and pause'
        )
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
