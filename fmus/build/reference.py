"""Functions derived from a model's declaration: its FMU, C kernel and NumPy reference.

A law is a function of the values `x` of the model by name (parameters, and its state: outputs and
locals as of the last step), the time t and the step h in s, and the inputs in their order, each of
its shape::

    def law(x, t, h, q, dq):
        return {"xi": dq + x["alpha"] * q}

It returns every output, and the locals that it changes: these are `x` in the next step.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Hashable
from typing import TYPE_CHECKING, NamedTuple, TypeAlias, final

from fmus.model.numeric import (
    Array,
    checked_outputs,
    copy_state,
    initial_input,
    received,
    start_values,
)

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.base.component import Kind, Outputs, Parameter, Port
    from cosim.base.component import Values as Given
    from fmus.build.archive import Version
    from fmus.build.kernel import Kernel
    from fmus.model import Model

#: Values of a model by name, each of its shape.
Values: TypeAlias = dict[str, Array]
Law: TypeAlias = Callable[..., Values]


@final
class Reference:
    """The law of a model in NumPy as a component: the readable reference of the C kernel.

    `start`, of `x` and the inputs at the start, returns the state that follows from them; it raises
    ScenarioError for parameters that cannot be. Where it returns the outputs too, they are those at
    the start; otherwise they are those of `law` at t = 0 with h = 0.
    """

    def __init__(self, model: Model, law: Law, start: Law | None = None) -> None:
        self.kind: Kind = model.kind
        self.inputs: tuple[Port, ...] = model.inputs()
        self.outputs: tuple[Port, ...] = model.outputs()
        self.parameters: tuple[Parameter, ...] = model.parameters()
        self._model, self._law, self._start = model, law, start
        self.initialize({})

    def initialize(self, values: Given) -> None:
        """Go to the start. Raises ScenarioError."""
        x = start_values(self._model, values)
        if self._start is not None:
            x |= self._start(x, *map(initial_input, self.inputs))
        self._x = x

    def initial(self, u: Given) -> Outputs:
        """Outputs at the start. Raises RunError where an input is not finite."""
        inputs = received(self.inputs, u)
        found = {} if self._start is None else self._start(self._x, *inputs)
        self._x |= found
        if any(port.name not in found for port in self.outputs):
            found = self._law(self._x, 0.0, 0.0, *inputs)
        return self._given(found)

    def step(self, t: float, h: float, u: Given) -> Outputs:
        """Outputs of the step from `t` to t + h (s), as :mod:`cosim.base.component` says for the
        kind.

        Raises RunError where an input is not finite or the law diverges; nothing changes then.
        """
        found = self._law(self._x, t, h, *received(self.inputs, u, t))
        outputs = self._given(found, t)
        self._x |= found
        return outputs

    def _given(self, found: Values, t: float = 0.0) -> Outputs:
        return checked_outputs({port.name: found[port.name] for port in self.outputs}, t)

    def get_state(self) -> object:
        """All values by name, copied."""
        return copy_state(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copy_state(state)


class Derived(NamedTuple):
    """The functions and the class that a scenario can name of a model. Each takes the sizes of the
    model.
    """

    fmu: Callable[..., Path]
    kernel: Callable[..., Kernel]
    reference: Callable[..., Reference]


#: FMUs of models by what was asked for: many components are of one model.
_found: dict[Hashable, Path] = {}


def _find(
    model: Callable[..., Model], sizes: tuple[int, ...], named: dict[str, int], version: Version
) -> Path:
    """The FMU of the installation, or else of the cache. Raises FmuError."""
    from fmus.build.shipped import shipped

    declared = model(*sizes, **named)
    if found := shipped(declared, version):
        return found
    from fmus.build.archive import find
    from fmus.build.toolchain import ToolchainError

    try:
        return find(declared, version)
    except ToolchainError:
        if named.keys() != {"joints"} or not (found := shipped(_for_any(model), "3.0")):
            raise
        return found


def _for_any(model: Callable[..., Model]) -> Model:
    from fmus.model import any_size

    return any_size(model)


def derive(model: Callable[..., Model], law: Law, start: Law | None = None) -> Derived:
    """FMU, kernel and NumPy reference of a model by its declaration, a function of its sizes.

    `law` and `start` as of :class:`Reference`.
    """

    def fmu(version: Version = "2.0", *sizes: int, **named: int) -> Path:
        """Path of the FMU, built at installation or now into the cache; `version` of FMI.

        Without a compiler it is one whose structural parameters are these sizes (FMI 3.0), if the
        installation has it. Raises FmuError where it cannot be built.
        """
        from fmus.build import shipped

        place = shipped.FOLDER, os.environ.get("XDG_CACHE_HOME")
        key = model, version, sizes, tuple(named.items()), place
        found = _found.get(key)
        if found is None or not found.is_file():
            found = _found[key] = _find(model, sizes, named, version)
        return found

    def kernel(*sizes: int, **named: int) -> Kernel:
        """The C kernel of the FMU as a component, without FMI in between: the same numbers."""
        from fmus.build.kernel import Kernel

        return Kernel(model(*sizes, **named))

    def reference(*sizes: int, **named: int) -> Reference:
        """The law in NumPy as a component: the readable reference of the C kernel."""
        return Reference(model(*sizes, **named), law, start)

    return Derived(fmu, kernel, reference)
