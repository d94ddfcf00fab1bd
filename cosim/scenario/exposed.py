"""Variables of FMUs that a scenario reads or changes although they are no outputs or inputs."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from fnmatch import translate

from cosim.base.component import Component
from cosim.fmi.components import expose, independent, observable
from cosim.scenario.spec import InputSpec, Scenario

#: Every readable number but the time of an FMU, in ``record.signals``.
ALL = "all"
_INDEX = re.compile(r"\[\d+(?:,\d+)*\]$")


class ExposedVariables:
    """What a scenario reads of its components, and changes of them, by component."""

    def __init__(self, scenario: Scenario) -> None:
        self._patterns: list[str] = []
        self._read: defaultdict[str, set[str]] = defaultdict(set)
        self._changed: defaultdict[str, set[str]] = defaultdict(set)
        self._wired: defaultdict[str, set[str]] = defaultdict(set)
        for signal in _read(scenario):
            if is_pattern(signal):
                self._patterns.append(signal)
            else:
                name, _, variable = signal.partition(".")
                self._read[name] |= {variable, _INDEX.sub("", variable)}
        for signal in _changed(scenario):
            name, _, port = signal.partition(".")
            self._changed[name] |= {port, _INDEX.sub("", port)}
        for signal in _wired(scenario):
            name, _, port = signal.partition(".")
            self._wired[name].add(port)

    def expose(self, name: str, component: Component) -> None:
        """Make outputs of an FMU of what is read of it, and inputs of what is changed."""
        observed = set(self._read[name])
        if self._patterns:
            names = set(observable(component)) - independent(component)
            known = {f"{name}.{variable}": variable for variable in names}
            observed |= {known[s] for p in self._patterns for s in matching(p, known)}
        expose(component, observed, self._changed[name], self._wired[name])


def is_pattern(signal: str) -> bool:
    """Whether an entry of ``record.signals`` stands for several signals."""
    return signal == ALL or "*" in signal or "?" in signal


def matching(pattern: str, names: Iterable[str]) -> list[str]:
    """The names that a pattern stands for: ``*`` any characters, ``?`` one; "all" all."""
    if pattern == ALL:
        return list(names)
    match = re.compile(translate(pattern.replace("[", "[[]"))).match  # an index, not a set
    return [name for name in names if match(name)]


def _read(scenario: Scenario) -> Iterator[str]:
    """Everything that a scenario reads, as ``component.port``, or a pattern of it."""
    yield from scenario.run.record.signals
    for component in scenario.components.values():
        for given in component.inputs.values():
            yield given.source if isinstance(given, InputSpec) else given
    for link in scenario.links:
        yield link.source
    for metric in scenario.metrics.values():
        yield from (*metric.of, *metric.contact)
    for figure in scenario.figures.values():
        for panel in figure.panels:
            yield from panel.y


def _wired(scenario: Scenario) -> Iterator[str]:
    """Both ends of all wires and links, which may be texts."""
    for name, component in scenario.components.items():
        for port, given in component.inputs.items():
            yield f"{name}.{port}"
            yield given.source if isinstance(given, InputSpec) else given
    for link in scenario.links:
        yield from (link.source, link.target)


def _changed(scenario: Scenario) -> Iterator[str]:
    for event in scenario.events:
        yield from event.set
    for link in scenario.links:
        yield link.target
    for name, component in scenario.components.items():
        yield from (f"{name}.{port}" for port in component.inputs)
