"""Resolution of the model names of a scenario to components.

A model is a path to an ``.fmu``, ``mujoco:`` and the path of a scene, a module that has
``fmu(version, **sizes)``, or ``module:attribute`` that makes a Python component. Nothing is
discovered or registered.
"""

from __future__ import annotations

import hashlib
import importlib
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from cosim.base.component import Component, Kind, Parameter, Port, Preparation
from cosim.base.convert import number
from cosim.base.errors import CosimError, FmuError, MujocoError, ScenarioError
from cosim.base.files import same_working_folder
from cosim.base.names import hint
from cosim.fmi import FmuComponent, FmuOptions, structural_sizes
from cosim.fmi.components import stepped_fmu
from cosim.fmi.failures import sentence
from cosim.fmi.options import PATIENCE
from cosim.mujoco import PREFIX, read_options, scene_path
from cosim.scenario.spec import ComponentSpec

if TYPE_CHECKING:
    from types import ModuleType

_MEMBERS = ("kind", "inputs", "outputs", "parameters", "initialize", "initial", "step")


#: The options of a model without the hook ``prepare``, or of a component without options.
_UNPREPARED = Preparation({}, {}, {})


#: A component, the presets of its model, and what the model made of the options.
LoadedComponent = tuple[Component, Mapping[str, Any], Preparation]


def load_component(name: str, spec: ComponentSpec, folder: Path, place: str) -> LoadedComponent:
    """The component a spec names, the model's presets, and what it made of the options.

    Raises ScenarioError at `place` for a model that cannot be found or made.
    """
    with same_working_folder():
        return _loaded(name, spec, folder, place)


def _loaded(name: str, spec: ComponentSpec, folder: Path, place: str) -> LoadedComponent:
    """The same, by user code that may change the working directory."""
    if spec.model.endswith(".fmu"):
        if spec.options:
            raise ScenarioError(
                "an FMU takes no options; expected its parameters, or the module of its model",
                f"{place}.options",
            )
        path = Path(spec.model)
        path = path if path.is_absolute() else folder / path
        return _fmu(name, path, spec, spec.sizes, place), {}, _UNPREPARED
    if spec.model.startswith(PREFIX):
        return _scene(spec, folder, place), {}, _UNPREPARED
    module_name, colon, attribute = spec.model.partition(":")
    module = _module(module_name, place)
    presets: Mapping[str, Any] = vars(module).get("PRESETS", {})
    maker = vars(module).get(attribute if colon else "fmu")
    if not callable(maker):
        missing = f"no {attribute!r}" if colon else "no function fmu(version, **sizes)"
        raise ScenarioError(f"module {module_name!r} has {missing}", f"{place}.model")
    prepared = _prepared(module, spec, folder, place)
    sizes = {**prepared.sizes, **spec.sizes}
    try:
        if not colon:
            path = maker(spec.fmi, **sizes)
            return _fmu(name, path, spec, _structural(path, sizes), place), presets, prepared
        options = _options(spec, folder) if prepared is _UNPREPARED else {}
        component: Component = maker(**sizes, **options)
    except TypeError as error:
        raise ScenarioError(f"{spec.model}: {sentence(error)}", f"{place}.sizes") from None
    except CosimError as error:
        raise ScenarioError(str(error), place) from None
    except (Exception, SystemExit) as error:
        raise ScenarioError(f"{spec.model}: {sentence(error)}", f"{place}.model") from error
    if spec.kind in _WORDS:
        raise ScenarioError(f"found {spec.kind}, expected an FMU for it", f"{place}.kind")
    if spec.kind is not None:
        component.kind = spec.kind  # type: ignore[assignment]
    _check(component, f"{place}.model")
    return component, presets, _hashed(options) or prepared


def _hashed(options: Mapping[str, Any]) -> Preparation | None:
    """The SHA-256 sum of the file that the option `path` of a Python component names, if any."""
    path = Path(options["path"]) if isinstance(options.get("path"), str) else None
    if path is None or not path.is_file():
        return None
    return Preparation({}, {}, {str(path): hashlib.sha256(path.read_bytes()).hexdigest()})


