"""The result of a run, as a program reads it."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, final

from cosim.api.arguments import expect
from cosim.base.errors import CosimError, ScenarioError
from cosim.base.names import signal_of
from cosim.record import Run

if TYPE_CHECKING:
    import numpy as np
    import pandas
    import polars
    import xarray
    from numpy.typing import NDArray

    from cosim.api.answers import Answer, Target
    from cosim.base.convert import Number
    from cosim.measure.metrics import MetricResult
    from cosim.measure.robustness import Robustness
    from cosim.reporting.figures import Figure
    from cosim.scenario.spec import Scenario


@final
class RunResult:
    """A recorded run: signals by name, metrics, answers, tables for other libraries, a picture.

    ``result["master.q"]`` is (n, m) in the unit ``result.unit("master.q")``; one entry,
    ``result["master.q[0]"]``, and a scalar signal are (n,). ``result.t`` (n,) is in s. Unknown
    names raise ScenarioError with the nearest known ones. A result made without `out` lives in a
    temporary folder, which is removed with the object.
    """

    def __init__(self, run: Run, kept: TemporaryDirectory[str] | None = None) -> None:
        self._run, self._kept = run, kept

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        expect("RunResult[...]", {"signal": "text"}, {"signal": name})
        if name in self._run.units:
            return self._run.column(name)
        return self._run.array(name)

    def __len__(self) -> int:
        return len(self._run)

    def __repr__(self) -> str:
        until = f"{self._run.span[1]:g} s" if len(self) else "nothing"
        return f"<run {self.title!r}: {len(self)} rows to {until}, {self.status}>"

    @property
    def folder(self) -> Path:
        """The run folder."""
        return self._run.path.parent

    @property
    def t(self) -> NDArray[np.float64]:
        """Time of each row, (n,), s."""
        return self._run.t

    @property
    def signals(self) -> tuple[str, ...]:
        """The names of all recorded signals."""
        return tuple(dict.fromkeys(signal_of(name) for name in self._run.names))

    def unit(self, name: str) -> str:
        """The unit of a signal."""
        expect("RunResult.unit", {"name": "text"}, locals())
        return self._run.unit(name)

    @property
    def metadata(self) -> dict[str, Any]:
        """The content of ``run.json``: scenario, versions, seed, files with their sums."""
        return self._run.metadata

    @property
    def title(self) -> str:
        """The title of the scenario, or the name of the folder."""
        return str(self.metadata.get("scenario", {}).get("title") or self.folder.name)

    @property
    def status(self) -> str:
        """``finished``, or how the run ended."""
        return str(self.metadata.get("status", "unknown"))

    @property
    def metrics(self) -> Mapping[str, MetricResult]:
        """The metrics that the scenario declares, by name: value, unit, detail and parts."""
        from cosim.measure import declared_metrics
        from cosim.measure.metrics import evaluate

        found = evaluate(declared_metrics.metrics(self._scenario()), self._run)
        return {result.name: result for result in found}

    @property
    def requirements(self) -> Mapping[str, Robustness]:
        """The results of the scenario's requirements by name: verdict, margin, time and text."""
        from cosim.measure import requirements

        found = requirements.of_run(self._scenario(), self._run)
        return {result.name: result for result in found}

    # ---- questions ---------------------------------------------------------------------------

    def settles(self, signal: str, to: Target, *, band: Number, within: Number) -> Answer:
        """True if `signal` comes as near to `to` as `band`, `within` a time, s, and stays there.

        `to`: another signal, or a number, or one for each entry; the nearness is that of the entry
        that is furthest away, in the unit of the signal, or a text with a unit. Raises
        ScenarioError for a signal that was not recorded, and for units that do not fit.
        """
        from cosim.api import answers

        kinds = {"signal": "text", "band": "quantity", "within": "quantity"}
        expect("RunResult.settles", kinds, locals())
        return answers.settles(self._run, signal, to, band, within)

    def stays_below(self, signal: str, bound: Number) -> Answer:
        """True if no entry of a signal has a magnitude of `bound` (in its unit) or more."""
        from cosim.api import answers

        expect("RunResult.stays_below", {"signal": "text", "bound": "quantity"}, locals())
        return answers.stays_below(self._run, signal, bound)

    def overshoot_stays_below(self, signal: str, bound: Number, *, to: Target) -> Answer:
        """True if no entry goes beyond its target `to`, seen from its start, by `bound` or more.

        `bound` and `to` are in the unit of the signal, or texts with a unit; `to` may be a signal,
        whose last value then says in which direction the target lies. Raises ScenarioError.
        """
        from cosim.api import answers

        kinds = {"signal": "text", "bound": "quantity"}
        expect("RunResult.overshoot_stays_below", kinds, locals())
        return answers.overshoot(self._run, signal, to, bound)

    def age_stays_below(self, link: str, bound: Number) -> Answer:
        """True if the receiver of a link never holds a sample of the age `bound`, s, or more.

        Until its first sample comes, it waits since the start. Raises ScenarioError for an unknown
        link.
        """
        from cosim.api import answers

        expect("RunResult.age_stays_below", {"link": "text", "bound": "quantity"}, locals())
        return answers.age(self._run, link, bound)

    def passes(self, *names: str) -> Answer:
        """True if these requirements of the scenario pass, or these metrics with the key
        ``within`` stay in their bands at the end.

        Without `names` all requirements have to, or, where there is none, all such metrics. Raises
        ScenarioError for an unknown name, and where there is neither.
        """
        from cosim.api import answers

        return answers.passes(self.requirements, self.metrics, names, str(self.folder))

    def has_no_faults(self) -> Answer:
        """True if the run came to its end, and a rehearsal passed with no node in a fault state."""
        from cosim.api import answers

        return answers.no_faults(self.metadata)

    def is_identical_to(self, other: RunResult | str | Path) -> Answer:
        """True if every signal of another run, or of its folder, is the same to the bit.

        Raises ScenarioError for a folder that is no run.
        """
        from cosim.api import answers

        folder = other.folder if isinstance(other, RunResult) else other
        expect("RunResult.is_identical_to", {"other": "path"}, {"other": folder})
        return answers.identical(self._run, Path(folder))

    # ---- other libraries ---------------------------------------------------------------------

    def to_pandas(self) -> pandas.DataFrame:
        """A table with the time as its index; ``attrs["units"]`` has the unit of each column.

        Raises ScenarioError where pandas is not installed.
        """
        library = _library("pandas")
        columns = {name: self._run.column(name) for name in self._run.names}
        frame: pandas.DataFrame = library.DataFrame(columns, index=library.Index(self.t, name="t"))
        frame.attrs["units"] = {name: self._run.units[name] for name in columns}
        return frame

    def to_polars(self) -> polars.DataFrame:
        """A table with the column ``t``. Raises ScenarioError where polars is not installed."""
        library = _library("polars")
        columns = {"t": self.t} | {name: self._run.column(name) for name in self._run.names}
        table: polars.DataFrame = library.DataFrame(columns)
        return table

    def to_xarray(self) -> xarray.Dataset:
        """A variable per signal over ``t``; vectors have a second dimension NAME_entry.

        ``attrs["units"]`` of each variable is its unit. Raises ScenarioError where xarray is not
        installed.
        """
        library = _library("xarray")
        variables = {}
        for name in self.signals:
            values = self[name]
            dims = ("t",) if values.ndim == 1 else ("t", f"{name}_entry")
            variables[name] = (dims, values, {"units": self.unit(name)})
        attributes = {"title": self.title, "folder": str(self.folder)}
        time = {"t": ("t", self.t, {"units": "s"})}
        data: xarray.Dataset = library.Dataset(variables, time, attributes)
        return data

    # ---- pictures ----------------------------------------------------------------------------

    def plot(self, *names: str, path: str | Path | None = None) -> PngPicture:
        """A picture of signals over time, a panel each; by default the scenario's first figure.

        `path`: the PNG to write, by default ``NAME.png`` in the run folder. Raises ScenarioError
        for a signal that was not recorded.
        """
        from cosim.reporting.figures import Figure, Panel, draw

        expect("RunResult.plot", {"names": "texts", "path": "path?"}, locals())
        if names:
            figure = Figure(tuple(Panel((name,), title=name) for name in names), self.title)
            name = "signals"
        else:
            name, figure = self._declared_figure()
        return PngPicture(draw(figure, self._run, path or self.folder / f"{name}.png"))

    def _declared_figure(self) -> tuple[str, Figure]:
        from cosim.reporting.declared import figure_specs
        from cosim.reporting.figures import Figure, Panel

        for name, figure in figure_specs(self._scenario(), self._run).items():
            return name, figure
        shown = self.signals[:6]
        return "signals", Figure(tuple(Panel((x,), title=x) for x in shown), self.title)

    def report(self) -> Path:
        """Write ``report.html`` into the run folder, and return its path. Raises CosimError."""
        from cosim.live.page import rewrite_live
        from cosim.reporting.rewritten import rewrite

        return rewrite_live(self._run) or rewrite(self._run)

    def _repr_html_(self) -> str:
        """The top of a report: title, status, metrics; without scripts."""
        rows = [
            f"<tr><td>{escape(label)}</td><td>{escape(text)}</td></tr>"
            for m in self._metrics_or_none()
            for label, text in m.facts
        ]
        until = f"{self._run.span[1]:g} s" if len(self) else "nothing recorded"
        return (
            f"<div><b>{escape(self.title)}</b> &nbsp; {escape(self.status)}, {until}, "
            f"{len(self)} rows, {len(self.signals)} signals<br><code>{escape(str(self.folder))}"
            f"</code><table>{''.join(rows)}</table></div>"
        )

    def _metrics_or_none(self) -> tuple[MetricResult, ...]:
        try:
            return tuple(self.metrics.values())
        except CosimError:  # a run that was cut short has no scenario, or no rows
            return ()

    def _scenario(self) -> Scenario:
        """The part of the run's scenario that declares metrics and figures."""
        from cosim.reporting.recorded import recorded_scenario

        return recorded_scenario(self._run)


@final
class PngPicture:
    """A PNG file that a notebook shows."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __repr__(self) -> str:
        return f"<picture {self.path}>"

    def _repr_png_(self) -> bytes:
        """The bytes of the file."""
        return self.path.read_bytes()


def _library(name: str) -> Any:
    """An optional library. Raises ScenarioError with the way to install it."""
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError:
        raise ScenarioError(f"{name} is not installed: pip install {name}") from None
