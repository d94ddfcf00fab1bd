"""Queries about components, which are FMUs or Python components, for other packages.

Only this module distinguishes FMUs from Python components. For a Python component its answers are:
no file, no texts, no log, nothing to free.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from ctypes import c_double

from cosim.base.component import Component, NativeComponent, Outputs, Values
from cosim.base.units import Unit, is_unit
from cosim.fmi.component import FmuComponent
from cosim.fmi.driver import FmuDriver
from cosim.fmi.file.ports import REAL
from cosim.fmi.file.values import NumberedTexts
from cosim.fmi.library import FATAL, OK, WARNING
from cosim.native.fmu_log import Log


def stepped_fmu(component: Component) -> FmuComponent | None:
    """The component if it is an FMU that the engine itself steps, else None."""
    return component if isinstance(component, FmuComponent) else None


def fmu_of(component: Component) -> FmuComponent | None:
    """The FMU that a component is, or drives (:class:`FmuDriver`), else None."""
    return component.fmu if isinstance(component, FmuDriver) else stepped_fmu(component)


def is_fmu(component: Component) -> bool:
    """True if the component is an FMU."""
    return fmu_of(component) is not None


def is_simulator(component: Component) -> bool:
    """True if the component belongs to a foreign simulator, and its step is a C function."""
    return _simulator(component) is not None


def _simulator(component: Component) -> NativeComponent | None:
    # every attribute of a protocol is looked for, which takes long for thousands of FMUs
    if isinstance(component, FmuComponent) or not isinstance(component, NativeComponent):
        return None
    return component


def overwrite(fmu: FmuComponent, values: Values) -> None:
    """Write outputs and locals of one of our own FMUs (`ours`) where it has them, between steps."""
    address = fmu.instance.values_address()
    for name, value in values.items():
        places = (i for r in fmu.groups[name].references for i in fmu.instance.places(r))
        for place, number in zip(places, value.reshape(-1), strict=True):
            c_double.from_address(address + 8 * place).value = float(number)


# ---- before the start -----------------------------------------------------------------------


def facts(component: Component) -> Mapping[str, str] | None:
    """Metadata of an FMU for a run: file, hash, version, tool; None: a Python class."""
    fmu = fmu_of(component)
    return None if fmu is None else fmu.facts()


def simulator_facts(component: Component) -> Mapping[str, str] | None:
    """Metadata of a component of a foreign simulator for a run; None: an FMU or a Python class."""
    simulator = _simulator(component)
    return None if simulator is None else simulator.facts()


def simulator_remarks(
    component: Component, values: Mapping[str, tuple[float, ...]]
) -> tuple[str, ...]:
    """Remarks of a component of a foreign simulator on its file and its start `values`; else none.

    `values`: flattened, in the unit of the parameter.
    """
    simulator = _simulator(component)
    return () if simulator is None else simulator.remarks(values)


def model_name(component: Component) -> str:
    """The model of a component as text: the file of an FMU, or the class."""
    fmu = fmu_of(component)
    if fmu is not None:
        name = f"{fmu.archive.path.name}, FMI {fmu.description.fmi}"
        if fmu.description.states is not None:
            name += f" model exchange, {fmu.options.solver or 'rk4'}"
        elif fmu.description.scheduled:
            name += " scheduled execution"
        return f"{name}, {component.connected}" if isinstance(component, FmuDriver) else name
    if isinstance(component, NativeComponent):
        return component.model_name
    return f"{type(component).__module__}:{type(component).__name__}, Python call-back"


def expose(
    component: Component,
    observed: Collection[str],
    driven: Collection[str],
    wired: Collection[str] = (),
) -> None:
    """Make variables of an FMU that the engine steps outputs, tunable parameters inputs, and texts
    that are connected signals.
    """
    fmu = stepped_fmu(component)
    if fmu is not None and (observed or driven or wired):
        fmu.expose(observed, driven, wired)


def share_texts(components: Iterable[Component]) -> None:
    """Let the FMUs of a run number their texts together, from the start."""
    numbered = NumberedTexts()
    for fmu in map(stepped_fmu, components):
        if fmu is not None:
            fmu.numbered = numbered


def text_type(component: Component, port: str) -> str:
    """The type of a String or Binary variable of an FMU; "" of anything else."""
    fmu = fmu_of(component)
    return fmu.groups[port].first.type if fmu is not None and fmu.is_text(port) else ""


def observable(component: Component) -> tuple[str, ...]:
    """Names of variables that :func:`expose` can make outputs: of an FMU that the engine steps."""
    fmu = stepped_fmu(component)
    return () if fmu is None else fmu.observable


def independent(component: Component) -> frozenset[str]:
    """Names of the independent variable of an FMU, usually time, which a run records anyway."""
    fmu = stepped_fmu(component)
    groups = () if fmu is None else fmu.groups.values()
    return frozenset(g.name for g in groups if g.first.causality == "independent")


def is_text(component: Component, port: str) -> bool:
    """True if a name is a String or Binary variable of an FMU: no signal."""
    fmu = fmu_of(component)
    return fmu is not None and fmu.is_text(port)


def unit_of(component: Component, unit: str) -> str | Unit:
    """A unit by the FMU's own definition if it has one, else its name."""
    fmu = fmu_of(component)
    return unit if fmu is None else fmu.description.units.get(unit, unit)


