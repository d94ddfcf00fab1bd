"""A scenario: TOML read into frozen structs. Every error names the file and the place in it.

Numbers are SI, or texts with a unit: ``step = "1 ms"``. An unknown key is an error.
:mod:`cosim.scenario.assemble` checks whether components, ports and shapes fit together.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec

from cosim.base import toml
from cosim.base.convert import Number, Value, convert, convert_array, convert_each, number
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.base.python import without_collections
from cosim.formulas.spec import RequirementSpec
from cosim.links.keys import Drop, Semantics, Take
from cosim.scenario.bus_spec import LinkFrameSpec, ScenarioBusSpec


class RecordSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The signals that are recorded: every `every`-th tick of `signals` (default: all outputs and
    received), and with `events` when FMUs were in Event Mode.
    """

    every: Annotated[int, msgspec.Meta(ge=1)] = 1
    signals: tuple[str, ...] = ()
    events: bool = False


class BondSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A power bond: two inputs, fed by wires in both directions between two components."""

    effort: str
    flow: str


class AdaptiveSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Macro steps of ``"adaptive"``, see :class:`cosim.schedule.macro.AdaptiveSettings`.

    `absolute`: None, 0.01 of the tolerance; `smallest`: None, the period over 2^10.
    """

    tolerance: Annotated[float, msgspec.Meta(gt=0)] = 1e-4
    absolute: Annotated[float, msgspec.Meta(ge=0)] | None = None
    smallest: Number | None = None
    iterations: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 1
    fixed: tuple[str, ...] = ()
    bonds: tuple[BondSpec, ...] = ()


class RunSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Length, step and algorithm of a run.

    A run goes from `start` to `stop` (s). `order` is for ``"gauss-seidel"``: all components by
    name; `adaptive` for ``"adaptive"``.
    """

    step: Number
    stop: Number
    start: Number = 0.0
    seed: Annotated[int, msgspec.Meta(ge=0)] = 0
    algorithm: Literal["sampled", "jacobi", "gauss-seidel", "adaptive"] = "sampled"
    order: tuple[str, ...] = ()
    adaptive: AdaptiveSpec | None = None
    record: RecordSpec = RecordSpec()


class InputSpec(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, rename={"source": "from"}
):
    """The source of an input, which gets ``gain * value + offset``: exactly one of three.

    `source`: an output, by a wire; `table`: a `column` of a file (default: the name of the input);
    `points`: [[time, value], ...]. Values of the last two are held, or joined by lines.
    """

    source: str = ""
    table: str = ""
    column: str = ""
    points: tuple[tuple[Number, Value], ...] = ()
    interpolate: Literal["hold", "linear"] = "hold"
    gain: float = 1.0
    offset: float = 0.0


#: The sampling of a component, or the interface of an FMU that is used.
ComponentKind = Literal[
    "sampled", "continuous", "co-simulation", "model exchange", "model-exchange",
    "scheduled execution", "scheduled-execution",
]  # fmt: skip


class ComponentSpec(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, gc=False
):
    """One component: its model, how often it steps, its values, and what feeds its inputs.

    The last ten are for FMUs, see :class:`cosim.fmi.FmuOptions`; of these `bus` names the bus of
    an FMU with a CAN terminal (FMI-LS-BUS), and `terminal` that terminal where it has several.
    `kind`: "co-simulation", "model exchange" (which is continuous) and "scheduled execution" (which
    is sampled) are for an FMU that has several interfaces; they may be written with a hyphen.
    `compute`: the time that each step of a sampled component takes; its outputs are that much
    later for all others (:func:`cosim.scenario.connect_links.computing`).
    """

    model: str
    fmi: Literal["2.0", "3.0"] = "2.0"
    sizes: dict[str, int] = {}
    options: dict[str, Any] = {}
    kind: ComponentKind | None = None
    period: Number | None = None
    compute: Number = 0.0
    extrapolate: Literal["hold", "linear"] = "hold"
    preset: str | None = None
    parameters: dict[str, Value] = {}
    start: dict[str, Value] = {}
    inputs: dict[str, str | InputSpec] = {}
    log: bool = False
    isolate: bool | Literal["wasm"] = False
    timeout: Number | None = None
    tolerance: Annotated[float, msgspec.Meta(gt=0)] | None = None
    memory: Annotated[int, msgspec.Meta(ge=0)] = 0
    build: bool = False
    solver: Literal["", "euler", "heun", "rk4", "cvode"] = ""
    max_step: Number | None = None
    bus: str = ""
    terminal: str = ""

    @property
    def values(self) -> dict[str, Value]:
        """Parameters and start values."""
        return {**self.parameters, **self.start}

    def likeness(self) -> bytes:
        """Equal for components that differ in their values, period and what feeds them only."""
        return msgspec.json.encode(_likeness(self))

    def without_values(self) -> ComponentSpec:
        """The component without the numbers of its run: neither values nor how often it steps."""
        return self.replaced(parameters={}, start={}, preset=None, period=None)

    def replaced(self, **fields: Any) -> ComponentSpec:
        """The same with other values of `fields`."""
        return replace(self, **fields)


_likeness = attrgetter(*(
    name for name in ComponentSpec.__struct_fields__
    if name not in ("parameters", "start", "preset", "period", "inputs")
))  # fmt: skip


class LinkSpec(
    msgspec.Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    gc=False,
    rename={"source": "from", "target": "to"},
):
    """A link from an output to an input: late, sometimes, or never.

    Links of one `channel` travel in the same packets: they share their delays and losses. `age`
    is an input that gets the age (s) of what is held. Instead of a `delay`, a link names a `bus`
    and its `frame`; links of one bus and channel are in one frame. `playout` (s) is of the
    semantics of this name; `depth` (samples), `drop` and `take` are of ``queue``.
    """

    source: str
    target: str
    delay: dict[str, Any] | None = None
    bus: str = ""
    frame: LinkFrameSpec | None = None
    semantics: Semantics = "signal"
    playout: Number | None = None
    depth: int | None = None
    drop: Drop | None = None
    take: Take | None = None
    loss: dict[str, Any] | None = None
    initial: Value = None
    name: str = ""
    channel: str = ""
    age: str = ""

    def delayed(self, delay: dict[str, Any]) -> LinkSpec:
        """The same with another delay law."""
        return replace(self, delay=delay)


class EventSpec(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, rename={"lasts": "for"}
):
    """At a time (s), inputs or tunable parameters change to the values of `set`.

    `over`: the duration of the change, s (0: a jump); `lasts`: after this time (s) they change
    back.
    """

    at: Number
    set: Annotated[dict[str, Value], msgspec.Meta(min_length=1)]
    over: Number = 0.0
    lasts: Number | None = None


class TopologySpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The edges over which robots receive, over time; see :mod:`cosim.graphs.topology`.

    `graphs`: a preset (``"ring"``, ``"tree3"``, ``"dense"``), files, or for each graph its edges
    [receiver, sender]; `dwell`: interval after which a graph is drawn, s; `schedule`: [[time,
    graph], ...] instead, repeated every `repeat` (s); neither: one graph. `weights`: an input, and
    the edge [receiver, sender] that gives its weight.
    """

    graphs: str | tuple[str | tuple[tuple[int, int], ...], ...]
    dwell: Number | None = None
    schedule: tuple[tuple[Number, str], ...] | None = None
    repeat: Number | None = None
    weights: dict[str, tuple[int, int]] = {}


class MetricSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One number of the summary; see :mod:`cosim.measure.metrics` for the kinds."""

    kind: str
    of: tuple[str, ...]
    target: str | tuple[float | str, ...] | None = None
    within: float | None = None
    window: Number | None = None
    contact: tuple[str, ...] = ()
    norm: Literal["max", "euclidean"] = "max"
    label: str = ""


class PanelSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One diagram of a figure."""

    y: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
    title: str = ""
    labels: tuple[str, ...] = ()
    reference: tuple[float | str, ...] = ()
    reference_label: str = ""
    ylabel: str = ""


class FigureSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A figure of one or more panels, written as ``NAME.png``."""

    panels: Annotated[tuple[PanelSpec, ...], msgspec.Meta(min_length=1)]
    title: str = ""


class AnalysisSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The port that ``cosim analyze`` looks into, and the far end: names of signals, all optional.

    `force`: on the robot at the port, `response` and `rate`: its position and velocity, `inject`:
    the input a test force goes into; `far_force`: of the far robot on its environment, with the
    position `far_response` and velocity `far_rate`. See :mod:`cosim.predict.port`.
    """

    force: str = ""
    response: str = ""
    rate: str = ""
    inject: str = ""
    far_force: str = ""
    far_response: str = ""
    far_rate: str = ""


