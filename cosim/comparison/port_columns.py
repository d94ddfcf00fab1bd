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
from dataclasses import dataclass, field
from math import nan
from pathlib import Path

from cosim.analysis.experiments import FORCE, Bench
from cosim.analysis.force_tests import UNSTABLE
from cosim.base.copies import replace
from cosim.base.errors import CosimError, RunError, ScenarioError
from cosim.base.names import unknown
from cosim.comparison.documents import Case
from cosim.comparison.spec import Environment, PortBench, PortKind, PortMeasure
from cosim.comparison.variants import MetricColumn
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
                spring = self._spec.spring
                wanted = spring_impedance(gain.omega, spring.stiffness, spring.damping)
                return transparency_error(gain, wanted)
            case "z_width":
                return z_width(self._gain("free"), self._gain("rigid"))
            case "free_impedance":
                return free_impedance(self._gain("free"))
            case "passivity":
                return passivity_margin(self._gain(measure.environment or "free"))

    def _gain(self, environment: Environment) -> PortGain:
        if environment not in self._gains:
            self._gains[environment] = self._swept(environment)
        return self._gains[environment]

    def _swept(self, environment: Environment) -> PortGain:
        bench, spec = self._bench, self._spec
        if environment != "free":
            spring = spec.spring if environment == "spring" else spec.rigid
            names = bench.system.arms[spec.environment].grip.names
            held = dict(zip(names, ((spring.stiffness,), (spring.damping,), spec.q), strict=True))
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


def port_bench(spec: PortBench, arms: Mapping[str, str], path: Path) -> PortBench:
    """The bench with arms for its roles; `arms` by role. Raises ScenarioError."""
    place = f"{path} at port"
    for key, role in (("operator", spec.operator), ("environment", spec.environment)):
        if role not in arms:
            raise ScenarioError(unknown(role, arms, "role"), f"{place}.{key}")
    if not 0 < spec.band[0] < spec.band[1]:
        raise ScenarioError(
            f"found {list(spec.band)}; expected two frequencies in rad/s, the lower first",
            f"{place}.band",
        )
    return replace(spec, operator=arms[spec.operator], environment=arms[spec.environment])
