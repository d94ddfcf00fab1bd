"""``cosim fit``: parameters of a scenario or an FMU from measured data."""

from __future__ import annotations

from math import ceil, isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cosim.base.convert import Struct, field
from cosim.cli.options import ResultOptions

if TYPE_CHECKING:
    from cosim.fitting.fit import Fit
    from cosim.fitting.varied import Varied
    from cosim.record.recording import Recording
    from cosim.scenario.spec import Scenario
    from cosim.schedule.plan import Plan


class FitOptions(Struct, frozen=True):
    """The parameters of a fit, and what is compared."""

    vary: Annotated[
        list[str],
        typer.Option(
            "--vary",
            metavar="NAME[=START]:LOW..HIGH",
            help="Vary this parameter, e.g. m:0.5..2 or arm.theta[1]=1:0.1..5; repeatable.",
        ),
    ]
    match: Annotated[
        list[str],
        typer.Option(
            metavar="SIGNAL=COLUMN",
            help="Compare a signal with a column of another name; repeatable.",
        ),
    ] = field(default_factory=list)
    set_: Annotated[
        list[str],
        typer.Option("--set", metavar="PATH=VALUE", help="Change a value; repeatable."),
    ] = field(default_factory=list)
    runs: Annotated[int, typer.Option(min=1, help="Runs at the most.")] = 1000


def fit(
    scenario: Annotated[
        Path, typer.Argument(help="Scenario (.toml), system of another tool (.ssp), or FMU (.fmu).")
    ],
    data: Annotated[
        Path,
        typer.Argument(
            help="Measured signals over time: .csv with a column t, .parquet, or a run folder. "
            "Columns that are inputs of a single FMU feed it."
        ),
    ],
    options: FitOptions,
    result: ResultOptions,
) -> None:
    """Fit parameters of a scenario or an FMU to measured data, with confidence intervals."""
    from cosim.cli.summary import live_line
    from cosim.fitting.fit import Fitting, measured
    from cosim.fitting.varied import varied
    from cosim.record.recording import Recording

    recording = Recording.read(data, jumps=True)
    loaded, plan = _plan(scenario, recording, options.set_, data)
    names = dict(_pair(text) for text in options.match)
    signals = measured(plan, _outputs(plan), recording, names)
    parameters = varied(plan, options.vary)
    with live_line(result.quiet) as say:
        found = Fitting(
            plan,
            signals,
            recording.t,
            parameters,
            lambda n, rms: say(f"run {n}: differences {rms:.4g} standard deviations of the data"),
        ).run(options.runs)
    result.save("fit", _as_data(found))
    result.say(f"{loaded.title}: {len(signals)} signals of {data}, {recording.t.size} times each")
    for line in (*_parameters(found), *_differences(found), _again(scenario, plan, found)):
        result.say(line)
    if not found.converged:
        typer.echo(f"error: not converged after {found.runs} runs: {found.reason}", err=True)
        raise typer.Exit(1)


def _pair(text: str) -> tuple[str, str]:
    from cosim.base.errors import ScenarioError

    signal, equals, column = text.partition("=")
    if not (equals and signal and column):
        raise ScenarioError(f"--match {text!r}: expected SIGNAL=COLUMN")
    return signal, column


def _plan(path: Path, data: Recording, settings: list[str], file: Path) -> tuple[Scenario, Plan]:
    """The scenario until the end of the data, with what is measured among its outputs."""
    from cosim.base.errors import ScenarioError
    from cosim.base.toml import as_toml
    from cosim.loading.files import load
    from cosim.loading.one_fmu import inputs_among
    from cosim.scenario.assemble import assemble

    table = file if path.suffix == ".fmu" and inputs_among(path, data) else None
    every = assemble(load(path, [*settings, 'run.record.signals=["all"]'], table))
    parameters = {f"{s.name}.{p.name}" for s in every.components for p in s.component.parameters}
    wanted = [
        n
        for n in every.slots()
        if n not in parameters and {n, n.partition(".")[2]} & _signals(data)
    ]
    if data.t[0] < every.start - 1e-9 * every.h:
        raise ScenarioError(
            f"begins at {data.t[0]:g} s, before the run, at {every.start:g} s; expected --set "
            f"run.start={data.t[0]:g}",
            str(file),
        )
    ticks = max(1, ceil((float(data.t[-1]) - every.start) / every.h - 1e-9))
    stop = every.start + ticks * every.h
    settings = [f"run.stop={stop!r}", f"run.step={every.h!r}", *settings]
    settings += [f"run.record.signals={as_toml(wanted)}"] if wanted else []
    loaded = load(path, settings, table)
    return loaded, assemble(loaded)


