"""Variables of FMUs that a scenario reads or changes although they are no outputs or inputs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from fnmatch import translate

from cosim.base.component import Component
from cosim.fmi.components import expose, observable
from cosim.scenario.spec import InputSpec, Scenario

#: Every readable number, in ``record.signals``.
ALL = "all"
_INDEX = re.compile(r"\[\d+(?:,\d+)*\]$")


def expose_wanted(scenario: Scenario, name: str, component: Component) -> None:
    """Make outputs of an FMU of what the scenario reads of it, and inputs of what it changes."""
    known = {f"{name}.{variable}": variable for variable in observable(component)}
    observed = {known[signal] for signal in _wanted(_read(scenario), known)}
    spec = scenario.components[name]
    driven = {*spec.inputs, *_ports(name, _changed(scenario))}
    expose(component, observed, {_INDEX.sub("", port) for port in driven} | driven)


def is_pattern(signal: str) -> bool:
    """Whether an entry of ``record.signals`` stands for several signals."""
    return signal == ALL or "*" in signal or "?" in signal


def matching(pattern: str, names: Iterable[str]) -> list[str]:
    """The names that a pattern stands for: ``*`` any characters, ``?`` one; "all" all."""
    if pattern == ALL:
        return list(names)
    match = re.compile(translate(pattern.replace("[", "[[]"))).match  # an index, not a set
    return [name for name in names if match(name)]


def _wanted(signals: Iterable[str], known: Iterable[str]) -> Iterator[str]:
    names = set(known)
    for signal in signals:
        if is_pattern(signal):
            yield from matching(signal, names)
        else:
            yield from {signal, _INDEX.sub("", signal)} & names


def _ports(name: str, signals: Iterable[str]) -> Iterator[str]:
    return (s.removeprefix(f"{name}.") for s in signals if s.startswith(f"{name}."))


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


def _changed(scenario: Scenario) -> Iterator[str]:
    for event in scenario.events:
        yield from event.set
    for link in scenario.links:
        yield link.target
