"""Components that stay from one scenario to the next, where only numbers of them have changed."""

from __future__ import annotations

from pathlib import Path

from cosim.fmi.components import stepped_fmu
from cosim.scenario.models import LoadedComponent, load_component
from cosim.scenario.spec import ComponentSpec

#: How a component was named, where, and what was loaded for it.
_Kept = tuple[ComponentSpec, Path, LoadedComponent]


class KeptComponents:
    """Loads components as :func:`load_component` does, and keeps FMUs that are stepped here.

    An FMU is loaded again if anything but the values of its parameters and start values differs:
    its file, a size, a text. The process of an isolated one stays as long as it is kept.
    """

    def __init__(self) -> None:
        self._kept: dict[str, _Kept] = {}

    def load(self, name: str, spec: ComponentSpec, folder: Path, place: str) -> LoadedComponent:
        """The component `name`. Raises CosimError as :func:`load_component` does."""
        kept = self._kept.get(name)
        if kept is not None and kept[1] == folder and _alike(kept[0], spec, kept[2]):
            return kept[2]
        found = load_component(name, spec, folder, place)
        if kept is not None:
            _end(self._kept.pop(name))
        fmu = stepped_fmu(found[0])
        if fmu is not None:
            fmu.stays = True
            self._kept[name] = spec, folder, found
        return found

    def close(self) -> None:
        """End the processes of isolated FMUs, once all are freed."""
        while self._kept:
            _end(self._kept.popitem()[1])


def _end(kept: _Kept) -> None:
    fmu = stepped_fmu(kept[2][0])
    assert fmu is not None
    fmu.end()


def _alike(old: ComponentSpec, new: ComponentSpec, loaded: LoadedComponent) -> bool:
    """True if a spec gives the FMU that was loaded for `old`."""
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
