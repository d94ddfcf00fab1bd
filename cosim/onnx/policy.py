"""The component of an ONNX file: tensors are ports, and recurrent ones are its state.

Inference runs on the processor, in one thread and in a fixed order, so on one machine a run repeats
to the last bit; another version of ONNX Runtime, or another processor, may round differently.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, final

import msgspec
import numpy as np
from numpy.typing import NDArray

from cosim.base.component import Kind, Outputs, Parameter, Port, Values
from cosim.base.convert import convert
from cosim.base.errors import RunError, ScenarioError
from cosim.base.names import unknown

INSTALL = "pip install 'cosim-bridge[onnx]'"
#: The types of elements that a port can carry, by ONNX Runtime's name.
_TYPES: Mapping[str, type[np.generic]] = {
    "tensor(float)": np.float32,
    "tensor(double)": np.float64,
    "tensor(float16)": np.float16,
    "tensor(int64)": np.int64,
    "tensor(int32)": np.int32,
    "tensor(bool)": np.bool_,
}


class PolicyOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The options of a policy.

    `path`: the file. `state`: recurrent tensors, the input by the output that it gets in the next
    step; they begin at 0 and are no ports. `dims`: lengths of free dimensions by name; the first
    dimension of a tensor, the batch, is 1 unless it is there. `units`: of ports. `ports`: the name
    of a port by that of its tensor; default: the same with ``_`` for what no identifier has.
    """

    path: str
    state: dict[str, str] = {}
    dims: dict[str, int] = {}
    units: dict[str, str] = {}
    ports: dict[str, str] = {}

    @classmethod
    def read(cls, options: Mapping[str, Any]) -> Self:
        """The options of a scenario. Raises ScenarioError."""
        return convert(dict(options), cls, Path("options"))


@dataclass(frozen=True, slots=True)
class _Tensor:
    """One input or output of the graph."""

    name: str
    port: Port
    shape: tuple[int, ...]
    dtype: type[np.generic]

    def array(self, values: Any) -> NDArray[Any]:
        """The tensor with these values (the shape of the port), rounded to its type."""
        return np.asarray(values, np.float64).astype(self.dtype).reshape(self.shape)

    def zeros(self) -> NDArray[Any]:
        """The tensor with zeros."""
        return np.zeros(self.shape, self.dtype)


