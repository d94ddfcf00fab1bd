"""The C kernel of a model as a Component, without FMI in between.

The library is the one inside the FMU, so its results are the same. A kernel uses four functions
(``fmus/c/kernel.c``) over one array of doubles, the struct `Model`.
"""

from __future__ import annotations

import ctypes
import os
import tempfile
import zipfile
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.component import Kind, Parameter, Port
from cosim.base.errors import FmuError, RunError, ScenarioError
from fmus.build import toolchain
from fmus.build.archive import cache, find
from fmus.model import Model
from fmus.model.numeric import initial_input, start_values

if TYPE_CHECKING:
    from cosim.base.component import Outputs, Values

Array = NDArray[np.float64]


@final
class Kernel:
    """A model's C kernel, stepped through ctypes.

    Raises FmuError, or fmus.build.toolchain.ToolchainError, where its FMU has to be built and
    cannot be.
    """

    def __init__(self, model: Model) -> None:
        self.kind: Kind = model.kind
        self.inputs: tuple[Port, ...] = model.inputs()
        self.outputs: tuple[Port, ...] = model.outputs()
        self.parameters: tuple[Parameter, ...] = model.parameters()
        self._model = model
        self._library = load(library(model))
        size = self._library.kernel_size()
        if size != sum(v.size for v in model.variables):
            raise FmuError(f"{model.identifier}: the library has another size, {size} values")
        self._x: Array = np.zeros(size)
        self._address = self._x.ctypes.data
        self._place = self._places()
        self._in = [
            (port.name, self._place[port.name], initial_input(port)) for port in self.inputs
        ]
        self._out = [(port.name, self._place[port.name]) for port in self.outputs]
        self._library.kernel_reset(self._address)

    def _places(self) -> dict[str, Array]:
        """A view of each variable, of its shape, into the struct."""
        places, offset = {}, 0
        for v in self._model.variables:
            places[v.name] = self._x[offset : offset + v.size].reshape(v.shape)
            offset += v.size
        return places

    def initialize(self, values: Values) -> None:
        """Go to the start. Raises ScenarioError."""
        found = start_values(self._model, values)
        self._library.kernel_reset(self._address)
        for name, value in found.items():
            self._place[name][...] = value
        self._settle()

    def initial(self, u: Values) -> Outputs:
        """Outputs at the start, given the inputs there. Raises ScenarioError."""
        self._take(u)
        self._settle()
        return self._give()

    def _settle(self) -> None:
        message = self._library.kernel_initial(self._address)
        if message:
            raise ScenarioError(self._why(message.decode()), self._model.identifier)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """One step from `t` (s) of length `h` (s). Raises RunError; the state is as before then."""
        self._take(u)
        message = self._library.kernel_step(self._address, t, h)
        if message:
            raise RunError(f"{self._model.identifier}: {self._why(message.decode())}", time=t)
        return self._give()

    def _take(self, u: Values) -> None:
        for name, place, default in self._in:
            place[...] = u.get(name, default)

    def _give(self) -> Outputs:
        return {name: place.copy() for name, place in self._out}

    def _why(self, message: str) -> str:
        for name, place, _ in self._in:
            if not np.isfinite(place).all():
                return f"input {name} is {place.tolist()}, expected finite numbers"
        return message

    def get_state(self) -> object:
        """All variables, copied."""
        return self._x.copy()

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x[:] = np.asarray(state, dtype=np.float64)


def library(model: Model) -> Path:
    """The shared library of `model` for this machine, taken from its FMU. Raises FmuError."""
    platform = toolchain.host_platform()
    name = model.identifier + toolchain.shared_suffix(platform)
    path = cache(model) / platform / name
    if path.is_file():
        return path
    fmu = find(model, "3.0")
    try:
        with zipfile.ZipFile(fmu) as archive:
            content = archive.read(f"binaries/{platform}/{name}")
        path.parent.mkdir(exist_ok=True)
        handle, scratch = tempfile.mkstemp(prefix=".library-", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.replace(scratch, path)
    except (OSError, KeyError) as error:
        raise FmuError(f"{fmu}: cannot take the library for {platform} from it: {error}") from error
    return path


@lru_cache(maxsize=64)
def load(path: Path) -> ctypes.CDLL:
    """The library at `path` with its kernel functions declared. Raises FmuError."""
    try:
        loaded = ctypes.CDLL(str(path))
        loaded.kernel_size.restype = ctypes.c_size_t
        loaded.kernel_size.argtypes = []
        loaded.kernel_reset.restype = None
        loaded.kernel_reset.argtypes = [ctypes.c_void_p]
        loaded.kernel_initial.restype = ctypes.c_char_p
        loaded.kernel_initial.argtypes = [ctypes.c_void_p]
        loaded.kernel_step.restype = ctypes.c_char_p
        loaded.kernel_step.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double]
    except (OSError, AttributeError) as error:
        raise FmuError(f"{path}: cannot be loaded as a kernel: {error}") from error
    return loaded
