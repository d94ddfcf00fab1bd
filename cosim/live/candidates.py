"""Keys of a scenario that a page may be able to move: values of components, laws of links.

Each has the range and the step of a slider, in SI. Whether it can be moved is for
:mod:`cosim.live.keys` to find out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from math import ceil, floor, inf, log10
from typing import Any

from cosim.base.convert import number
from cosim.base.errors import CosimError
from cosim.fmi import components
from cosim.fmi.file.ports import REAL
from cosim.fmi.file.values import limits
from cosim.schedule.plan import Plan

#: The greatest angle of a slider, rad.
TURN = 3.2
#: Steps of a slider, about; choices of a time between two draws.
STEPS, CHOICES = 200, 40
#: Entries of a parameter that a preset gives, at most, for it to have sliders.
MOST_ENTRIES = 4
#: Keys of a law that C draws: label, and what it is in words.
_DELAYS = {
    "delay": ("delay", "The delay of every sample."),
    "low": ("least delay", "The lower bound of the delays."),
    "high": ("greatest delay", "The upper bound of the delays."),
    "hold": ("delay changes every", "The time between two draws of the delay."),
}
_NO_LOSS = 'packets cannot be lost with semantics = "signal"; expected "newest-stamp" or such'


@dataclass(frozen=True)
class Slider:
    """A key of a scenario, as ``--set`` has it, with its `value` in `unit`.

    `lows`, `highs`: ends of its slider, the widest first. `choices`: the only values that it can
    have, ascending; (): all between the ends. `pair`: equal for the bounds of one law.
    """

    key: str
    label: str
    about: str
    unit: str
    group: str
    value: float
    lows: tuple[float, ...]
    highs: tuple[float, ...]
    choices: tuple[float, ...] = ()
    pair: str = ""

    @property
    def last(self) -> str:
        """The last name of the key."""
        return self.key.rpartition(".")[2]


@dataclass(frozen=True)
class Fixed:
    """A key that a page cannot move, and why."""

    key: str
    reason: str


def candidates(document: Mapping[str, Any], plan: Plan) -> tuple[list[Slider], list[Fixed]]:
    """The keys of a scenario that may be movable, and those that are not.

    `document`: the scenario as a file has it; `plan`: made from it.
    """
    found: list[Slider] = []
    fixed: list[Fixed] = []
    for one in (*_of_components(document, plan), *_of_links(document, plan)):
        if isinstance(one, Fixed):
            fixed.append(one)
        else:
            found.append(one)
    return found, fixed


def written_out(
    document: Mapping[str, Any], plan: Plan, *, losses: bool
) -> tuple[dict[str, Any], dict[str, list[str]]]:
    """A scenario with values in it that it leaves out: of its presets, and `losses` of links: none.

    `plan`: made from `document`. Also how each of these tables and lists is set as a whole, by its
    path: text, in which the keys of its numbers stand for them.
    """
    found, added = deepcopy(dict(document)), dict[str, list[str]]()
    values = {step.name: step.values for step in plan.components}
    for name, table in found.get("components", {}).items():
        for variable, numbers in values.get(name, {}).items() if "preset" in table else ():
            given = {**table.get("parameters", {}), **table.get("start", {})}
            if variable not in given and len(numbers) <= MOST_ENTRIES:
                path = f"components.{name}.parameters.{variable}"
                table.setdefault("parameters", {})[variable] = list(numbers)
                entries = [x for i in range(len(numbers)) for x in (", ", f"{path}.{i}")]
                added[path] = ["[", *entries[1:], "]"]
    for i, link in enumerate(found.get("links", ()) if losses else ()):
        law = (link.get("delay") or {}).get("law")
        packets = link.get("semantics", "signal") != "signal" and not link.get("bus")
        if law in ("constant", "uniform") and "loss" not in link and packets:
            link["loss"] = {"law": "independent", "p": 0.0}
            path = f"links.{i}.loss"
            added[path] = ['{law="independent", p=', f"{path}.p", "}"]
    return found, added


def slider_step(low: float, high: float) -> float:
    """A round step of a slider from `low` to `high`, in their unit; it has about 200 of them."""
    return _round_down((high - low) / STEPS)


def _of_components(document: Mapping[str, Any], plan: Plan) -> Iterator[Slider | Fixed]:
    steps = {step.name: step for step in plan.components}
    for name, table in document.get("components", {}).items():
        for part in ("parameters", "start"):
            for variable, value in table.get(part, {}).items():
                key = f"components.{name}.{part}.{variable}"
                if name not in steps:
                    yield Fixed(key, "it is of several components")
                    continue
                yield from _leaves(
                    steps[name].component, key, variable, value, start=part == "start"
                )


def _leaves(
    component: Any, key: str, variable: str, value: Any, *, start: bool
) -> Iterator[Slider | Fixed]:
    """The numbers of a value: itself, or the entries of a list."""
    if isinstance(value, list):
        for i, entry in enumerate(value):
            yield from _leaves(component, f"{key}.{i}", variable, entry, start=start)
        return
    fmu = components.stepped_fmu(component)
    group = None if fmu is None else fmu.groups.get(variable)
    ports = {p.name: p for p in (*component.parameters, *component.inputs)}
    if group is None or group.first.type not in REAL or variable not in ports:
        yield Fixed(key, "it is no real number")
        return
    port = ports[variable]
    try:
        number_ = number(value, port.unit, key)
    except CosimError as error:
        yield Fixed(key, str(error))
        return
    least, most, _ = limits(group)
    lows, highs = _range(number_, port.unit, signed=start)
    if port.unit == "kg.m2":  # zero is no inertia, and double of all entries is a heavier arm
        lows, highs = lows[1:], (2 * number_, number_)
    indices = "".join(f"[{i}]" for i in key.split(f".{variable}", 1)[1].split(".")[1:])
    yield Slider(
        key, variable + indices, port.description, port.unit, key.split(".")[1], number_,
        tuple(max(x, least) for x in lows), tuple(min(x, most) for x in highs),
    )  # fmt: skip


def _range(value: float, unit: str, *, signed: bool) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Ends of a slider; `signed`: start values, which may have either sign."""
    most = _round_up(2 * abs(value)) if value else 1.0
    if unit == "rad":
        most = TURN if abs(value) <= TURN else _round_up(1.2 * abs(value))
    low = -most if signed or value < 0 else 0.0
    high = most if signed or value >= 0 else 0.0
    return (low, min(0.5 * value, 2 * value), value), (high, max(0.5 * value, 2 * value), value)