def _signals(data: Recording) -> set[str]:
    from cosim.base.names import signal_of

    return {*data.columns, *(signal_of(c) for c in data.columns)}


def _outputs(plan: Plan) -> list[Any]:
    from cosim.engine.simulate import columns

    outputs = {name for c in plan.components for s in c.outputs for name in s.scalars()}
    return [c for c in columns(plan, [s.name for x in plan.components for s in x.outputs])
            if c.name in outputs]  # fmt: skip


# ---- what is printed --------------------------------------------------------------------------


def _parameters(found: Fit) -> list[str]:
    from cosim.cli.show import aligned

    rows = [["parameter", "start", "fitted", "95 %", "unit", "bounds"]]
    for p in found.parameters:
        v = p.varied
        sure = "at a bound" if p.at_bound else "not determined" if isnan(p.interval) else ""
        rows.append(
            [v.name, f"{v.start:.6g}", f"{p.value:.6g}", sure or f"± {p.interval:.2g}", v.unit,
             f"{v.low:g} .. {v.high:g}"]
        )  # fmt: skip
    return ["", *aligned(rows), *_correlated(found)]


def _correlated(found: Fit) -> list[str]:
    lines = []
    for i, a in enumerate(found.parameters):
        for j, b in enumerate(found.parameters[:i]):
            if abs(found.correlation[i, j]) > 0.95:
                lines.append(
                    f"  {b.varied.name} and {a.varied.name} are hardly told apart: correlation "
                    f"{found.correlation[i, j]:.3f}"
                )
    return lines


def _differences(found: Fit) -> list[str]:
    from cosim.cli.show import aligned

    rows = [["signal", "before", "after", "unit"]]
    rows += [[n, f"{a:.4g}", f"{b:.4g}", u] for n, (a, b, u) in found.differences.items()]
    few = [
        f"note: the differences of {name} depend on each other: they count as {n:.0f} independent "
        "ones. Intervals allow for such noise, but not for errors of the model"
        for name, n in found.independent.items()
        if n < 0.5 * found.values
    ]
    return ["", f"differences to the data (RMS), {found.runs} runs", *aligned(rows), *few]


def _again(path: Path, plan: Plan, found: Fit) -> str:
    """The command that runs with the fitted values."""
    from cosim.base.toml import as_toml
    from cosim.fitting.varied import with_values

    chosen: list[Varied] = [p.varied for p in found.parameters]
    steps = {s.name: s for s in with_values(plan, chosen, [p.value for p in found.parameters])}
    settings = []
    for component, name in dict.fromkeys((v.component, v.parameter) for v in chosen):
        value = list(steps[component].values[name])
        place = name if path.suffix == ".fmu" else f"components.{component}.parameters.{name}"
        settings.append(f"--set '{place}={as_toml(value[0] if len(value) == 1 else value)}'")
    return f"\nwith these values: cosim run {path} {' '.join(settings)}"


def _as_data(found: Fit) -> dict[str, Any]:
    return {
        "parameters": [
            {
                "name": p.varied.name, "unit": p.varied.unit, "start": p.varied.start,
                "value": p.value, "interval_95": p.interval,
                "low": p.varied.low, "high": p.varied.high, "at_bound": p.at_bound,
            }
            for p in found.parameters
        ],
        "rms": {n: {"before": a, "after": b, "unit": u}
                for n, (a, b, u) in found.differences.items()},
        "independent": dict(found.independent),
        "runs": found.runs, "converged": found.converged, "reason": found.reason,
    }  # fmt: skip
