"""An ``.fmu`` as a Component: ports, start values, and the addresses the engine steps it by."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.component import Kind, Outputs, Parameter, Port, Values
from cosim.errors import FmuError
from cosim.fmi import archive as archives
from cosim.fmi.description import read
from cosim.fmi.library import Instance, instantiate
from cosim.fmi.ports import REAL, Group, groups

if TYPE_CHECKING:
    import numpy as np

_NUMERIC = {"Real", "Integer", "Boolean", "Enumeration", "Float64", "Float32"} | {
    f"{u}Int{n}" for u in ("", "U") for n in (8, 16, 32, 64)
}
_TYPES = {"Real": "real", "Float64": "real", "Float32": "real", "Boolean": "boolean"}


class FmuComponent:
    """One instance of an FMU.

    `kind` says how it samples; an FMU does not say so itself (ours do, in an annotation), so a
    foreign FMU is continuous unless the scenario says otherwise. Raises FmuError for anything
    wrong with the file, the description or the binary.
    """

    def __init__(self, path: Path, name: str = "fmu", kind: Kind | None = None) -> None:
        self.archive = archives.unpack(path)
        self.description = read(self.archive.folder / "modelDescription.xml", path)
        self.name = name
        self.kind: Kind = kind or self.description.kind or "continuous"  # type: ignore[assignment]
        self.groups = {g.name: g for g in groups(self.description.variables)}
        self.inputs = tuple(_port(g) for g in self._carried("input"))
        self.outputs = tuple(_port(g) for g in self._carried("output"))
        self.parameters = tuple(_parameter(g) for g in self.groups.values() if _settable(g))
        self._instance: Instance | None = None
        self._initializing = False
        self._private: str | None = None

    def _carried(self, causality: str) -> list[Group]:
        return [
            g for g in self.groups.values()
            if g.first.causality == causality and g.first.type in REAL
        ]  # fmt: skip

    @property
    def instance(self) -> Instance:
        """The live FMI instance. Raises FmuError before :meth:`initialize`."""
        if self._instance is None:
            raise FmuError(f"{self.name}: not initialised")
        return self._instance

    def references(self, causality: str) -> tuple[int, ...]:
        """Value references of all carried inputs or outputs, in port order."""
        return tuple(r for g in self._carried(causality) for r in g.references)

    def initialize(self, values: Values) -> None:
        """Instantiate and enter Initialization Mode with `values` set; raises FmuError."""
        self.close()
        binary = archives.binary(self.archive, self.description.fmi, self.description.identifier)
        if self.description.flags.get("canBeInstantiatedOnlyOncePerProcess"):
            binary = self._private_copy(binary)
        resources = self.archive.folder / "resources"
        token = self.description.token
        self._instance = instantiate(self.description.fmi, binary, self.name, token, resources)
        before = {k: v for k, v in values.items() if self.groups[k].first.causality != "input"}
        for name, value in before.items():
            self._set(self.groups[name], value)
        self._instance.enter_initialization(0.0)
        self._initializing = True

    def _private_copy(self, binary: Path) -> Path:
        self._private = tempfile.mkdtemp(prefix="cosim-")
        return Path(shutil.copy2(binary, self._private))

    def _set(self, group: Group, value: Any) -> None:
        flat = [float(v) for v in value.reshape(-1)]
        self.instance.set(group.first.type, group.references, flat)

    def initial(self, u: Values) -> Outputs:
        """Outputs in Initialization Mode for inputs `u`."""
        for name, value in u.items():
            self._set(self.groups[name], value)
        return self._outputs()

    def _outputs(self) -> dict[str, np.ndarray[Any, Any]]:
        import numpy as np

        result = {}
        for group in self._carried("output"):
            values = self.instance.get(group.first.type, group.references, group.size)
            result[group.name] = np.array(values).reshape(group.shape)
        return result

    def exit_initialization(self) -> None:
        """Leave Initialization Mode, once; the first step does it if nobody has."""
        if self._initializing:
            self.instance.exit_initialization()
            self._initializing = False

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Set inputs, ``doStep(t, h)``, get outputs: the slow way, for tests and small uses."""
        self.exit_initialization()
        for name, value in u.items():
            self._set(self.groups[name], value)
        self.instance.do_step(t, h)
        return self._outputs()

    def get_state(self) -> object:
        """An FMU state handle of this instance; raises FmuError where the FMU has none."""
        flag = "canGetAndSetFMUstate" if self.description.fmi == "2.0" else "canGetAndSetFMUState"
        if not self.description.flags.get(flag):
            raise FmuError(f"{self.name}: {self.archive.path.name} cannot save its state ({flag})")
        return self.instance.get_state()

    def set_state(self, state: object) -> None:
        """Continue from a state of this instance."""
        assert isinstance(state, int)
        self.instance.set_state(state)

    def close(self) -> None:
        """Free the instance; may be called twice."""
        if self._instance is not None:
            self._instance.free()
            self._instance = None
        if self._private is not None:
            shutil.rmtree(self._private, ignore_errors=True)
            self._private = None

    def facts(self) -> Mapping[str, str]:
        """What a run's metadata keeps of an FMU."""
        return {
            "file": str(self.archive.path),
            "sha256": self.archive.sha256,
            "fmi": self.description.fmi,
            "tool": self.description.tool,
        }


def _port(group: Group) -> Port:
    variable = group.first
    start = _numbers(group) if variable.causality == "input" else ()
    return Port(group.name, group.shape, variable.unit or "1", variable.description, start)


def _parameter(group: Group) -> Parameter:
    v = group.first
    kind = _TYPES.get(v.type, "integer")
    return Parameter(group.name, _numbers(group), group.shape, v.unit or "1", v.description, kind)  # type: ignore[arg-type]


def _settable(group: Group) -> bool:
    v = group.first
    if v.type not in _NUMERIC or v.variability == "constant":
        return False
    if v.causality in ("parameter", "structuralParameter"):
        return True
    return v.causality in ("local", "output") and v.initial in ("exact", "approx") and bool(v.start)


def _numbers(group: Group) -> tuple[float, ...]:
    words = {"true": 1.0, "false": 0.0}
    texts = group.start or ("0",) * group.size
    return tuple(words[t] if t in words else float(t) for t in texts)
