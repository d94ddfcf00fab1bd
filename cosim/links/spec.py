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
    delay = { law = "segments", delay = 0.75, segments = [{ from = 0.63, to = 0.66, delay = 1.2 }] }
    delay = { law = "trace", file = "wifi.csv", lookup = "time", repeat = false }
    delay = { law = "preset", name = "wifi6" }                           # with its losses
    delay = { law = "frozen", name = "lte-up", repeat = false }          # a trace with a sum
    delay = { law = "table", file = "links/master-slave.parquet" }       # replay
    loss = { law = "independent", p = "1 %" }                            # beside any but "table"
    loss = { law = "gilbert-elliott", p = 0.01, r = 0.1, 1-h = 0.7, 1-k = 0.001 }
    loss = { law = "outage", length = 0.3, every = 5.0, start = 2.0 }    # or rate = "0.2 Hz"
    loss = { law = "outage", length = 0, longest = 3.0, pause = 8.5 }
    loss = { law = "pareto-bursts", stay = [0.95, 0.9], shape = [4.4, 5.0], scale = [1.6, 0.3] }
    semantics = "signal" | "last-arrival" | "newest-stamp" | "fifo" | "playout" | "queue"
    playout = 1.2                                                       # buffer, for playout only
    depth = 10                                                          # for queue only, as these:
    drop = "oldest" | "newest"
    take = "one" | "all"

