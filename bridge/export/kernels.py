"""The C kernels of components, taken from the sources in their FMUs, for one library.

Every kernel defines the same names (``fmus/c/kernel.c``). In the library each model is in a folder
of its own, and its names have the model's name before them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from cosim.base.component import Component
from cosim.base.errors import FmuError
from cosim.fmi.components import model_name, stepped_fmu
from fmus.firmware.names import linked_names, renamed

#: Files of a model's FMU that are FMI, not the model.
_LAYER = re.compile(r"(fmi[23].*|instance|exchange|state|stepping|clock)\.[ch]")
_ENTRY = re.compile(r'\{"(\w+)", [A-Z_| ]+, (\d+), (\d+), ')


@dataclass(frozen=True, slots=True)
class KernelSource:
    """A model's C: `files` by name, `places` (offset, size) of its variables in the struct."""

    name: str
    files: Mapping[str, str]
    places: Mapping[str, tuple[int, int]]

    @property
    def size(self) -> int:
        """Number of scalars."""
        return max((first + size for first, size in self.places.values()), default=0)

    def sources(self) -> dict[str, str]:
        """Its files in a folder, and one C file beside the folder for each that is compiled."""
        names = {name for text in self.files.values() for name in linked_names(text)}
        lines = renamed(names, self.name)
        found = {f"{self.name}/names.h": f"/* names.h - of this model alone. */\n{lines}"}
        for name, text in self.files.items():
            found[f"{self.name}/{name}"] = text
            if name.endswith(".c"):
                found[f"{self.name}_{name}"] = (
                    f'#include "{self.name}/names.h"\n#include "{self.name}/{name}"\n'
                )
        return found


def kernels(components: Sequence[tuple[str, Component]]) -> dict[str, KernelSource]:
    """The kernel of each component, by its name; components of one model share it.

    Raises FmuError for a component that has none.
    """
    found: dict[str, KernelSource] = {}
    known: dict[tuple[tuple[str, str], ...], KernelSource] = {}
    for name, component in components:
        files = _files(name, component)
        key = tuple(sorted(files.items()))
        if key not in known:
            known[key] = _kernel(files, {k.name for k in known.values()})
        found[name] = known[key]
    return found


def _files(name: str, component: Component) -> dict[str, str]:
    """The C files of a component's model without those of FMI. Raises FmuError."""
    fmu = stepped_fmu(component)
    folder = Path() if fmu is None else fmu.archive.folder / "sources"
    if fmu is None or not (folder / "kernel.c").is_file():
        raise FmuError(
            f"component {name}: found {model_name(component)}, expected an FMU of this project"
            " with its C kernel (sources/kernel.c): only these run without Python"
        )
    return {
        path.name: path.read_text(encoding="utf-8")
        for path in sorted(folder.iterdir())
        if path.suffix in (".c", ".h") and not _LAYER.fullmatch(path.name)
    }


def _kernel(files: Mapping[str, str], taken: set[str]) -> KernelSource:
    tables = files["variables.c"]
    match = re.search(r'Declaration declared = \{\s*"(\w+)"', tables)
    first = match[1] if match else "model"
    names = [first, *(f"{first}_{n}" for n in range(2, len(taken) + 3))]
    name = next(n for n in names if n not in taken)
    places = {entry: (int(first), int(size)) for entry, first, size in _ENTRY.findall(tables)}
    places.pop("time", None)
    return KernelSource(name, files, places)
