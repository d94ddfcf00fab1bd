"""Columns of a comparison that come from tests of the operator's port, not from the runs.

    [port]                                  # of a variants file
    operator = "master"                     # the role whose arm is pushed with small forces
    environment = "slave"                   # the role whose arm meets the environment
    q = [3.5, 3.0]                          # where both arms rest, rad
    band = [0.6, 30.0]                      # rad/s
    spring = { stiffness = 100.0, damping = 2.0 }       # the environment of "transparency"
    rigid = { stiffness = 1e4, damping = 50.0 }         # that of Z_max

    [columns.transparency]
    kind = "transparency"                   # or "z_width", "free_impedance", "passivity"
    environment = "free"                    # of "passivity": or "spring", "rigid"

The environment is a spring and a damper to `q` on each joint, solved inside the arm. Hands are let
go of, so these numbers depend on controller, links and seed, and not on the operator.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import nan
from typing import get_args

from cosim.analysis.experiments import FORCE, Bench
from cosim.analysis.force_tests import UNSTABLE
from cosim.base.errors import CosimError, RunError, ScenarioError
from cosim.comparison.documents import Case
from cosim.comparison.toml import Section
from cosim.comparison.variants import Environment, MetricColumn, PortBench, PortKind, PortMeasure
from cosim.predict.frequency import MultiSine, PortGain
from cosim.predict.port import port_of
from cosim.predict.system import system
from cosim.predict.transparency import (
    Estimate,
    free_impedance,
    log_weights,
    passivity_margin,
    spring_impedance,
    transparency_error,
    z_width,
)
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario

#: Frequencies of the test force, and periods over which the response is averaged.
FREQUENCIES, PERIODS = 16, 3
#: The mean uncertainty of |G|, two standard deviations as a share of it, that leaves no number.
UNKNOWN = 0.5
UNITS: Mapping[PortKind, str] = {
    "transparency": "dB", "z_width": "dB", "free_impedance": "N.m.s/rad", "passivity": "1",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class PortTask:
    """The port of a case: its scenario, the bench it is put on, and the columns asked for."""

    case: Case
    scenario: Scenario
    bench: PortBench
    columns: tuple[MetricColumn, ...]


@dataclass(frozen=True, slots=True)
class PortOutcome:
    """Numbers (value, unit) and uncertainties by column; `reason`: why some are missing."""

    numbers: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    errors: Mapping[str, float] = field(default_factory=dict)
    reason: str = ""


def run_port(task: PortTask) -> PortOutcome:
    """Measure the port of a case. What cannot be measured is NaN, with the reason."""
    numbers: dict[str, tuple[float, str]] = {}
    errors: dict[str, float] = {}
    reasons: list[str] = []
    try:
        port = _Port(task.scenario, task.bench)
    except CosimError as error:
        return PortOutcome(_missing(task.columns), {}, str(error))
    for column in task.columns:
        assert isinstance(column.metric, PortMeasure)
        kind = column.metric.kind
        try:
            value, errors[column.name] = port.measured(column.metric)
        except CosimError as error:
            value = nan
            reasons.append(str(error))
        numbers[column.name] = (value, UNITS[kind])
    return PortOutcome(numbers, errors, "; ".join(dict.fromkeys(reasons)))


def _missing(columns: tuple[MetricColumn, ...]) -> dict[str, tuple[float, str]]:
    return {
        c.name: (nan, UNITS[c.metric.kind]) for c in columns if isinstance(c.metric, PortMeasure)
    }


class _Port:
    """The bench of a case, and G(jω) of each environment that was asked for."""

    def __init__(self, scenario: Scenario, spec: PortBench) -> None:
        plan = assemble(scenario)
        known = system(scenario, plan)
        signals = port_of(scenario.analysis, plan.slots(), known, spec.operator)
        for name in (spec.operator, spec.environment):
            if name not in known.arms:
                raise ScenarioError(
                    f"the arm {name} cannot be analyzed: its model declares no facts"
                )
        self._spec, self._bench = spec, Bench(known, signals, spec.q)
        self._gains: dict[Environment, PortGain] = {}

    def measured(self, measure: PortMeasure) -> Estimate:
        """The number with its uncertainty. Raises RunError where the port does not settle."""
        match measure.kind:
            case "transparency":
                gain = self._gain("spring")
                k, b = self._spec.spring
                return transparency_error(gain, spring_impedance(gain.omega, k, b))
            case "z_width":
                return z_width(self._gain("free"), self._gain("rigid"))
            case "free_impedance":
                return free_impedance(self._gain("free"))
            case "passivity":
                return passivity_margin(self._gain(measure.environment))

    def _gain(self, environment: Environment) -> PortGain:
        if environment not in self._gains:
            self._gains[environment] = self._swept(environment)
        return self._gains[environment]

    def _swept(self, environment: Environment) -> PortGain:
        bench, spec = self._bench, self._spec
        if environment != "free":
            stiffness, damping = spec.spring if environment == "spring" else spec.rigid
            names = bench.system.arms[spec.environment].grip.names
            held = dict(zip(names, ((stiffness,), (damping,), spec.q), strict=True))
            bench = replace(bench, held={spec.environment: held})
        sines = MultiSine.spread(*spec.band, bench.h, FREQUENCIES, FORCE)
        gain = bench.gain(sines, PERIODS)
        if (
            gain.off_frequency_share > UNSTABLE
            or float(log_weights(gain.omega) @ gain.error) > UNKNOWN
        ):
            raise RunError(
                f"the port cannot be evaluated with the environment {environment}: the arms do not"
                " come to rest, or the links disturb their motion too much"
            )
        return gain


# ---- the file -----------------------------------------------------------------------------------


def port_bench(table: Section, arms: Mapping[str, str]) -> PortBench | None:
    """The table ``[port]``, None if it is missing; `arms` by role. Raises ScenarioError."""
    if not table.data:
        return None
    table.only("operator", "environment", "q", "band", "spring", "rigid")
    found = []
    for key in ("operator", "environment"):
        role = table.text(key)
        if role not in arms:
            raise ScenarioError(
                f"no role {role!r}; expected one of {', '.join(arms)}", table.place(key)
            )
        found.append(arms[role])
    band = table.numbers("band")
    if len(band) != 2 or not 0 < band[0] < band[1]:
        raise ScenarioError(
            f"found {list(band)}; expected two frequencies in rad/s, the lower first",
            table.place("band"),
        )
    spring, rigid = (_spring(table.table(key)) for key in ("spring", "rigid"))
    return PortBench(found[0], found[1], table.numbers("q"), (band[0], band[1]), spring, rigid)


def _spring(table: Section) -> tuple[float, float]:
    table.only("stiffness", "damping")
    return table.quantity("stiffness", "N.m/rad"), table.quantity("damping", "N.m.s/rad")


def port_measure(kind: str, table: Section) -> PortMeasure | None:
    """The measure of a column, None where `kind` is a metric's. Raises ScenarioError."""
    known: dict[str, PortKind] = {x: x for x in get_args(PortKind)}
    if kind not in known:
        return None
    table.only("kind", "label", "environment")
    environments: dict[str, Environment] = {x: x for x in get_args(Environment)}
    name = table.text("environment", "free")
    if name not in environments or ("environment" in table and kind != "passivity"):
        expected = "free, spring or rigid, of kind 'passivity'"
        raise ScenarioError(f"found {name!r}; expected {expected}", table.place("environment"))
    return PortMeasure(known[kind], environments[name])