def has_unit(component: Component, port: str) -> bool:
    """True if a unit is known of a port: FMUs of other tools have variables without one, and units
    that they do not define and nobody knows.
    """
    fmu = fmu_of(component)
    if fmu is None or port not in fmu.groups:
        return True
    unit = fmu.groups[port].first.unit
    return bool(unit) and (unit in fmu.description.units or is_unit(unit))


def default_start(component: Component) -> float:
    """The time (s) at which the DefaultExperiment of an FMU begins; 0 of anything else."""
    fmu = fmu_of(component)
    return 0.0 if fmu is None else fmu.description.default_start


def ignored(component: Component) -> tuple[str, ...]:
    """Sentences about what the description of an FMU says that is not used."""
    fmu = fmu_of(component)
    return () if fmu is None else fmu.description.ignored


def discrete_inputs(component: Component) -> frozenset[str]:
    """Inputs that the component declares as discrete."""
    fmu = fmu_of(component)
    return frozenset() if fmu is None else fmu.discrete


def sloped_inputs(component: Component) -> frozenset[str]:
    """Inputs whose slope over a step can be set."""
    fmu = fmu_of(component)
    return frozenset() if fmu is None else fmu.sloped


def reason_not_rolled_back(component: Component) -> str:
    """The reason why the engine cannot repeat steps with other lengths; "": it can."""
    if isinstance(component, FmuDriver):
        return "steps together with the others on its bus"
    if is_simulator(component):
        return "has a step of its own, which cannot be halved"
    fmu = stepped_fmu(component)
    if fmu is None:
        missing = [m for m in ("get_state", "set_state") if m not in dir(component)]
        return f"cannot save its state (no {' and no '.join(missing)})" if missing else ""
    if fmu.options.isolate:
        return "is in a process of its own (isolate)"
    return _reason_fixed(fmu)


def reason_not_serialized(component: Component) -> str:
    """The reason why the state cannot be written into a file, and what would help; "": it can."""
    if isinstance(component, FmuDriver):
        return "is on a simulated bus, whose frames are not saved; expected no bus"
    fmu = stepped_fmu(component)
    if fmu is None:
        missing = [m for m in ("get_state", "set_state") if m not in dir(component)]
        return f"has no {' and no '.join(missing)}; expected these two methods" if missing else ""
    if fmu.options.isolate and fmu.options.memory:
        return "has a limit of memory, which saving exceeds; expected no memory"
    flag = "canSerializeFMUstate" if fmu.description.fmi == "2.0" else "canSerializeFMUState"
    if not fmu.description.flags.get(flag):
        return f"does not declare {flag}; expected an FMU exported with it"
    if fmu.options.solver == "cvode" and fmu.description.states is not None:
        return "is integrated by CVODE, whose memory is not saved; expected another solver"
    return ""


