"""Components that stay from one scenario to the next, where only numbers of them have changed."""

from __future__ import annotations

from pathlib import Path

from cosim.fmi.components import stepped_fmu
from cosim.scenario.models import LoadedComponent, load_component
from cosim.scenario.spec import ComponentSpec


class KeptComponents:
    """Loads components as :func:`load_component` does, and keeps FMUs that are stepped here.

    An FMU is loaded again if anything but the values of its parameters and start values differs:
    its file, a size, a text.
    """

    def __init__(self) -> None:
        self._kept: dict[str, tuple[ComponentSpec, Path, LoadedComponent]] = {}

    def load(self, name: str, spec: ComponentSpec, folder: Path, place: str) -> LoadedComponent:
        """The component `name`. Raises CosimError as :func:`load_component` does."""
        kept = self._kept.get(name)
        if kept is not None and kept[1] == folder and _alike(kept[0], spec, kept[2]):
            return kept[2]
        found = load_component(name, spec, folder, place)
        if stepped_fmu(found[0]) is not None:
            self._kept[name] = spec, folder, found
        return found


def _alike(old: ComponentSpec, new: ComponentSpec, loaded: LoadedComponent) -> bool:
    """Whether a spec gives the FMU that was loaded for `old`."""
    if old == new:
        return True
    fmu = stepped_fmu(loaded[0])
    assert fmu is not None
    before, after = old.values, new.values
    return (
        before.keys() == after.keys()
        and all(before.get(name) == after.get(name) for name in fmu.taken)
        and old.without_values() == new.without_values()
    )
