"""Predictions for a measured path: a scenario offline, with the measured delays on its links.

The trace of a path is repeated for as long as the scenario lasts, and started at several places,
one run each. In every second run a sample arrives one period of its receiver later: what comes just
after a step waits for the next one, and where in a period samples arrive is not known before. The
spread of a number over these runs gives the interval in which another run on this path is expected,
as far as a measurement of this length contains what can happen.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, sqrt
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from bridge.deployment.latency import network_delays
from bridge.deployment.system import System
from bridge.ping.clocks import Floats
from bridge.ping.zenoh import PingedNodes
from cosim.base.errors import RunError, ScenarioError
from cosim.base.toml import change
from cosim.checks.laws import prediction as findings
from cosim.comparison.comparison import compare
from cosim.comparison.documents import read_base
from cosim.comparison.variants_file import read as read_variants
from cosim.engine.simulate import simulate
from cosim.links.spec import QUEUE_KEYS
from cosim.links.traces import write_trace
from cosim.loading.files import read_document
from cosim.measure import declared_metrics
from cosim.measure.metrics import MetricResult, evaluate
from cosim.predict.system import system
from cosim.record import Run
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario, build

#: Starts in a trace, parts of its length. In every second run samples arrive one period later.
STARTS = tuple(k / 8 for k in range(8))
#: Half the interval in which 99 % of further runs are expected, in standard deviations of the runs
#: above: Student's t for seven degrees of freedom, times sqrt(1 + 1/8).
SPREAD = 3.499 * sqrt(1 + 1 / len(STARTS))
#: A delay that has no effect, s.
NO_DELAY = 1e-6

Document = dict[str, Any]


@dataclass(frozen=True, slots=True)
class PathTrace:
    """The delays of a path: `sent` (n,), s, and those of each direction (n,), s, NaN: lost.

    `semantics`: how a receiver on this path takes samples.
    """

    sent: Floats
    there: Floats
    back: Floats
    semantics: str

    def rolled(self, start: float, later: float = 0.0) -> PathTrace:
        """The same trace from a part of its length on, and what was before it at its end; all
        delays longer by `later`, s.
        """
        first = round(start * self.sent.size)
        sent = np.arange(self.sent.size) * np.median(np.diff(self.sent))
        there, back = np.roll(self.there, -first) + later, np.roll(self.back, -first) + later
        return PathTrace(np.asarray(sent, dtype=np.float64), there, back, self.semantics)

    def way(self, back: bool) -> Floats:
        """The delays of one direction, (n,), s."""
        return self.back if back else self.there

    def write(self, folder: Path) -> tuple[Path, Path]:
        """The files of both directions in a folder."""
        paths = folder.resolve() / "there.csv", folder.resolve() / "back.csv"
        for path, delay in zip(paths, (self.there, self.back), strict=True):
            write_trace(path, self.sent, delay)
        return paths


@dataclass(frozen=True, slots=True)
class PredictedNumber:
    """A number of the scenario on a path: of the run from the first start, the bounds of the
    interval that contains 99 % of further runs, and without delay. Infinite: never, or not reached.
    """

    label: str
    unit: str
    value: float
    least: float
    most: float
    ideal: float

    @property
    def text(self) -> str:
        """In words."""
        return (
            f"{self.label:<34} {_said(self.value)} {self.unit}  ({_said(self.least)} to "
            f"{_said(self.most)} in 99 % of runs; {_said(self.ideal)} without delay)"
        )


@dataclass(frozen=True, slots=True)
class ScenarioPrediction:
    """`numbers` of a scenario; `findings`: what closed forms say; `failures`: reasons of runs that
    stopped; `links`: what was replaced by which direction.
    """

    numbers: tuple[PredictedNumber, ...]
    findings: tuple[str, ...]
    failures: tuple[str, ...]
    links: tuple[str, ...]

    def lines(self) -> list[str]:
        """In words."""
        stopped = [f"a run on this path stopped: {reason}" for reason in self.failures]
        return [*self.links, *self.findings, *(n.text for n in self.numbers), *stopped]


def _said(x: float) -> str:
    return f"{x:.4g}" if isfinite(x) else "never"


def predict(
    path: Path, trace: PathTrace, link: str = "", settings: Sequence[str] = (),
    nodes: PingedNodes | None = None,
) -> ScenarioPrediction:  # fmt: skip
    """Run a scenario (TOML) on a path, from several starts, and without delay.

    `link`: ``FROM->TO`` or the name of the only link that is replaced, by the way there. Otherwise
    all links are: those from the component of the first one by the way there, others by the way
    back; on a path between `nodes`, all links between nodes, by the node that sends. Where their
    deployment adds the scenario's delays to those of the network, the links keep their laws, and
    the path comes on top. `settings`: ``PATH=VALUE``. Raises ScenarioError.
    """
    if nodes is not None:
        settings = [*nodes.system.deployment.settings(), *settings]
    by_node = nodes is not None and not link
    ways = nodes.ways() if nodes and by_node else directions(_document(path, settings), path, link)
    adding = nodes.system if nodes and nodes.system.deployment.latency else None
    later = _longest_period(path, settings, ways)
    failures: list[str] = []
    on_path = []
    with TemporaryDirectory() as kept:
        for i, start in enumerate(STARTS):
            rolled = trace.rolled(start, later * (i % 2))
            delays = _delays(rolled, ways, Path(kept), adding)
            scenario = _on(path, settings, delays, "" if adding else trace.semantics)
            results, failure = _run(scenario)
            on_path.append(results)
            if start == STARTS[0]:
                said = tuple(f.reason for f in findings(system(scenario, assemble(scenario))))
            if failure:
                failures.append(failure)
    near: Document = {"law": "constant", "delay": NO_DELAY}
    ideal, _ = _run(_on(path, settings, dict.fromkeys(ways, near), "last-arrival"))
    numbers = [_number(key, on_path, ideal) for key in {**ideal, **on_path[0]}]
    links = [_link_line(path, settings, i, back) for i, back in ways.items()]
    return ScenarioPrediction(tuple(numbers), said, tuple(failures), tuple(links))


def _delays(
    trace: PathTrace, ways: Mapping[int, bool], folder: Path, adding: System | None
) -> dict[int, Document]:
    """The delay of each link on a path; with `adding`, what the path takes comes on its law."""
    if adding is None:
        files = trace.write(folder)
        return {
            i: {"law": "trace", "file": str(files[back]), "repeat": True}
            for i, back in ways.items()
        }
    plans = {link.name: link for link in adding.plan.links}
    found = {}
    for i, back in ways.items():
        link, file = adding.scenario.links[i], folder.resolve() / f"link{i}.csv"
        planned = plans[f"{link.source}->{link.target}"]
        write_trace(file, *network_delays(planned, adding.plan.ticks, trace.sent, trace.way(back)))
        found[i] = {"law": "trace", "file": str(file)}
    return found


def _document(path: Path, settings: Sequence[str]) -> Document:
    document = read_document(path)
    for setting in settings:
        change(document, setting)
    return dict(document)


def _name(link: Mapping[str, Any]) -> str:
    return f"{link.get('from', '')}->{link.get('to', '')}"


def _link_line(path: Path, settings: Sequence[str], i: int, back: bool) -> str:
    link = _document(path, settings)["links"][i]
    return f"link {_name(link)}: the way {'back' if back else 'there'}"


def directions(document: Mapping[str, Any], path: Path, link: str = "") -> dict[int, bool]:
    """True if each link that is replaced, by number, is the way back. Raises ScenarioError."""
    links = document.get("links", [])
    if not links:
        raise ScenarioError("no links; expected at least one, whose delay is replaced", str(path))
    if link:
        for i, each in enumerate(links):
            if link in (_name(each), each.get("name")):
                return {i: False}
        known = ", ".join(map(_name, links))
        raise ScenarioError(f"no link {link!r}; there are: {known}", str(path))
    first = str(links[0].get("from", "")).partition(".")[0]
    return {i: str(each.get("from", "")).partition(".")[0] != first for i, each in enumerate(links)}


def _on(
    path: Path, settings: Sequence[str], delays: Mapping[int, Document], semantics: str
) -> Scenario:
    """The scenario with these delays by number of link.

    `semantics`: of the path; empty: each link keeps its own.
    """
    document = _document(path, settings)
    for i, delay in delays.items():
        link = document["links"][i]
        for key in ("loss", "bus", "frame", *(("playout", *QUEUE_KEYS) if semantics else ())):
            link.pop(key, None)
        link |= {"delay": delay, **({"semantics": semantics} if semantics else {})}
    return build(document, path)


def _longest_period(path: Path, settings: Sequence[str], ways: Mapping[int, bool]) -> float:
    """The longest period of the components that receive by these links, s."""
    plan = assemble(build(_document(path, settings), path))
    links = _document(path, settings)["links"]
    receivers = [str(links[i]["to"]).partition(".")[0] for i in ways]
    return max(plan.component(name).period for name in receivers) * plan.h


Key = tuple[str, str, str]  # name, label, unit


def _run(scenario: Scenario) -> tuple[dict[Key, float], str]:
    """Numbers of a run, and why it stopped, if it did."""
    with TemporaryDirectory() as folder:
        try:
            simulate(scenario, Path(folder) / "run")
        except RunError as error:
            return {}, str(error)
        run = Run.open(Path(folder) / "run")
        results = evaluate(declared_metrics.metrics(scenario), run)
        return dict(parts(results)), ""


def parts(results: Sequence[MetricResult]) -> Iterator[tuple[Key, float]]:
    """The numbers of a run that are predicted, in their units: how long a metric took to settle in
    place of its value, where it has one.
    """
    for r in results:
        if "settle_s" in r.parts:
            yield (f"{r.name} settles", f"{r.label} settled after", "s"), r.parts["settle_s"]
        else:
            yield (r.name, r.label, r.unit), r.value


def _number(
    key: Key, on_path: Sequence[Mapping[Key, float]], ideal: Mapping[Key, float]
) -> PredictedNumber:
    found = np.array([values.get(key, inf) for values in on_path])
    _, label, unit = key
    least, most = interval(found)
    return PredictedNumber(
        label, "" if unit == "1" else unit, float(found[0]), least, most, ideal.get(key, inf)
    )


def interval(found: Floats) -> tuple[float, float]:
    """In which 99 % of further runs are expected, by those of all starts (8,), in their unit.

    Where a run never reached the number (infinite), it has no upper bound.
    """
    if not np.isfinite(found).all():
        return float(found.min()), inf
    half = SPREAD * float(np.std(found, ddof=1))
    least = float(np.mean(found)) - half
    return max(least, 0.0) if (found >= 0).all() else least, float(np.mean(found)) + half


@dataclass(frozen=True, slots=True)
class ControllerSurvival:
    """A controller on a path: its title, and the verdict with each operator."""

    name: str
    title: str
    verdicts: Mapping[str, str]
    stable: bool

    @property
    def text(self) -> str:
        """In words."""
        if self.stable:
            return f"OK    {self.name}: {self.title}"
        said = "; ".join(f"{o}: {v}" for o, v in self.verdicts.items() if v[:3] != "yes")
        return f"FAILS {self.name}: {self.title} ({said})"


def survivors(
    path: Path, variants: Path, trace: PathTrace, folder: Path,
    settings: Sequence[str] = (), jobs: int = 1,
) -> list[ControllerSurvival]:  # fmt: skip
    """The controllers of a comparison that come to rest on a path, with each of its operators.

    Writes ``compare.toml`` into `folder`: the variants file with a link law ``measured``. `jobs`:
    processes, a pure number. Raises ScenarioError.
    """
    there, back = trace.write(folder)
    file = folder / "compare.toml"
    file.write_text(_variants(variants.resolve(), there, back, trace.semantics), encoding="utf-8")
    known = read_variants(file)
    chosen = known.select((), (), ("measured",))
    base = read_base(path, known, list(settings))
    found = compare(base, known.with_columns(["effort"]), chosen, (base.seed,), jobs=jobs)
    result = []
    for name in chosen.controllers:
        mine = [o for o in found.outcomes if o.case.controller == name]
        said = {o.case.operator: o.verdict.text for o in mine}
        stable = all(o.verdict.stable for o in mine)
        result.append(ControllerSurvival(name, known.controllers[name].title, said, stable))
    return result


def _variants(extended: Path, there: Path, back: Path, semantics: str) -> str:
    """The last role receives by the way there, the first one by the way back."""
    roles = list(read_variants(extended).roles)
    law = '{{ law = "trace", file = "{}", repeat = true }}'
    ways = "\n".join(
        f"{role} = {{ delay = {law.format(back if role == roles[0] else there)} }}"
        for role in roles
    )
    return (
        f'extends = "{extended}"\n\n[links.measured]\ntitle = "measured"\n'
        f'semantics = "{semantics}"\n{ways}\n'
    )
