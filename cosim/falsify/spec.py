"""The table ``[falsify]`` of a scenario: what the network and other values may do. No run reads it.

::

    [falsify]
    require = ["sync"]                       # default: all requirements of the scenario

    [falsify.links."*"]                      # or the name, or the channel, of a link
    delay = ["300 ms", "1.2 s"]              # default: the bounds of the link's own law
    nominal = "750 ms"                       # default: its mean
    rate = 0.5                               # s/s, how fast the delay may change; default: at once
    reorder = false                          # packets do not overtake each other; default: true
    lost = 3                                 # packets in a row that may be lost
    outage = "200 ms"                        # longest time in which everything is lost
    share = "5 %"                            # of all packets that may be lost
    like = ["wifi5", "ping/there.csv"]       # it may do what these presets and recordings do

    [falsify.vary.grip]                      # as an axis of a study: operators, plants, starts
    path = "components.master.parameters.k_p"
    uniform = [5, 40]
"""

from __future__ import annotations

from typing import Annotated

import msgspec

from cosim.base.convert import Number, convert, convert_each, number
from cosim.base.errors import ScenarioError
from cosim.scenario.spec import Scenario
from cosim.study.axes import Axis
from cosim.study.spec import AxisSpec
from cosim.study.study import axis

Positive = Annotated[float, msgspec.Meta(gt=0)]
Natural = Annotated[int, msgspec.Meta(ge=0)]


class LinkBoundsSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The bounds of a link; what is left out follows from the link's own law."""

    delay: tuple[Number, Number] | None = None
    nominal: Number | None = None
    rate: Positive | None = None
    reorder: bool = True
    lost: Natural | None = None
    outage: Number | None = None
    share: Number | None = None
    like: tuple[str, ...] = ()


class FalsifySpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The whole table, as read. `families`: those that are searched, in this order."""

    require: tuple[str, ...] = ()
    families: tuple[str, ...] = ()
    links: dict[str, LinkBoundsSpec] = {}
    vary: dict[str, AxisSpec] = {}


def read(scenario: Scenario) -> FalsifySpec:
    """The table of a scenario, empty if it has none. Raises ScenarioError."""
    table, path = dict(scenario.falsify), scenario.path
    for key, kind in (("links", LinkBoundsSpec), ("vary", AxisSpec)):
        if isinstance(some := table.get(key), dict):
            convert_each(some, kind, path, f"falsify.{key}")
    return convert(table, FalsifySpec, path, "falsify")


def axes(scenario: Scenario, spec: FalsifySpec) -> tuple[Axis, ...]:
    """The values that vary besides the network. Raises ScenarioError."""
    return tuple(
        axis(name, one, scenario.place("falsify", "vary", name)) for name, one in spec.vary.items()
    )


def seconds(value: Number, place: str) -> float:
    """A time of 0 or more, s. Raises ScenarioError."""
    found = number(value, "s", place)
    if found < 0:
        raise ScenarioError(f"found {found:g} s; expected a time of 0 or more", place)
    return found