def _of_links(document: Mapping[str, Any], plan: Plan) -> Iterator[Slider | Fixed]:
    for i, link in enumerate(document.get("links", ())):
        delay, loss = link.get("delay") or {}, link.get("loss") or {}
        name = link.get("name") or f"{link.get('from')} → {link.get('to')}"
        law, losses = delay.get("law"), loss.get("law", "independent")
        if link.get("bus"):
            yield Fixed(f"links.{i}.bus", "the delays on its bus are computed beforehand")
            continue
        if law not in ("constant", "uniform"):
            yield Fixed(f"links.{i}.delay", f"delays of the law {law} are drawn beforehand")
            continue
        if losses != "independent":
            reason = f"losses of the law {losses} are drawn beforehand, with the delays"
            yield Fixed(f"links.{i}.delay", reason)
            continue
        for key in (key for key in _DELAYS if key in delay):
            yield _delay(f"links.{i}.delay.{key}", key, delay, name, plan)
        if link.get("semantics", "signal") == "signal":
            yield Fixed(f"links.{i}.loss.p", _NO_LOSS)
        elif "p" in loss:
            p = number(loss["p"], "1", "p")
            most = min(0.9, _round_up(max(4 * p, 0.1)))
            label, about = "packets lost", "The share of packets that are lost."
            place = f"links.{i}.loss.p"
            yield Slider(place, label, about, "1", name, p, (0.0, 0.01, p), (most, p))


def _delay(place: str, key: str, delay: Mapping[str, Any], name: str, plan: Plan) -> Slider:
    seconds = {k: number(v, "s", k) for k, v in delay.items() if k in _DELAYS}
    value, (label, about) = seconds[key], _DELAYS[key]
    if key == "hold":
        period = _period(name, plan)
        n = min(CHOICES, max(4, ceil(2 * value / period)))
        choices = {float(repr(round(k * period, 12))) for k in range(1, n + 1)} | {value}
        found = tuple(sorted(choices))
        return Slider(place, label, about, "s", name, value, found[:1], found[-1:], found)
    most = max(v for k, v in seconds.items() if k != "hold")
    most = _round_up(2 * most) if most else 10 * _period(name, plan)
    lows = (0.0, _period(name, plan), 0.5 * value, value)
    pair = f"{place.rpartition('.')[0]}" if key in ("low", "high") else ""
    return Slider(
        place, label, about, "s", name, value, lows, (most, 1.25 * value, value), (), pair
    )


def _period(name: str, plan: Plan) -> float:
    """The period of the sender of a link, s."""
    found = (x for x in plan.links if name in (x.name, x.name.replace("->", " → ")))
    link = next(found, None)
    return plan.h * (1 if link is None else plan.component(link.source.component).period)


def _round_up(x: float) -> float:
    """The least of 1, 2, 2.5, 5 times a power of ten that is not below `x`."""
    power = 10.0 ** floor(log10(x))
    found: float = next(
        (f * power for f in (1, 2, 2.5, 5) if f * power >= x * (1 - 1e-9)), 10 * power
    )
    return float(f"{found:.12g}")


def _round_down(x: float) -> float:
    """The greatest of 1, 2, 5 times a power of ten that is not above `x`."""
    if not 0 < x < inf:
        return 0.0
    power = 10.0 ** floor(log10(x))
    return float(f"{next(f * power for f in (5, 2, 1) if f * power <= x * (1 + 1e-9)):.12g}")
