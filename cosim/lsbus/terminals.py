"""The CAN terminals of an FMU (FMI-LS-BUS, low cut): which variables carry its bus operations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from cosim.base.errors import FmuError
from cosim.fmi.component import FmuComponent
from cosim.fmi.file.variables import FmuVariable

_KIND = "org.fmi-ls-bus.network-terminal"
_RULE = "org.fmi-ls-bus.transceiver"
_MIME = "application/org.fmi-standard.fmi-ls-bus.can"
_TIMED = ("constant", "fixed", "tunable", "changing", "countdown")
_MEMBERS = ("Tx_Data", "Tx_Clock", "Rx_Data", "Rx_Clock")
#: The standard's text has the first name, its example of a terminal the second.
_NOTIFICATIONS = ("BusNotifications", "BusNotification")


@dataclass(frozen=True, slots=True)
class CanTerminal:
    """A terminal by its name, groups before it with a dot; `notifications`: its parameter."""

    name: str
    tx_data: FmuVariable
    tx_clock: FmuVariable
    rx_data: FmuVariable
    rx_clock: FmuVariable
    notifications: FmuVariable | None = None


def read_terminals(fmu: FmuComponent) -> dict[str, CanTerminal]:
    """All CAN terminals of an FMU by name; none where it has no ``terminalsAndIcons.xml``.

    Raises FmuError for a file or a terminal that the standard does not allow.
    """
    path = fmu.archive.folder / "terminalsAndIcons" / "terminalsAndIcons.xml"
    if not path.is_file():
        return {}
    variables = {v.name: v for v in fmu.description.variables}
    found = {}
    for name, element in _network_terminals(_root(path, fmu.name), ""):
        terminal = _terminal(name, element, variables, f"{fmu.name}: terminal {name!r}")
        found[name] = terminal
    return found


def terminal_of(fmu: FmuComponent, name: str) -> CanTerminal:
    """One terminal, which is the only one of its FMU ("": whatever its name). Raises FmuError."""
    found = read_terminals(fmu)
    if not name and len(found) == 1:
        return next(iter(found.values()))
    if name not in found and (name or not found):
        has = ", ".join(found) or "none"
        raise FmuError(f"{fmu.name}: found no CAN terminal {name!r}, expected one of: {has}")
    if len(found) > 1:
        raise FmuError(
            f"{fmu.name}: found the CAN terminals {', '.join(found)}, expected one: what the others"
            " send would be lost"
        )
    return found[name]


def _root(path: Path, name: str) -> ElementTree.Element:
    try:
        return ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, ValueError, LookupError, OSError) as error:
        raise FmuError(f"{name}: terminalsAndIcons.xml is not well-formed: {error}") from error


def _network_terminals(
    parent: ElementTree.Element, prefix: str
) -> Iterator[tuple[str, ElementTree.Element]]:
    """Terminals of networks with their names, those in groups too."""
    for element in [*parent.iterfind("Terminals/Terminal"), *parent.iterfind("Terminal")]:
        name = prefix + element.get("name", "")
        if element.get("terminalKind") == _KIND:
            yield name, element
        else:
            yield from _network_terminals(element, f"{name}.")


def _terminal(
    name: str, element: ElementTree.Element, variables: Mapping[str, FmuVariable], place: str
) -> CanTerminal:
    rule = element.get("matchingRule")
    if rule != _RULE:
        raise FmuError(f"{place}: found matchingRule {rule!r}, expected {_RULE!r}")
    members = _members(element, variables, place)
    if set(members) != set(_MEMBERS):
        raise FmuError(
            f"{place}: found the members {', '.join(sorted(members)) or 'none'}, expected"
            f" {', '.join(_MEMBERS)}"
        )
    tx, rx = members["Tx_Data"], members["Rx_Data"]
    _check_data(tx, members["Tx_Clock"], "output", place)
    _check_data(rx, members["Rx_Clock"], "input", place)
    _check_clocks(members["Tx_Clock"], members["Rx_Clock"], place)
    settings = [
        v
        for nested in element.iterfind("Terminal")
        if nested.get("terminalKind") == f"{_KIND}.configuration"
        for key, v in _members(nested, variables, place).items()
        if key in _NOTIFICATIONS
    ]
    return CanTerminal(
        name, tx, members["Tx_Clock"], rx, members["Rx_Clock"], settings[0] if settings else None
    )


def _members(
    element: ElementTree.Element, variables: Mapping[str, FmuVariable], place: str
) -> dict[str, FmuVariable]:
    found = {}
    for member in element.iterfind("TerminalMemberVariable"):
        variable, key = member.get("variableName", ""), member.get("memberName", "")
        if variable not in variables:
            raise FmuError(
                f"{place}: member {key!r} is {variable!r}, expected a variable of the FMU"
            )
        found[key] = variables[variable]
    return found


def _check_data(data: FmuVariable, clock: FmuVariable, causality: str, place: str) -> None:
    if data.type != "Binary" or data.causality != causality or data.size != 1:
        raise FmuError(
            f"{place}: {data.name!r} is a {data.type} {data.causality} of {data.size} values,"
            f" expected one Binary {causality}"
        )
    if data.clocks != (clock.reference,):
        raise FmuError(f"{place}: {data.name!r} does not belong to the clock {clock.name!r} alone")
    mime = data.attributes.get("mimeType", "")
    if mime.split(";")[0].strip() != _MIME:
        raise FmuError(f"{place}: {data.name!r} has mimeType {mime!r}, expected {_MIME!r}")


def _check_clocks(tx: FmuVariable, rx: FmuVariable, place: str) -> None:
    kinds = [(v.type, v.causality, v.attributes.get("intervalVariability", "")) for v in (tx, rx)]
    if kinds[1] != ("Clock", "input", "triggered"):
        raise FmuError(f"{place}: {rx.name!r} is {kinds[1]}, expected a triggered input clock")
    timed = [("Clock", "input", kind) for kind in _TIMED]
    if kinds[0] not in (("Clock", "output", "triggered"), *timed):
        raise FmuError(
            f"{place}: {tx.name!r} is {kinds[0]}, expected a triggered output clock or an input"
            f" clock that is {', '.join(_TIMED)}"
        )
