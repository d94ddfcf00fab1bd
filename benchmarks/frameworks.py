"""Frameworks for simulators of any kind: mosaik and HELICS, one simulator or federate an FMU.

Their FMUs are ours (:mod:`benchmarks.adapter`), so what is measured is the framework. Both run a
whole experiment and end: a session starts its FMUs anew in every block, as `simulate` does, and
times the run only. Every exchange is as `algorithm = "jacobi"` has it.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from threading import Barrier, Thread
from typing import Any, final

from benchmarks.adapter import Stepper, Steppers
from benchmarks.peers import Absent, Unit, imported, units
from cosim.base.clock import stopwatch
from cosim.schedule.plan import Plan


@final
class Simulator:
    """What mosaik calls: one FMU as a simulator with one entity; the tick is mosaik's step."""

    def __init__(self) -> None:
        self.mosaik: Any = None

    def init(self, sid: str, time_resolution: float = 1.0, **options: Any) -> dict[str, Any]:
        """Options: `stepper`, `h` (s), and names of inputs and outputs."""
        self._stepper, self._h = options["stepper"], options["h"]
        self._inputs, self._outputs = options["inputs"], options["outputs"]
        attributes = [*self._inputs, *self._outputs]
        return _meta({"Fmu": {"public": True, "params": [], "attrs": attributes}})

    def create(self, num: int, model: str) -> list[dict[str, Any]]:
        """The one entity."""
        return [{"eid": "fmu", "type": model}]

    def setup_done(self) -> None:
        """Nothing to do."""

    def step(self, time: int, inputs: dict[str, Any], max_advance: int) -> int:
        """One tick; returns the next."""
        found = inputs.get("fmu", {})
        self._stepper.step(
            time * self._h, [next(iter(found[name].values())) for name in self._inputs if found]
        )
        return time + 1

    def get_data(self, outputs: dict[str, list[str]]) -> dict[str, Any]:
        """The outputs asked for."""
        y = dict(zip(self._outputs, self._stepper.y, strict=True))
        return {eid: {name: y[name] for name in names} for eid, names in outputs.items()}

    def finalize(self) -> None:
        """Freed by the session."""

    stop = finalize


@final
class Collector:
    """What mosaik calls: keeps everything that is connected to it, a row a tick."""

    def __init__(self) -> None:
        self.mosaik: Any = None

    def init(self, sid: str, time_resolution: float = 1.0, **options: Any) -> dict[str, Any]:
        """Option: `rows`, the list to fill."""
        self._rows = options["rows"]
        return _meta({"Rows": {"public": True, "any_inputs": True, "params": [], "attrs": []}})

    def create(self, num: int, model: str) -> list[dict[str, Any]]:
        """The one entity."""
        return [{"eid": "rows", "type": model}]

    def setup_done(self) -> None:
        """Nothing to do."""

    def step(self, time: int, inputs: dict[str, Any], max_advance: int) -> int:
        """Keep a row."""
        self._rows.append([x for values in inputs["rows"].values() for x in values.values()])
        return time + 1

    def get_data(self, outputs: dict[str, list[str]]) -> dict[str, Any]:
        """Has none."""
        return {}

    def finalize(self) -> None:
        """Nothing to free."""

    stop = finalize


def _meta(models: dict[str, Any]) -> dict[str, Any]:
    return {"api_version": "3.0", "type": "time-based", "models": models, "extra_methods": []}


def _flat(unit: Unit) -> tuple[list[str], list[str]]:
    """Names of scalar inputs and outputs: an array is as many."""
    inputs, outputs = (
        [f"{v.name}.{i}" if v.size > 1 else v.name for v in variables for i in range(v.size)]
        for variables in (unit.inputs, unit.outputs)
    )
    return (inputs if unit.source is not None else []), outputs


Run = Callable[[], None]
Prepare = Callable[[list[Unit], Steppers, float, int, "list[Any] | None"], Run]


@final
class Once:
    """A session of what runs once: `prepare` gets units, FMUs, h (s), ticks, and rows to fill.

    What it returns is timed; FMUs and framework are new in every `run`.
    """

    def __init__(self, plan: Plan, recorded: bool, prepare: Prepare) -> None:
        self._plan, self._units, self._prepare = plan, units(plan), prepare
        self._recorded, self._y = recorded, list[list[float]]()

    def run(self, ticks: int) -> float:
        """Run `ticks` ticks from the start; returns s."""
        steppers = Steppers(self._plan)
        try:
            rows: list[Any] | None = [] if self._recorded else None
            go = self._prepare(self._units, steppers, self._plan.h, ticks, rows)
            watch = stopwatch()
            go()
            seconds = watch()
            self._y = [s.y for s in steppers.all]
        finally:
            steppers.close()
        return seconds

    def outputs(self) -> bytes:
        """The outputs of all FMUs as they are."""
        return b"".join(struct.pack(f"={len(y)}d", *y) for y in self._y)

    def recorded(self, n: int) -> bytes:
        """In a form of its own."""
        return b""

    def close(self) -> None:
        """Freed after every run."""