def load_alike() -> Callable[[str, ComponentSpec, Path, str], LoadedComponent]:
    """:func:`load_component` for the components of one scenario.

    FMUs that differ in their values only are read once.
    """
    known: dict[bytes, tuple[FmuComponent, frozenset[str], Mapping[str, Any]]] = {}

    def load(name: str, spec: ComponentSpec, folder: Path, place: str) -> LoadedComponent:
        key = spec.likeness()
        if key in known:
            like, special, presets = known[key]
            if special.isdisjoint(spec.values):
                return like.alike(name), presets, _UNPREPARED
        found, presets, prepared = load_component(name, spec, folder, place)
        fmu = stepped_fmu(found)
        if fmu is not None and prepared is _UNPREPARED and not fmu.taken:
            known[key] = fmu.alike(name), fmu.special, presets
        return found, presets, prepared

    return load


def _structural(path: Path, sizes: Mapping[str, int]) -> dict[str, int]:
    """The sizes that are structural parameters of an FMU: it serves any, and was not made for them.

    Raises FmuError.
    """
    return {size: n for size, n in sizes.items() if size in structural_sizes(path)} if sizes else {}


def _prepared(module: ModuleType, spec: ComponentSpec, folder: Path, place: str) -> Preparation:
    """A module's preparation of the options; Python components without the hook take none."""
    prepare = vars(module).get("prepare")
    if not spec.options or (prepare is None and ":" in spec.model):
        return _UNPREPARED
    if prepare is None:
        raise ScenarioError(
            "only a Python component, or a model that prepares them, takes options",
            f"{place}.options",
        )
    try:
        prepared: Preparation = prepare(spec.options, folder)
    except CosimError as error:
        raise ScenarioError(str(error), f"{place}.options") from None
    except (Exception, SystemExit) as error:
        raise ScenarioError(f"{spec.model}: {sentence(error)}", f"{place}.options") from error
    if not isinstance(prepared, Preparation):
        raise ScenarioError(
            f"{module.__name__}.prepare returned a {type(prepared).__name__}, expected a"
            " Preparation",
            f"{place}.options",
        )
    for size, value in spec.sizes.items():
        if prepared.sizes.get(size, value) != value:
            raise ScenarioError(
                f"found {value}, expected {prepared.sizes[size]} by the options",
                f"{place}.sizes.{size}",
            )
    return prepared


def _scene(spec: ComponentSpec, folder: Path, place: str) -> Component:
    """A scene of MuJoCo. Raises ScenarioError, MujocoError at `place`."""
    if spec.kind not in (None, "continuous"):
        raise ScenarioError(f"found {spec.kind}, expected continuous for a scene", f"{place}.kind")
    for key in (
        *("sizes", "log", "isolate", "timeout", "tolerance", "memory", "build"),
        *("solver", "max_step", "bus", "terminal"),
    ):
        if getattr(spec, key):
            raise ScenarioError(
                "found a key that a scene of MuJoCo does not have", f"{place}.{key}"
            )
    from cosim.mujoco.component import MujocoComponent  # few runs need it

    options = read_options(spec.options, f"{place}.options")
    try:
        return MujocoComponent(scene_path(spec.model, folder), options)
    except MujocoError as error:
        raise MujocoError(f"{place}.model: {error}") from None


def _options(spec: ComponentSpec, folder: Path) -> dict[str, Any]:
    """Keyword arguments of a Python component; `path` is relative to the scenario's file."""
    return {
        key: str(folder / value) if key == "path" and isinstance(value, str) else value
        for key, value in spec.options.items()
    }


#: Kinds that are interfaces of an FMU, and how it then samples.
_WORDS: Mapping[str, tuple[Kind | None, str]] = {
    "co-simulation": (None, "CoSimulation"),
    "model exchange": ("continuous", "ModelExchange"),
    "model-exchange": ("continuous", "ModelExchange"),
    "scheduled execution": ("sampled", "ScheduledExecution"),
    "scheduled-execution": ("sampled", "ScheduledExecution"),
}


