"""A plan's view of an FMU: its variables as ports, and how it can be stepped."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any, TypeVar

from cosim.base.component import Parameter, Port
from cosim.base.errors import UnitError
from cosim.base.units import Unit, parse
from cosim.fmi import clocks
from cosim.fmi.file.description import Description
from cosim.fmi.file.ports import VariableGroup
from cosim.fmi.file.values import (
    has_text,
    in_updates,
    item_numbers,
    parameter,
    port,
    settable,
    tunable,
)
from cosim.fmi.file.variables import NUMERIC, TEXTS

T = TypeVar("T")


class FmuInterface:
    """The variables of an FMU as inputs, outputs and parameters, some of them exposed on demand.

    It follows from the description alone: nothing here needs an instance.
    """

    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    parameters: tuple[Parameter, ...]

    def __init__(self, description: Description) -> None:
        self.description = description
        self.groups = description.groups
        self._observed: frozenset[str] = frozenset()
        self._driven: frozenset[str] = frozenset()
        self._wired: frozenset[str] = frozenset()
        self.expose()

    def expose(
        self,
        observed: Collection[str] = (),
        driven: Collection[str] = (),
        wired: Collection[str] = (),
    ) -> None:
        """Make readable variables outputs, tunable parameters inputs, and texts signals.

        They are got and set like the others, in the same calls. Before the start. `observed` may
        contain any name: what is no readable number is left out, as is what is no tunable parameter
        in `driven`, or no String or Binary input or output in `wired`.
        """
        known: dict[Any, Any] = self.description.derived
        key = "exposed", frozenset(observed), frozenset(driven), frozenset(wired)
        if key not in known:
            known[key] = self._exposed(observed, driven, wired)
        self._observed, self._driven, self._wired = known[key]
        self.inputs, self.outputs, self.parameters = self._derived("ports", self._ports)

    def _exposed(
        self, observed: Collection[str], driven: Collection[str], wired: Collection[str]
    ) -> tuple[frozenset[str], frozenset[str], frozenset[str]]:
        """The given names that can be exposed."""
        groups = self.groups
        return (
            frozenset(n for n in observed if n in groups and self._readable(n)),
            frozenset(n for n in driven if n in groups and tunable(groups[n].first)),
            frozenset(
                n
                for n in wired
                if n in groups
                and groups[n].first.type in TEXTS
                and groups[n].first.causality in ("input", "output")
            ),
        )

    def _ports(self) -> tuple[tuple[Port, ...], tuple[Port, ...], tuple[Parameter, ...]]:
        optional = self.description.optional
        return (
            tuple(port(g, fed=True, optional=g.name in optional) for g in self.carried("input")),
            tuple(port(g) for g in self.carried("output")),
            tuple(
                parameter(g)
                for g in self.groups.values()
                if settable(g) and g.name not in self._driven
            ),
        )

    def _derived(self, what: str, compute: Callable[[], T]) -> T:
        """A value that follows from the description and the exposed variables: computed once."""
        key = what, self._observed, self._driven, self._wired
        if key not in self.description.derived:
            self.description.derived[key] = compute()
        found: T = self.description.derived[key]
        return found

    def _readable(self, name: str) -> bool:
        first = self.groups[name].first
        clocked = self.clocked and bool(first.clocks)
        return first.type in NUMERIC and first.causality not in ("input", "output") and not clocked

    @property
    def observable(self) -> tuple[str, ...]:
        """Names of the variables that :meth:`expose` can make outputs."""
        return tuple(filter(self._readable, self.groups))

    def _role(self, group: VariableGroup) -> str:
        if group.name in self._driven:
            return "input"
        return "output" if group.name in self._observed else group.first.causality

    def carried(self, role: str) -> list[VariableGroup]:
        """Inputs or outputs that are signals, with those that are exposed."""
        return self._derived(f"carried {role}", lambda: [
            g for g in self.groups.values()
            if self._role(g) == role
            and (g.first.type in NUMERIC or g.name in self._wired
                 or (self.clocked and clocks.is_signal(g.first)))
        ])  # fmt: skip

    def references(self, causality: str) -> tuple[int, ...]:
        """Value references of all carried inputs or outputs, in port order."""
        return tuple(r for g in self.carried(causality) for r in g.references)

    def unit(self, name: str) -> Unit | str:
        """A unit by the FMU's own definition, or its name if that is equivalent or undefined."""
        defined = self.description.units.get(name)
        try:
            return name if defined is None or parse(name) == defined else defined
        except UnitError:
            return name if defined is None else defined

    def number(self, name: str, value: Any) -> Any:
        """A value of a scenario, items of enumerations as numbers. FmuError: no such item."""
        group = self.groups.get(name)
        return item_numbers(group, value) if group and group.first.type == "Enumeration" else value

    def is_text(self, name: str) -> bool:
        """True if `name` is a String or Binary variable: no signal."""
        return has_text(self.groups, name)

    @property
    def events(self) -> bool:
        """True if it is run with event mode: an FMU of FMI 3.0 that has one."""
        return self.description.fmi == "3.0" and bool(self.description.flags.get("hasEventMode"))

    @property
    def clocked(self) -> bool:
        """True if the engine ticks its clocks: with event mode, or in scheduled execution."""
        return self.events or self.description.scheduled

    @property
    def discrete(self) -> frozenset[str]:
        """Inputs that change in jumps only."""
        return self._derived("discrete", self._discrete)

    def _discrete(self) -> frozenset[str]:
        inputs = self.carried("input")
        jumps = (g.name for g in inputs if any(v.variability != "continuous" for v in g.variables))
        return frozenset(jumps)

    @property
    def sloped(self) -> frozenset[str]:
        """Inputs that can be lines over a step: by their slopes (FMI 2.0.5 §4.2.1), or by
        intermediate updates (FMI 3.0.2 §4.2.2). None of :attr:`discrete`.
        """
        return self._derived("sloped", self._sloped)

    def _sloped(self) -> frozenset[str]:
        d, discrete = self.description, self.discrete
        smooth = [g for g in self.carried("input") if g.name not in discrete]
        if d.fmi == "2.0":
            return frozenset(g.name for g in smooth if d.flags.get("canInterpolateInputs"))
        can = [g for g in smooth if self.intermediate and g.first.type == "Float64"]
        return frozenset(g.name for g in can if all(map(in_updates, g.variables)))

    @property
    def intermediate(self) -> bool:
        """True if it calls back within a step: an FMU of FMI 3.0, for co-simulation."""
        d = self.description
        three = d.fmi == "3.0" and d.interface == "CoSimulation"
        return three and bool(d.flags.get("providesIntermediateUpdate"))

    @property
    def returns_early(self) -> bool:
        """True if a step may end before its time: an FMU of FMI 3.0 that can."""
        flags = ("canReturnEarlyAfterIntermediateUpdate", "canHandleVariableCommunicationStepSize")
        return self.description.fmi == "3.0" and all(map(self.description.flags.get, flags))

    @property
    def updated(self) -> tuple[int, ...]:
        """Value references of inputs that may be set within a step."""
        sloped = self.sloped
        groups = (g for g in self.carried("input") if g.name in sloped)
        return tuple(r for g in groups for r in g.references)