def _reason_fixed(fmu: FmuComponent) -> str:
    """The ability an FMU lacks: to save its state, or to step as long as it is told."""
    flags, two = fmu.description.flags, fmu.description.fmi == "2.0"
    save = "canGetAndSetFMUstate" if two else "canGetAndSetFMUState"
    vary = "canHandleVariableCommunicationStepSize"
    if not flags.get(save):
        return f"cannot save its state ({save})"
    if not flags.get(vary) and fmu.description.states is None:
        return f"cannot do a step in halves ({vary})"
    clocks = fmu.clocked and any(v.type == "Clock" for v in fmu.description.variables)
    return "has clocks" if clocks else ""


def feedthrough(component: Component, *, start: bool = False) -> Mapping[str, frozenset[str]]:
    """The inputs on which outputs depend directly, as an FMU declares it.

    What is not declared is left out. `start`: in Initialization Mode.
    """
    fmu = fmu_of(component)
    if fmu is None:
        return {}
    known = fmu.description.dependencies[start]
    port = {v.name: g.name for g in fmu.groups.values() for v in g.variables}
    return {
        g.name: frozenset(port[name] for v in g.variables for name in known[v.name])
        for g in fmu.carried("output")
        if all(v.name in known for v in g.variables)
    }


def output_derivatives(
    component: Component, port: str, entry: int
) -> Mapping[str, list[float]] | None:
    """Derivatives of outputs by an entry of an input at the start, by the FMU's own function.

    In the units of both. None: it has none. Outputs that are given exactly there are left out.
    """
    fmu = stepped_fmu(component)
    flags = {} if fmu is None else fmu.description.flags
    names = ("providesDirectionalDerivative", "providesDirectionalDerivatives")
    if fmu is None or not any(flags.get(name) for name in names):
        return None
    known = fmu.groups[port]
    outputs = [
        g
        for g in fmu.carried("output")
        if g.first.type in REAL and g.first.initial != "exact" and g.first.causality == "output"
    ]
    if known.first.type not in REAL or not outputs:
        return None
    if len(known.references) == known.size:
        references, seed = known.references[entry : entry + 1], [1.0]
    else:  # an array of FMI 3.0
        references, seed = known.references, [float(i == entry) for i in range(known.size)]
    unknowns = [r for g in outputs for r in g.references]
    found = iter(fmu.instance.directional(unknowns, references, seed, sum(g.size for g in outputs)))
    return {g.name: [next(found) for _ in range(g.size)] for g in outputs}


def jumping_outputs(component: Component) -> frozenset[str]:
    """Outputs that an FMU declares as no continuous real numbers."""
    fmu = fmu_of(component)
    outputs = () if fmu is None else fmu.carried("output")
    return frozenset(
        g.name
        for g in outputs
        if g.first.type not in REAL or any(v.variability != "continuous" for v in g.variables)
    )


# ---- while it runs --------------------------------------------------------------------------


def begin_at(component: Component, t: float) -> None:
    """Initialize at `t` (s), which is passed to an FMU; a Python component gets it in its steps."""
    fmu = fmu_of(component)
    if fmu is not None:
        fmu.begin = t


def exit_initialization(component: Component) -> Outputs:
    """Let a component that drives an FMU leave Initialization Mode: outputs that are new."""
    return component.exit_initialization() if isinstance(component, FmuDriver) else {}


def ended_at_start(component: Component) -> float | None:
    """The time (s) if an FMU has ended the simulation in the events of its start."""
    fmu = stepped_fmu(component)
    return fmu.begin if fmu is not None and fmu.instance.has_ended() else None


