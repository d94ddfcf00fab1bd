"""Variables of FMUs that a scenario reads or changes although they are no outputs or inputs."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from fnmatch import translate
from functools import lru_cache

from cosim.base.component import Component
from cosim.fmi.components import expose, independent, observable
from cosim.scenario.spec import InputSpec, Scenario

#: Every readable number but the time of an FMU, in ``record.signals``.
ALL = "all"
_INDEX = re.compile(r"\[\d+(?:,\d+)*\]$")


class ExposedVariables:
    """The variables that a scenario reads and changes, by component."""

    def __init__(self, scenario: Scenario) -> None:
        self._patterns: list[str] = []
        self._read: defaultdict[str, set[str]] = defaultdict(set)
        self._changed: defaultdict[str, set[str]] = defaultdict(set)
        self._wired: defaultdict[str, set[str]] = defaultdict(set)
        for signal in _shown(scenario):
            self._add_read(signal)
        for event in scenario.events:
            for signal in event.set:
                self._add_changed(*_split(signal))
        sources: dict[str, None] = {}  # a set in order: many links have the same
        for name, component in scenario.components.items():
            for port, given in component.inputs.items():
                sources[given.source if isinstance(given, InputSpec) else given] = None
                self._add_fed(name, port)
        for link in scenario.links:
            sources[link.source] = None
            self._add_fed(*_split(link.target))
        for source in sources:
            self._add_read(source)
            name, port = _split(source)
            self._wired[name].add(port)

    def _add_read(self, signal: str) -> None:
        if is_pattern(signal):
            self._patterns.append(signal)
        else:
            name, variable = _split(signal)
            self._read[name].update(_with_array(variable))

    def _add_changed(self, name: str, port: str) -> None:
        self._changed[name].update(_with_array(port))

    def _add_fed(self, name: str, port: str) -> None:
        """The end of a wire or a link; both ends may be texts."""
        self._add_changed(name, port)
        self._wired[name].add(port)

    def expose(self, name: str, component: Component) -> None:
        """Make outputs of an FMU of what is read of it, and inputs of what is changed."""
        observed = set(self._read[name])
        if self._patterns:
            names = set(observable(component)) - independent(component)
            known = {f"{name}.{variable}": variable for variable in names}
            observed |= {known[s] for p in self._patterns for s in matching(p, known)}
        expose(component, observed, self._changed[name], self._wired[name])


@lru_cache(maxsize=1024)
def _with_array(variable: str) -> tuple[str, str]:
    """A variable, or an entry of one, and the variable."""
    return variable, _INDEX.sub("", variable)


def is_pattern(signal: str) -> bool:
    """True if an entry of ``record.signals`` stands for several signals."""
    return signal == ALL or "*" in signal or "?" in signal


def matching(pattern: str, names: Iterable[str]) -> list[str]:
    """The names that a pattern stands for: ``*`` any characters, ``?`` one; "all" all."""
    if pattern == ALL:
        return list(names)
    match = re.compile(translate(pattern.replace("[", "[[]"))).match  # an index, not a set
    return [name for name in names if match(name)]


def _split(signal: str) -> tuple[str, str]:
    """The component and the port of ``component.port``."""
    name, _, port = signal.partition(".")
    return name, port


def _shown(scenario: Scenario) -> Iterator[str]:
    """Signals that are recorded, measured or drawn, as ``component.port`` or a pattern of it."""
    yield from scenario.run.record.signals
    for metric in scenario.metrics.values():
        yield from (*metric.of, *metric.contact)
    for requirement in scenario.require.values():
        if requirement.form != "metric":
            yield from requirement.names
    for figure in scenario.figures.values():
        for panel in figure.panels:
            yield from panel.y
