"""``report.html`` of a run folder: results, diagrams, moving arms, links, and how to repeat it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from heapq import nsmallest
from itertools import islice
from math import inf, isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.copies import replace
from cosim.base.errors import CosimError
from cosim.base.names import counted, listed, signal_of
from cosim.base.units import engineering, engineering_range, prefixed, readable
from cosim.measure import declared_metrics, requirements
from cosim.measure.link_ages import age_groups, summarize_ages
from cosim.measure.metric_result import MetricResult
from cosim.measure.metrics import Error, Metric, evaluate
from cosim.measure.robustness import Robustness, worst
from cosim.record import Run
from cosim.record.folder import REPORT
from cosim.record.piecewise import at_times, first_step
from cosim.reporting import many
from cosim.reporting.arms import DrawnArm, arm_signals, curve_colours, first_arms, owners
from cosim.reporting.diagnostics import configured_delay, controllers, findings, limits
from cosim.reporting.html import (
    Array,
    Badge,
    Card,
    PageData,
    PlottedPanel,
    capital,
    cards,
    command,
    folded,
    histogram,
    packed,
    table,
    whole,
    write_page,
)
from cosim.reporting.labels import in_order_of_weight, metric_card, metric_title, renamed, rows
from cosim.reporting.macro_steps import macro_section
from cosim.reporting.marks import failure, marks
from cosim.reporting.recorded import recorded_scenario, repeating_command
from cosim.reporting.thinning import Thinned
from cosim.scenario.spec import FigureSpec, PanelSpec, Scenario

#: Points of a signal in a declared diagram, and of one that can be chosen.
SHOWN, CHOSEN = 2400, 600
#: Frames per second of moving arms, and how many there are at the most.
RATE, FRAMES = 20.0, 2000
#: Diagrams of a scenario that declares none, and cards of metrics.
PANELS, CARDS = 6, 4
#: Diagrams of one metric that compares signals, for the entries that move most.
COMPARED = 3


def write_report(
    run: Run,
    judged: Badge | None = None,
    extend: Callable[[PageData], str] = lambda data: "",
    first: str = "",
) -> Path:
    """Write the report of a run into its folder.

    `judged`: its verdict, by default whether its errors settled; `extend` adds to what is drawn,
    and returns HTML that stands below the diagrams; `first`: HTML below the verdict. Raises
    CosimError if it cannot be written.
    """
    folder = run.path.parent
    facts = run.metadata
    try:
        scenario = recorded_scenario(run)
        metrics = in_order_of_weight(declared_metrics.metrics(scenario))
        results = tuple(
            renamed(result, metric_title(metric))
            for metric, result in zip(metrics, evaluate(metrics, run), strict=True)
        )
        required = requirements.of_run(scenario, run)
    except CosimError:  # cut short, or made by something else
        scenario, metrics, results, required = None, [], (), ()
    data = _data(run, scenario, facts, metrics)
    subtitle = f"{facts.get('scenario', {}).get('path', '')} · {folder.name}"
    title = scenario.title if scenario is not None else folder.name
    return write_page(
        folder / REPORT, title, subtitle, judged or verdict(facts, scenario, results, required),
        first + cards([*map(_required, required), *_numbers(facts, metrics, results)]), data,
        "".join([
            findings(facts), requirement_table(required), limits(run, facts), extend(data),
            _links(run, facts, data), macro_section(facts), _details(run, facts, results),
        ]),
    )  # fmt: skip


# ---- results ----------------------------------------------------------------------------------


def verdict(
    facts: Mapping[str, Any],
    scenario: Scenario | None,
    results: tuple[MetricResult, ...],
    required: Sequence[Robustness] = (),
) -> Badge:
    """The verdict on a run: did it come to its end, and does it meet its requirements?

    Without requirements: did its errors settle as declared?
    """
    failed = failure(facts)
    if failed:
        return Badge("error", failed)
    if facts.get("ended"):
        return Badge("finished", f"{facts['ended']['component']} ended it")
    word = worst(required)
    if word is not None:
        missed = "; ".join(r.line for r in required if r.verdict == word)
        return Badge(word, missed if word != "passed" else _all_met(required))
    judged = [r for r in results if "settle_s" in r.parts]
    late = [r for r in judged if not isfinite(r.parts["settle_s"])]
    if late:
        return Badge("failed", f"{', '.join(r.label for r in late)}: never within its bound")
    if judged and scenario is not None:
        latest = max(r.parts["settle_s"] for r in judged)
        return Badge(
            "passed", f"every error with a bound stays within it from {engineering(latest, 's')} on"
        )
    return Badge("finished", "the scenario declares no bound to judge by")


def _all_met(required: Sequence[Robustness]) -> str:
    return "the requirement is met" if len(required) == 1 else "every requirement is met"


def _required(result: Robustness) -> Card:
    """The card of a requirement: its verdict, and by how much."""
    margin = f"margin {result.margin}" if isfinite(result.value) else ""
    return Card(result.name, result.verdict, result.condition, margin, result.verdict)


def requirement_table(required: Sequence[Robustness]) -> str:
    """HTML of the table of requirements; "" without any."""
    if not required:
        return ""
    head = ["requirement", "condition", "result"]
    rows = [(r.name, r.condition, r.text) for r in required]
    words = [r.verdict for r in required]
    return f'<h2>Requirements</h2><div id="requirements">{table(head, rows, marks=words)}</div>'


def _numbers(
    facts: Mapping[str, Any], metrics: Sequence[Metric], results: Sequence[MetricResult]
) -> list[tuple[str, str] | Card]:
    found: list[tuple[str, str] | Card] = [*map(metric_card, metrics[:CARDS], results)]
    if facts.get("wall") and facts.get("ticks"):
        seconds = facts["ticks"] * facts["step"]
        ratio = seconds / facts["wall"]
        number = f"{ratio:.0f}" if ratio >= 10 else f"{ratio:.2g}"
        found.append(("speed", f"{number} × real time"))
    return found


# ---- diagrams ---------------------------------------------------------------------------------


def _data(
    run: Run, scenario: Scenario | None, facts: Mapping[str, Any], metrics: Sequence[Metric]
) -> PageData:
    if not len(run):
        return PageData(0.0)
    every = facts.get("scenario", {}).get("run", {}).get("record", {}).get("every", 1)
    begin, end = run.span
    dt = float(facts.get("step") or first_step(run, 1.0)) * every
    data = PageData(end, events=marks(facts), start=begin, begin=begin)
    arms, data.arms_note = first_arms(run)
    panels = _panels(run, scenario, metrics, data, dt)
    data.panels += coloured(panels, [arm.name for arm in arms], facts)
    shown = {name for panel in data.panels for name, _ in panel.series}
    names = _in_order(run.names)
    choosable = set(names[: many.SIGNALS])
    kept = {
        name: Thinned(len(run), SHOWN if name in shown else CHOSEN)
        for name in names
        if name in shown or name in choosable
    }
    for piece in run.pieces([*kept]):
        for name, samples in kept.items():
            samples.add(piece.column(name))
    for name, samples in kept.items():
        data.add_thinned(name, run.units[name], samples, dt)
    data.frame = max(1.0 / RATE, (end - begin) / FRAMES)
    data.arms += list(_arms(run, arms, frame_times(data)))
    return data


def coloured(
    panels: Iterable[PlottedPanel], arms: Sequence[str], facts: Mapping[str, Any]
) -> list[PlottedPanel]:
    """The panels; where each curve is of another arm, it has the colour of that arm in the picture.

    A component is of the arm that it is, or of the only one that feeds it. `facts`: of the run.
    """
    of = owners(arms, facts)
    return [
        replace(panel, colours=curve_colours([name for name, _ in panel.series], of))
        for panel in panels
    ]


def _in_order(names: Iterable[str]) -> list[str]:
    """Signals in the order of the names of their components, in which numbers count."""
    return sorted(names, key=lambda name: counted(name.partition(".")[0]))


def _panels(
    run: Run, scenario: Scenario | None, metrics: Sequence[Metric], data: PageData, dt: float
) -> Iterator[PlottedPanel]:
    figures = list(scenario.figures.values()) if scenario else []
    named = {signal_of(x): i for i, m in reversed([*enumerate(metrics)]) for x in m.signals}

    def weight(figure: FigureSpec) -> int:
        """The first metric that names one of its signals: what the scenario is about."""
        signals = [signal_of(name) for panel in figure.panels for name in panel.y]
        return min(named.get(signal, len(metrics)) for signal in signals)

    for spec in (panel for figure in sorted(figures, key=weight) for panel in figure.panels):
        yield _declared(run, spec, data, dt)
    if not figures:
        yield from islice(undeclared(run, metrics), PANELS)


def undeclared(run: Run, metrics: Sequence[Metric]) -> Iterator[PlottedPanel]:
    """Diagrams of a scenario that declares none: what its metrics name, then what else moves.

    Signals that a metric compares are drawn over each other, the entries that move most first.
    """
    names = _in_order(run.names)
    moved = _moved(run, names)
    signals = dict.fromkeys(signal_of(name) for name in names)
    pairs = [m for m in metrics if isinstance(m, Error) and isinstance(m.target, str)]
    for metric in pairs:
        compared = [run.entries(name) for name in reversed(metric.signals) if run.has(name)]
        if len({len(entries) for entries in compared}) != 1 or len(compared) < 2:
            continue
        together = list(zip(*compared, strict=True))
        together.sort(key=lambda entries: -max(moved[name] for name in entries))
        for entries in together[:COMPARED]:
            if len(entries) <= many.LINES:
                title = listed(entries)
                yield _panel(run, title, entries)
    shown = {signal_of(name) for m in pairs for name in m.signals}
    named = [signal_of(name) for metric in metrics for name in metric.signals]
    still = [s for s in signals if not any(moved[name] for name in run.entries(s))]
    for signal in dict.fromkeys([*(n for n in named if n in signals), *signals]):
        if signal not in shown and signal not in still:
            yield _panel(run, signal, run.entries(signal))
    for signal in still:
        yield _panel(run, signal, run.entries(signal))


def _moved(run: Run, names: Sequence[str]) -> dict[str, float]:
    """The greatest less the least value of each scalar."""
    least, most = np.full(len(names), inf), np.full(len(names), -inf)
    for piece in run.pieces(names) if len(run) else ():
        columns = [piece.column(name) for name in names]
        least = np.minimum(least, [x.min() for x in columns])
        most = np.maximum(most, [x.max() for x in columns])
    return dict(
        zip(names, (most - least).tolist() if len(run) else [0.0] * len(names), strict=True)
    )


def _panel(run: Run, title: str, names: Sequence[str]) -> PlottedPanel:
    return PlottedPanel(title, run.units[names[0]], tuple((n, n) for n in names))


def _declared(run: Run, spec: PanelSpec, data: PageData, dt: float) -> PlottedPanel:
    labels = spec.labels or spec.y
    series = []
    for name, label in zip(spec.y, labels, strict=False):
        entries = run.entries(name)
        series += [(n, label if len(entries) == 1 else f"{label}{n[len(name) :]}") for n in entries]
    if len(series) > many.LINES:
        series = list(_quantiles(run, spec, [name for name, _ in series], data, dt))
    for name in (r for r in spec.reference if isinstance(r, str)):
        series += [(n, spec.reference_label or n) for n in run.entries(name)]
    title = capital(spec.title or spec.ylabel or listed(spec.y))
    return PlottedPanel(
        f"{title} ({spec.ylabel})" if spec.title and spec.ylabel else title,
        run.units[run.entries(spec.y[0])[0]],
        tuple(series),
        tuple(float(r) for r in spec.reference if not isinstance(r, str)),
    )


def _quantiles(
    run: Run, spec: PanelSpec, names: Sequence[str], data: PageData, dt: float
) -> Iterator[tuple[str, str]]:
    """Signals of a diagram with many lines: quantiles over them; the names are theirs."""
    about = spec.title or names[0].partition(".")[2]
    kept = {label: Thinned(len(run), SHOWN) for label, _ in many.QUANTILES}
    for piece in run.pieces(names):
        values = np.column_stack([piece.column(name) for name in names])
        for label, line in many.quantile_lines(values):
            kept[label].add(line)
    for label, samples in kept.items():
        name = f"{label} of {len(names)}: {about}"
        data.add_thinned(name, run.units[names[0]], samples, dt)
        yield name, label


# ---- arms -------------------------------------------------------------------------------------


def frame_times(data: PageData) -> Array:
    """The times at which a page knows the positions of its arms, (n,), s."""
    return np.arange(data.begin, data.end + data.frame, data.frame)


def _arms(run: Run, arms: Sequence[DrawnArm], t: Array) -> Iterator[dict[str, Any]]:
    """Arms as the page draws them, at the times `t` (n,), s."""
    signals = [arm_signals(run, arm) for arm in arms]
    names = dict.fromkeys(name for each in signals for found in each.values() for name in found)
    frames = at_times(run, [*names], t)
    for arm, each in zip(arms, signals, strict=True):
        columns = {key: [packed(frames[n], "<f4") for n in found] for key, found in each.items()}
        yield {**arm.data(), **columns}


# ---- links ------------------------------------------------------------------------------------


def _links(run: Run, facts: Mapping[str, Any], data: PageData) -> str:
    rows, pictures = [], []
    tables = run.link_tables
    drawn = many.LINKS if len(tables) <= many.LINKS else many.AGES
    for name in nsmallest(many.LINKS, tables, key=counted):
        found = summarize_ages(tables[name])
        if found is None:
            continue
        marks = {f"p{p}": found.percentile(p) for p in (50, 95, 99)}
        law = facts.get("links", {}).get(name, {}).get("delay") or {}
        greatest = float(found.values[-1])
        scale, unit = prefixed(max(greatest, found.delays[1]), "s")
        ages = (found.mean, *marks.values(), greatest)
        rows.append([
            _arrow(name), whole(configured_delay(law)), engineering_range(*found.delays, "s"),
            *(f"{readable(scale * x, 3)} {unit}" for x in ages), f"{100 * found.lost:.3g} %",
        ])  # fmt: skip
        if len(rows) > drawn:
            continue
        kept = Thinned(found.steps, CHOSEN)
        for group in age_groups(tables[name]):
            kept.add(group.age)
        data.add_thinned(f"age of {name}", "s", kept, found.period)
        often = histogram(f"How often: {_arrow(name)}", "s", found.values, marks, found.counts)
        pictures.append(often)
        title = f"Age of the sample that is held, {_arrow(name)}"
        data.panels.append(PlottedPanel(title, "s", ((f"age of {name}", "age"),), (), "ages"))
    if not rows:
        return ""
    head = ["link", "delay configured", "delay of used samples", "mean age", "p50", "p95", "p99",
            "greatest", "never used"]  # fmt: skip
    return (
        f"<h2>Links</h2>{table(head, rows, 7)}{many.further(len(tables), many.LINKS, 'links')}"
        '<section id="ages"></section>'
        f'<div class="charts">{"".join(pictures)}</div>'
    )


def _arrow(link: str) -> str:
    """The name of a link with an arrow at which a line may break."""
    return link.replace("->", " → ")


# ---- details ----------------------------------------------------------------------------------


def _details(run: Run, facts: Mapping[str, Any], results: tuple[MetricResult, ...]) -> str:
    scenario = facts.get("scenario", {})
    components = list(_components(scenario, facts))
    below = many.further(len(scenario.get("components", {})), many.ROWS, "components")
    head = ["component", "model", "every", "values"]
    lines = [row for r in results for row in rows(r)]
    parts = [
        folded("Results", f'<div id="results">{table(["metric", "value"], lines)}</div>',
               opened=True) if results else "",
        controllers(run, facts),
        folded("Components", table(head, components) + below),
        folded("Versions, seed, files", table(["", ""], list(islice(_origin(facts), many.ROWS)))),
    ]  # fmt: skip
    again = repeating_command(run)
    repeat = f"<h2>Repeat it</h2>{command('repeat', again)}" if again else ""
    return f"{repeat}<h2>Details</h2>{''.join(parts)}"


def _components(
    scenario: Mapping[str, Any], facts: Mapping[str, Any]
) -> Iterator[tuple[str, str, str, str]]:
    components = scenario.get("components", {})
    for name in nsmallest(many.ROWS, components, key=counted):
        spec = components[name]
        given = {**(spec.get("parameters") or {}), **(spec.get("start") or {})}
        preset = [f"preset {spec['preset']}"] if spec.get("preset") else []
        values = ", ".join([*preset, *(f"{k} = {v}" for k, v in given.items())])
        period = spec.get("period") or scenario.get("run", {}).get("step", facts.get("step"))
        every = period if isinstance(period, str) else engineering(float(period), "s")
        yield name, str(spec.get("model", "")), every, values


def _origin(facts: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    yield "seed", str(facts.get("seed"))
    step = engineering(float(facts.get("step") or nan), "s")
    yield "step, ticks, algorithm", f"{step}, {facts.get('ticks')}, {facts.get('algorithm')}"
    yield from (facts.get("versions") or {}).items()
    for name, fmu in (facts.get("fmus") or {}).items():
        yield (
            f"FMU of {name}",
            f"{Path(fmu['file']).name}, FMI {fmu['fmi']}, SHA-256 {fmu['sha256']}",
        )
    for path, total in (facts.get("files") or {}).items():
        yield str(path), f"SHA-256 {total}"