def terminated_at(component: Component) -> float | None:
    """The time (s) at which an FMU ended the simulation by discarding a step; None: it did not."""
    fmu = stepped_fmu(component)
    asked = fmu is not None and fmu.description.states is None
    return fmu.instance.terminated() if fmu is not None and asked else None


def start_is_exact(component: Component) -> bool:
    """True if an FMU that has started can be started again, or from a saved state, to the bit."""
    fmu = stepped_fmu(component)
    return fmu is not None and fmu.ours


def save_state(component: Component) -> object:
    """The state of an FMU, for :func:`go_back` and :func:`free_state`."""
    fmu = stepped_fmu(component)
    assert fmu is not None
    return fmu.get_state()


def go_back(component: Component, state: object) -> None:
    """Continue an FMU from a state, as if nothing had been logged since."""
    fmu = stepped_fmu(component)
    assert fmu is not None
    fmu.set_state(state)
    fmu.instance.log.forget()


def free_state(component: Component, state: object) -> None:
    """Give back a state that was saved; Python's are collected."""
    fmu = stepped_fmu(component)
    if fmu is not None:
        assert isinstance(state, int)
        fmu.instance.free_state(state)


def serialized(component: Component) -> tuple[bytes, Mapping[str, list[str]]]:
    """The state of an FMU, and texts of its clocks as they were at their last ticks.

    Raises FmuError.
    """
    fmu = stepped_fmu(component)
    assert fmu is not None
    return fmu.instance.serialized(), fmu.instance.clocked_texts()


def set_serialized(component: Component, state: bytes, ticked: Mapping[str, list[str]]) -> None:
    """Continue an FMU from what :func:`serialized` gave for another instance. Raises FmuError."""
    fmu = stepped_fmu(component)
    assert fmu is not None
    fmu.instance.set_serialized(state)
    fmu.instance.set_clocked_texts(dict(ticked))


def logged(component: Component) -> Log | None:
    """The log of an FMU whose logging is on, else None."""
    fmu = stepped_fmu(component)
    return fmu.instance.log if fmu is not None and fmu.options.log else None


def numbered_texts(components: Iterable[Component]) -> NumberedTexts | None:
    """The texts that signals carry; None: there are no FMUs."""
    return next((fmu.numbered for fmu in map(stepped_fmu, components) if fmu is not None), None)


def texts(component: Component) -> Mapping[str, list[str]]:
    """String and Binary outputs as they stand, by name."""
    fmu = fmu_of(component)
    return {} if fmu is None else fmu.results()


def files(component: Component) -> Mapping[str, str]:
    """Text files, by name, that a component leaves in the folder of a run."""
    return component.files() if isinstance(component, FmuDriver) else {}


def log_text(component: Component) -> str:
    """The log text of the component, if it is an FMU with logging enabled."""
    fmu = fmu_of(component)
    return "" if fmu is None else fmu.log_text()


def close(
    components: Sequence[Component],
    failed: int,
    status: int,
    saved: Mapping[int, Sequence[int]] | None = None,
) -> None:
    """Free the FMUs, after a step of component `failed` returned `status`.

    `saved`: states that were saved, by the number of the component: they are freed before. After a
    fatal status the standard forbids every call to any instance of that FMU.
    """
    fmus = [x for x in map(fmu_of, components) if x is not None]
    broken = stepped_fmu(components[failed]) if status not in (OK, WARNING) else None
    if broken is not None:
        broken.instance.returned(status)
    fatal = {x.archive.sha256 for x in fmus if x.broken == FATAL}
    for number, states in (saved or {}).items():
        x = stepped_fmu(components[number])
        if x is not None and x.broken == OK and x.archive.sha256 not in fatal:
            for state in states:
                x.instance.free_state(state)
    for x in fmus:
        alone = x.remote is not None or x.sandboxed  # no memory in common with others
        x.close(abandon=x.archive.sha256 in fatal and not alone)


def fmus_in(components: Iterable[Component]) -> int:
    """Number of components that are FMUs."""
    return sum(map(is_fmu, components))