def _fmu(
    name: str, path: Path, spec: ComponentSpec, sizes: Mapping[str, int], place: str
) -> Component:
    seconds = PATIENCE if spec.timeout is None else number(spec.timeout, "s", f"{place}.timeout")
    if not seconds > 0.0:
        raise ScenarioError(f"{seconds:g} s must be positive", f"{place}.timeout")
    kind, interface = _WORDS.get(spec.kind, (spec.kind, ""))  # type: ignore[arg-type]
    options = FmuOptions(
        sizes=sizes, given={**spec.parameters, **spec.start}, log=spec.log,
        isolate=spec.isolate is True, wasm=spec.isolate == "wasm",
        timeout=seconds, memory=spec.memory, build=spec.build, tolerance=spec.tolerance,
        interface=interface, solver=spec.solver, max_step=_longest(spec, place),
    )  # fmt: skip
    try:
        fmu = FmuComponent(path, name, kind, options)
        if spec.bus or spec.terminal or _has_terminal(fmu):
            return _on_bus(fmu, spec, place)
    except FmuError as error:
        raise FmuError(f"{place}.model: {error}") from None
    return fmu


def _longest(spec: ComponentSpec, place: str) -> float | None:
    if spec.max_step is None:
        return None
    seconds = number(spec.max_step, "s", f"{place}.max_step")
    if not seconds > 0.0:
        raise ScenarioError(f"{seconds:g} s must be positive", f"{place}.max_step")
    return seconds


def _on_bus(fmu: FmuComponent, spec: ComponentSpec, place: str) -> Component:
    """The FMU, or with a bus what drives it there. Raises ScenarioError for a terminal without."""
    from cosim.lsbus.member import BusMember
    from cosim.lsbus.terminals import read_terminals

    if spec.bus:
        return BusMember(fmu, spec.terminal)
    if found := ", ".join(read_terminals(fmu)):
        raise ScenarioError(
            f"found the CAN terminal {found} of FMI-LS-BUS without a bus, whose frames would be"
            ' lost; expected bus = "NAME" in the component, and [bus.NAME] in the scenario',
            f"{place}.model",
        )
    if spec.terminal:
        raise ScenarioError("found terminal without bus, expected both", f"{place}.terminal")
    return fmu


def _has_terminal(fmu: FmuComponent) -> bool:
    return _describes_terminals(fmu.archive.folder)


@lru_cache(maxsize=64)  # a folder is named by what is in it
def _describes_terminals(folder: Path) -> bool:
    file = folder / "terminalsAndIcons" / "terminalsAndIcons.xml"
    return file.is_file() and b"org.fmi-ls-bus" in file.read_bytes()


def _beside(name: str) -> list[str]:
    """Modules in the package of a module that is not there."""
    package, _, _ = name.rpartition(".")
    if not package.replace(".", "").isidentifier():
        return []
    try:
        places = importlib.import_module(package).__path__
    except (Exception, SystemExit):  # it may do anything
        return []
    import pkgutil  # only a wrong name needs it

    return [f"{package}.{found.name}" for found in pkgutil.iter_modules(places)]


def _module(name: str, place: str) -> ModuleType:
    try:
        if not all(part.isidentifier() for part in name.split(".")):
            raise ImportError("that is not a valid name of a module")
        return importlib.import_module(name)
    except ImportError as error:
        raise ScenarioError(
            f"cannot import {name!r}: {error}{hint(name, _beside(name))}; expected a path ending "
            "in .fmu, a module such as 'fmus.models.planar2r', or 'module:attribute'",
            f"{place}.model",
        ) from None
    except (Exception, SystemExit) as error:
        raise ScenarioError(f"importing {name!r}: {sentence(error)}", f"{place}.model") from error


def _check(component: Component, place: str) -> None:
    """Refuse an object that is not a component, with the message of a type checker."""
    what = type(component).__name__
    present = dir(component)
    missing = [member for member in _MEMBERS if member not in present]
    if missing:
        raise ScenarioError(f"{what} is not a component: it has no {', '.join(missing)}", place)
    if component.kind not in get_args(Kind):
        expected = " or ".join(map(repr, get_args(Kind)))
        raise ScenarioError(f"{what}.kind is {component.kind!r}; expected {expected}", place)
    for member, kind in (("inputs", Port), ("outputs", Port), ("parameters", Parameter)):
        found = getattr(component, member)
        if not isinstance(found, tuple) or not all(isinstance(entry, kind) for entry in found):
            raise ScenarioError(
                f"{what}.{member} is {found!r}; expected a tuple of {kind.__name__}s", place
            )