class Scenario(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A whole scenario, as read. `falsify` is for :mod:`cosim.falsify`, and read there."""

    path: Path
    title: str
    run: RunSpec
    components: dict[str, ComponentSpec]
    links: tuple[LinkSpec, ...]
    topology: TopologySpec | None
    metrics: dict[str, MetricSpec]
    figures: dict[str, FigureSpec]
    analysis: AnalysisSpec = AnalysisSpec()
    buses: dict[str, ScenarioBusSpec] = msgspec.field(default_factory=dict, name="bus")
    events: tuple[EventSpec, ...] = ()
    require: dict[str, RequirementSpec] = {}
    falsify: dict[str, Any] = {}

    @property
    def name(self) -> str:
        """The file's stem."""
        return self.path.stem

    def place(self, *path: str | int) -> str:
        """The place of a value in the file: ``FILE at components.master.period``."""
        return f"{self.path} at {'.'.join(str(p) for p in path)}"

    def seconds(self, value: Number, *path: str | int) -> float:
        """A duration in seconds. Raises ScenarioError with its place."""
        return number(value, "s", self.place(*path))


T = TypeVar("T")
_NAME = re.compile(r"[A-Za-z_]\w*$")
_TABLES = (
    "title", "run", "graphs", "components", "links", "events", "bus", "topology", "metrics",
    "figures", "analysis", "require", "falsify",
)  # fmt: skip


def build(document: Mapping[str, Any], path: str | Path) -> Scenario:
    """A scenario from an already parsed document, which may have numbers and arrays of NumPy.

    Raises ScenarioError.
    """
    with without_collections():
        return _build(toml.plain(document), Path(path))


def _build(document: Mapping[str, Any], path: Path) -> Scenario:
    toml.check_numbers(document, str(path))
    if has_many(document):
        from cosim.scenario.arrays import expand

        document = expand(document, path)
    for key in document:
        if key not in _TABLES:
            raise ScenarioError(
                f"unknown key {key!r}; expected one of {', '.join(_TABLES)}", f"{path}"
            )
    for key in ("run", "components"):
        if key not in document:
            raise ScenarioError(f"no [{key}] table", f"{path}")
    keys = ("components", "bus", "metrics", "figures", "require", "falsify")
    tables = {k: _table(document, k, path) for k in keys}
    for name in tables["components"]:
        if not _NAME.match(name):
            raise ScenarioError(
                f"component name {name!r} is not an identifier", f"{path} at components"
            )
    links, events = (_array(document, key, path) for key in ("links", "events"))
    require = convert_each(tables["require"], RequirementSpec, path, "require")
    for name, requirement in require.items():
        requirement.tree(f"{path} at require.{name}")  # refused where it cannot be read
    return Scenario(
        path=path,
        title=convert(document.get("title", path.stem), str, path, "title"),
        run=_run(document["run"], path),
        components=convert_each(tables["components"], ComponentSpec, path, "components"),
        links=tuple(convert_array(links, LinkSpec, path, "links")),
        events=tuple(convert_array(events, EventSpec, path, "events")),
        topology=_topology(document, path),
        metrics=convert_each(tables["metrics"], MetricSpec, path, "metrics"),
        figures=convert_each(tables["figures"], FigureSpec, path, "figures"),
        analysis=convert(document.get("analysis", {}), AnalysisSpec, path, "analysis"),
        buses=convert_each(tables["bus"], ScenarioBusSpec, path, "bus"),
        require=require,
        falsify=tables["falsify"],
    )


def _run(table: Any, path: Path) -> RunSpec:
    """The table `run`; one signal in `record.signals` needs no brackets."""
    record = table.get("record") if isinstance(table, dict) else None
    if isinstance(record, dict) and isinstance(record.get("signals"), str):
        table = {**table, "record": {**record, "signals": [record["signals"]]}}
    return convert(table, RunSpec, path, "run")


def has_many(document: Mapping[str, Any]) -> bool:
    """True if there are graphs or counted components."""
    components = document.get("components")
    links = document.get("links")
    given: list[Any] = [document.get("topology")]
    given += components.values() if isinstance(components, dict) else ()
    given += links if isinstance(links, list) else ()
    return "graphs" in document or any(
        isinstance(x, dict) and ("count" in x or "graph" in x) for x in given
    )


def logging(scenario: Scenario) -> Scenario:
    """The same with every FMU's logging switched on."""
    components = {k: replace(spec, log=True) for k, spec in scenario.components.items()}
    return replace(scenario, components=components)


def as_data(scenario: Scenario) -> dict[str, Any]:
    """A scenario as plain data: what a run's metadata keeps of it."""
    data: dict[str, Any] = msgspec.to_builtins(scenario, enc_hook=str)
    run = data["run"]
    optional = (run, "start"), (run["record"], "events"), (data, "require"), (data, "falsify")
    for table, key in optional:
        if not table[key]:
            del table[key]  # few runs have it
    return data


def _table(document: Mapping[str, Any], key: str, path: Path) -> dict[str, Any]:
    table = document.get(key, {})
    if not isinstance(table, dict):
        raise ScenarioError(f"expected a table [{key}.NAME]", f"{path} at {key}")
    return table


def _array(document: Mapping[str, Any], key: str, path: Path) -> list[Any]:
    found = document.get(key, [])
    if not isinstance(found, list):
        raise ScenarioError(f"expected an array of tables, [[{key}]]", f"{path} at {key}")
    return found


def _topology(document: Mapping[str, Any], path: Path) -> TopologySpec | None:
    given = document.get("topology")
    return None if given is None else convert(given, TopologySpec, path, "topology")
