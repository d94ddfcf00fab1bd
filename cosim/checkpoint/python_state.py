"""The state of a Python component as bytes, which only data can come from.

It is pickled. Reading allows classes of the component's own module, arrays and generators of NumPy,
and containers: a file from another source cannot call a function.
"""

from __future__ import annotations

import io
import pickle
from typing import Any

from cosim.base.component import Component
from cosim.base.errors import ScenarioError

_ALLOWED = {
    "builtins": {"bytearray", "complex", "frozenset", "range", "set", "slice"},
    "collections": {"Counter", "OrderedDict", "defaultdict", "deque"},
    "fractions": {"Fraction"},
    "numpy": {"dtype", "ndarray"},
    "numpy._core.multiarray": {"_reconstruct", "scalar"},
    "numpy._core.numeric": {"_frombuffer"},
    "numpy.random._pickle": {
        "__bit_generator_ctor", "__generator_ctor", "__randomstate_ctor"
    },
    "numpy.random._pcg64": {"PCG64", "PCG64DXSM"},
    "numpy.random._philox": {"Philox"},
    "numpy.random._mt19937": {"MT19937"},
    "numpy.random._sfc64": {"SFC64"},
    "numpy.random.bit_generator": {"SeedSequence", "__pyx_unpickle_SeedSequence"},
    "random": {"Random"},
}  # fmt: skip


class _StateReader(pickle.Unpickler):
    def __init__(self, data: bytes, own: str) -> None:
        super().__init__(io.BytesIO(data))
        self._own = own

    def find_class(self, module: str, name: str) -> Any:
        """A class that a state may contain. Raises UnpicklingError for any other."""
        found = None
        if module == self._own or name in _ALLOWED.get(module, ()):
            found = super().find_class(module, name)
        if found is None or (module == self._own and not isinstance(found, type)):
            raise pickle.UnpicklingError(f"it contains {module}.{name}")
        return found


def saved(name: str, component: Component) -> bytes:
    """The state of the component `name`. Raises ScenarioError for one that cannot be saved."""
    try:
        data = pickle.dumps(component.get_state(), protocol=5)
        read(name, component, data)
    except ScenarioError:
        raise
    except Exception as error:
        raise ScenarioError(
            f"{name}: its get_state returned what cannot be saved ({error}); expected numbers, "
            "texts, arrays, and containers of them"
        ) from error
    return data


def read(name: str, component: Component, data: bytes) -> object:
    """The state in `data`, for the component's `set_state`. Raises ScenarioError."""
    try:
        found: object = _StateReader(data, type(component).__module__).load()
    except Exception as error:
        raise ScenarioError(
            f"{name}: its state is nothing that can be restored ({error}); expected numbers, "
            "texts, arrays, containers, and classes of its own module"
        ) from error
    return found