@final
class OnnxPolicy:
    """A policy: in each step one inference, with the inputs at its beginning.

    It has no parameters. The first inference, at the start, gives the initial outputs and does not
    change the state. Raises ScenarioError for a file that is none, or that has tensors which are no
    ports: texts, sequences, or lengths that are not known.
    """

    kind: Kind = "sampled"
    parameters: tuple[Parameter, ...] = ()

    def __init__(self, options: PolicyOptions) -> None:
        self._options, self._path = options, Path(options.path)
        self._session = _session(self._path)
        inputs = [self._tensor(x) for x in self._session.get_inputs()]
        outputs = [self._tensor(x) for x in self._session.get_outputs()]
        self._check_names([*inputs, *outputs])
        self._state = self._recurrent(inputs, outputs)
        self._inputs = [x for x in inputs if x.name not in self._state]
        self._outputs = [x for x in outputs if x.name not in self._state.values()]
        self._names = [x.name for x in outputs]
        self._began = {x.name: x.zeros() for x in inputs if x.name in self._state}
        self._held = dict(self._began)
        self.inputs: tuple[Port, ...] = tuple(x.port for x in self._inputs)
        self.outputs: tuple[Port, ...] = tuple(x.port for x in self._outputs)

    # ---- ports -------------------------------------------------------------------------------

    def _tensor(self, found: Any) -> _Tensor:
        """A tensor of the graph and its port. Raises ScenarioError."""
        place = f"{self._path.name}: {found.name}"
        if found.type not in _TYPES:
            raise ScenarioError(
                f"found the type {found.type}, expected one of {', '.join(_TYPES)}", place
            )
        shape = tuple(self._length(x, i, place) for i, x in enumerate(found.shape))
        name = self._options.ports.get(found.name) or _identifier(found.name)
        port = Port(
            name,
            shape[1:] if shape[:1] == (1,) else shape,
            self._options.units.get(name, "1"),
            f"tensor {found.name}, {np.dtype(_TYPES[found.type]).name}",
        )
        return _Tensor(found.name, port, shape, _TYPES[found.type])

    def _length(self, dimension: Any, place: int, tensor: str) -> int:
        """The length of a dimension, which is a number, a name or None. Raises ScenarioError."""
        if isinstance(dimension, int):
            return dimension
        known = self._options.dims.get(dimension or "")
        if known is None and place == 0:
            return 1
        if known is None or known < 1:
            raise ScenarioError(
                f"found the free dimension {dimension or place!r}, expected its length: "
                f"options.dims = {{ {dimension or 'NAME'} = 10 }}",
                tensor,
            )
        return known

    def _check_names(self, tensors: list[_Tensor]) -> None:
        """Refuse options for tensors, ports or dimensions that do not exist, and equal names."""
        names = [x.name for x in tensors]
        ports = [x.port.name for x in tensors]
        for name in self._options.ports:
            if name not in names:
                raise ScenarioError(unknown(name, names, "tensor"), "options.ports")
        for name in self._options.units:
            if name not in ports:
                raise ScenarioError(unknown(name, ports, "port"), "options.units")
        for name in ports:
            if ports.count(name) > 1:
                raise ScenarioError(
                    f"found two tensors with the port {name}, expected another name of one of "
                    "them in options.ports",
                    self._path.name,
                )

    def _recurrent(self, inputs: list[_Tensor], outputs: list[_Tensor]) -> dict[str, str]:
        """The inputs that are state, and their outputs. Raises ScenarioError."""
        takes, gives = {x.name: x for x in inputs}, {x.name: x for x in outputs}
        for name, source in self._options.state.items():
            if name not in takes:
                raise ScenarioError(unknown(name, takes, "input"), "options.state")
            if source not in gives:
                raise ScenarioError(unknown(source, gives, "output"), "options.state")
            ends = [(x.shape, x.dtype) for x in (takes[name], gives[source])]
            if ends[0] != ends[1]:
                raise ScenarioError(
                    f"found {name} {list(ends[0][0])} and {source} {list(ends[1][0])}, expected "
                    "one shape and type",
                    "options.state",
                )
        return dict(self._options.state)

    # ---- steps -------------------------------------------------------------------------------

    def initialize(self, values: Values) -> None:
        """Go to the start: the recurrent tensors are 0."""
        self._held = dict(self._began)

    def initial(self, u: Values) -> Outputs:
        """The outputs for the inputs `u`, without a change of the state. Raises RunError."""
        return self._infer(u)[0]

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """One inference with the inputs `u` at `t` (s). Raises RunError for one that fails."""
        given, self._held = self._infer(u)
        return given

    def _infer(self, u: Values) -> tuple[Outputs, dict[str, NDArray[Any]]]:
        feed = {x.name: x.array(u[x.port.name]) for x in self._inputs} | self._held
        try:
            found = dict(zip(self._names, self._session.run(self._names, feed), strict=True))
        except Exception as error:  # the types that ONNX Runtime raises are its own
            raise RunError(f"{self._path.name}: ONNX Runtime: {error}") from error
        given = {
            x.port.name: np.asarray(found[x.name], np.float64).reshape(x.port.shape)
            for x in self._outputs
        }
        return given, {name: found[source] for name, source in self._state.items()}

    def get_state(self) -> object:
        """The recurrent tensors."""
        return {name: value.copy() for name, value in self._held.items()}

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        assert isinstance(state, dict)
        self._held = {name: value.copy() for name, value in state.items()}


def _session(path: Path) -> Any:
    """The graph of a file, loaded. Raises ScenarioError."""
    try:
        runtime = importlib.import_module("onnxruntime")
    except ImportError as error:
        raise ScenarioError(
            f"cannot import ONNX Runtime ({error}); expected it installed: {INSTALL}"
        ) from None
    if not path.is_file():
        raise ScenarioError("no such file", str(path))
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    options.log_severity_level = 3
    try:
        return runtime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # the types that ONNX Runtime raises are its own
        raise ScenarioError(f"{path}: found no graph of ONNX that can run: {error}") from None


def _identifier(name: str) -> str:
    """A name of a port for the name of a tensor."""
    text = "".join(x if x.isalnum() or x == "_" else "_" for x in name)
    return text if text[:1].isalpha() or text[:1] == "_" else f"_{text}"