def mosaik(
    wired: list[Unit], steppers: Steppers, h: float, ticks: int, rows: list[Any] | None
) -> Run:
    """A mosaik world: outputs arrive one step later, with the initial ones first."""
    here = __name__
    config = {"Fmu": {"python": f"{here}:Simulator"}, "Rows": {"python": f"{here}:Collector"}}
    world = imported("mosaik").World(config, skip_greetings=True, configure_logging=False)
    names = [_flat(unit) for unit in wired]
    entities = []
    for unit, stepper, (inputs, outputs) in zip(wired, steppers.all, names, strict=True):
        options = {"stepper": stepper, "h": h, "inputs": inputs, "outputs": outputs}
        entities.append(world.start("Fmu", sim_id=unit.name, **options).Fmu())
    for unit, entity, (inputs, _) in zip(wired, entities, names, strict=True):
        if unit.source is not None:
            outputs, y = names[unit.source][1], steppers.all[unit.source].y
            world.connect(
                entities[unit.source], entity, *zip(outputs, inputs, strict=True),
                time_shifted=True, initial_data=dict(zip(outputs, y, strict=True)),
            )  # fmt: skip
    if rows is not None:
        collector = world.start("Rows", rows=rows).Rows()
        for unit, entity, (_, outputs) in zip(wired, entities, names, strict=True):
            world.connect(entity, collector, *((o, f"{unit.name}.{o}") for o in outputs))
    return lambda: world.run(until=ticks, print_progress=False)


def helics(
    wired: list[Unit], steppers: Steppers, h: float, ticks: int, rows: list[Any] | None
) -> Run:
    """A federate an FMU, each in a thread of this process, on one core of type inproc."""
    api = imported("helics")
    core = api.helicsCreateCore("inproc", "", f"--autobroker --federates={len(wired)}")
    info = api.helicsCreateFederateInfo()
    api.helicsFederateInfoSetCoreName(info, api.helicsCoreGetIdentifier(core))
    api.helicsFederateInfoSetCoreTypeFromString(info, "inproc")
    api.helicsFederateInfoSetTimeProperty(info, api.HELICS_PROPERTY_TIME_PERIOD, h)
    ready, failures = Barrier(len(wired) + 1, timeout=30), list[Exception]()
    federates = [
        _Federate(api, info, u, wired, s) for u, s in zip(wired, steppers.all, strict=True)
    ]

    def work(federate: _Federate) -> None:
        try:
            federate.start()
            ready.wait()
            federate.run(h, ticks, rows)
        except Exception as error:
            failures.append(error)
            ready.abort()

    threads = [Thread(target=work, args=(f,), daemon=True) for f in federates]
    for thread in threads:
        thread.start()

    def go() -> None:
        ready.wait()
        for thread in threads:
            thread.join()
        for federate in federates:
            federate.free()
        if failures:
            raise Absent(str(failures[0]).splitlines()[0])

    return go


@final
class _Federate:
    """One FMU in HELICS: at t it reads, steps, and publishes what holds from t + h on."""

    def __init__(
        self, api: Any, info: Any, unit: Unit, wired: list[Unit], stepper: Stepper
    ) -> None:
        self._api, self._stepper, self._input = api, stepper, None
        self._fed = api.helicsCreateValueFederate(unit.name, info)
        self._wide = len(stepper.y) > 1
        kind = api.HELICS_DATA_TYPE_VECTOR if self._wide else api.HELICS_DATA_TYPE_DOUBLE
        name = f"{unit.name}.y"
        self._out = api.helicsFederateRegisterGlobalPublication(self._fed, name, kind, "")
        if unit.source is not None:
            source = f"{wired[unit.source].name}.y"
            self._input = api.helicsFederateRegisterSubscription(self._fed, source, "")

    def _publish(self, y: list[float]) -> None:
        if self._wide:
            self._api.helicsPublicationPublishVector(self._out, y)
        else:
            self._api.helicsPublicationPublishDouble(self._out, y[0])

    def _read(self) -> list[float]:
        if self._input is None:
            return []
        if self._wide:
            return list(self._api.helicsInputGetVector(self._input))
        return [self._api.helicsInputGetDouble(self._input)]

    def start(self) -> None:
        """Publish the initial outputs and go to time 0."""
        self._api.helicsFederateEnterInitializingMode(self._fed)
        self._publish(self._stepper.y)
        self._api.helicsFederateEnterExecutingMode(self._fed)

    def run(self, h: float, ticks: int, rows: list[Any] | None) -> None:
        """`ticks` steps of `h` (s); each federate appends its own outputs to `rows`."""
        kept = list[list[float]]()
        for k in range(ticks):
            if rows is not None:
                kept.append(self._stepper.y)
            self._publish(self._stepper.step(k * h, self._read()))
            self._api.helicsFederateRequestTime(self._fed, (k + 1) * h)
        if rows is not None:
            rows.append(kept)

    def free(self) -> None:
        """Leave the federation."""
        self._api.helicsFederateDisconnect(self._fed)
        self._api.helicsFederateFree(self._fed)