Numbers are seconds; a text has its unit. Files are relative to the scenario. The module of a law or
a model is imported when a link names it.
"""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

from cosim.base.convert import Number
from cosim.base.errors import ScenarioError
from cosim.links.keys import Drop, Semantics, Table, Take, read, si
from cosim.links.laws import Law, LawSource, Sum
from cosim.links.semantics import (
    Grid,
    PacketSemantics,
    PlayoutSemantics,
    QueueSemantics,
    Rule,
    SignalSemantics,
)
from cosim.links.storage import open_table
from cosim.links.table import DrawnTable, TableSpec

if TYPE_CHECKING:
    from cosim.links.losses import Loss

#: Module and class of each law by its name.
LAWS = {
    "constant": "laws:Constant",
    "uniform": "laws:Uniform",
    "gamma": "distributions:Gamma",
    "lognormal": "distributions:Lognormal",
    "markov": "markov:Markov",
    "normal": "distributions:Normal",
    "hyperexponential": "distributions:Hyperexponential",
    "sum": "spec:SumOfLaws",
    "preset": "spec:PresetLaw",
    "frozen": "spec:FrozenLaw",
    "segments": "segments:Segments",
    "zenoh-can": "zenoh_can:ZenohCan",
    "trace": "spec:TraceLaw",
    "table": "spec:StoredLaw",
}
#: Module and class of each loss model by its name.
LOSSES = {
    "independent": "losses:Independent",
    "gilbert-elliott": "losses:GilbertElliott",
    "outage": "outages:Outage",
    "pareto-bursts": "losses:ParetoBursts",
}


class LinkKeys(Protocol):
    """The keys of a link that decide its table."""

    @property
    def delay(self) -> Table | None:
        """The table of its delay law."""

    @property
    def loss(self) -> Table | None:
        """The table of its loss model, drawn separately: it does not change the delays."""

    @property
    def semantics(self) -> Semantics:
        """The rule by which the receiver chooses a sample."""

    @property
    def playout(self) -> Number | None:
        """The buffer of the semantics ``playout``."""

    @property
    def depth(self) -> int | None:
        """The samples that the queue of the semantics ``queue`` can hold."""

    @property
    def drop(self) -> Drop | None:
        """The sample that is dropped if the queue is full; None: the oldest."""

    @property
    def take(self) -> Take | None:
        """The samples that a look takes of the queue; None: one."""


#: The keys of the semantics ``queue``.
QUEUE_KEYS = ("depth", "drop", "take")


def link_table(
    link: LinkKeys, name: str, seed: int, grid: Grid, folder: Path, ticks: int | None = None,
    known: dict[Hashable, DrawnTable] | None = None,
) -> TableSpec:  # fmt: skip
    """The table of one link.

    `name`: unique in the scenario, determines the random numbers together with `seed`; `folder`: to
    which paths are relative; `ticks`: length of the run, checked against the law if given. `known`:
    tables of other links, of which it takes over what is equal, and is put in itself. With the law
    "table", the semantics is ignored, and a loss is an error. Raises ScenarioError.
    """
    rule = (link.semantics, link.playout, link.depth, link.drop, link.take)
    key = (repr(link.delay), repr(link.loss), rule, grid, ticks)
    if known is not None and key in known:
        return known[key].of(name, seed)
    table: TableSpec
    spec = _read_delay(link.delay or {})
    if isinstance(spec, StoredLaw):
        if link.loss is not None:
            raise ScenarioError('delay.law = "table" replays losses as well; expected no key loss')
        table = open_table(folder / spec.file, name=name, grid=grid)
    else:
        law = spec.law(folder) if isinstance(spec, LawSource) else spec
        if link.loss is not None:
            law = _lossy(law, link.loss)
        table = DrawnTable(name, grid, law, _rule(link, link.semantics), seed)
    if ticks is not None:
        table.check(-(-ticks // grid.n_r))
    if known is not None and isinstance(table, DrawnTable):
        known[key] = table
    return table


def bus_table(law: Law, link: LinkKeys, name: str, grid: Grid) -> DrawnTable:
    """The table of a link on a simulated bus, with the delays in `law`. Raises ScenarioError."""
    semantics = "newest-stamp" if link.semantics == "signal" else link.semantics
    return DrawnTable(name, grid, law, _rule(link, semantics), 0)


def delay_law(delay: Table, folder: Path) -> Law:
    """The law that `delay` names; files relative to `folder`. Raises ScenarioError."""
    spec = _read_delay(delay)
    return spec.law(folder) if isinstance(spec, LawSource) else spec


def loss_model(loss: Table) -> Loss:
    """The model that `loss` names. Raises ScenarioError."""
    model: Loss = read(loss, LOSSES, "loss")
    return model


def _read_delay(delay: Table) -> Law | LawSource:
    found: Law | LawSource = read(delay, LAWS, "delay")
    return found


def _lossy(law: Law, loss: Table) -> Law:
    from cosim.links.losses import Lossy

    if isinstance(law, Lossy):
        raise ScenarioError("the preset already defines losses; expected no key loss")
    return Lossy(law, loss_model(loss))


class StoredLaw(LawSource, frozen=True, tag="table"):
    """The stored table of a link; it already contains the effect of the semantics."""

    file: str

    def law(self, folder: Path) -> Law:
        """No law. Raises ScenarioError."""
        raise ScenarioError('delay.law = "table" is a table already, not a law')


class SumOfLaws(LawSource, frozen=True, tag="sum"):
    """T = the sum of independent laws, each a table like `delay` itself."""

    of: tuple[dict[str, Any], ...]

    def law(self, folder: Path) -> Law:
        """The sum. Raises ScenarioError."""
        return Sum(tuple(delay_law(each, folder) for each in self.of))


class PresetLaw(LawSource, frozen=True, tag="preset"):
    """Delay and loss of a named network, see :mod:`cosim.links.presets`."""

    name: str

    def law(self, folder: Path) -> Law:
        """The delay law, with its losses. Raises ScenarioError."""
        from cosim.links.presets import preset

        found = preset(self.name)
        law = delay_law(found.delay, folder)
        return law if found.loss is None else _lossy(law, found.loss)


class TraceLaw(LawSource, frozen=True, tag="trace"):
    """T from a file of measured delays (CSV or Parquet: t_send, delay)."""

    file: str
    lookup: Literal["time", "index"] = "time"
    repeat: bool = False

    def law(self, folder: Path) -> Law:
        """The trace. Raises ScenarioError."""
        from cosim.links.traces import read_trace

        return read_trace(folder / self.file, lookup=self.lookup, repeat=self.repeat)


class FrozenLaw(LawSource, frozen=True, tag="frozen"):
    """A delay trace with fixed bytes, see :mod:`cosim.links.frozen`."""

    name: str
    lookup: Literal["time", "index"] = "time"
    repeat: bool = False

    def law(self, folder: Path) -> Law:
        """The trace. Raises ScenarioError."""
        from cosim.links.frozen import frozen

        name = f"frozen {self.name}"
        return frozen(self.name).trace(lookup=self.lookup, repeat=self.repeat, name=name)


def _rule(link: LinkKeys, semantics: Semantics) -> Rule:
    """The rule of these keys. Raises ScenarioError for keys of another semantics."""
    if link.playout is not None and semantics != "playout":
        raise ScenarioError(
            f'playout = {link.playout!r} is a buffer, but semantics = "{semantics}" has none;'
            ' expected semantics = "playout"'
        )
    for key in QUEUE_KEYS:
        if getattr(link, key) is not None and semantics != "queue":
            raise ScenarioError(
                f'{key} = {getattr(link, key)!r} is of a queue, but semantics = "{semantics}" has'
                ' none; expected semantics = "queue"'
            )
    match semantics:
        case "signal":
            return SignalSemantics()
        case "playout":
            if link.playout is None:
                raise ScenarioError(
                    'semantics = "playout" needs the length of its buffer, playout (s)'
                )
            return PlayoutSemantics(si(link.playout, "playout"))
        case "queue":
            if link.depth is None:
                raise ScenarioError(
                    'semantics = "queue" needs the number of samples that it can hold, depth'
                )
            return QueueSemantics(link.depth, link.drop or "oldest", link.take or "one")
    return PacketSemantics(semantics)
