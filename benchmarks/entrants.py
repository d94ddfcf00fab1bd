"""All candidates by name, as started in a separate process.

A request names a master, a case, a version of FMI and an action; see :func:`begin`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.cases import Case, Choice, standard
from benchmarks.containers import Container, in_ecos, in_engine, renault, rust
from benchmarks.fmpy_loop import Ring
from benchmarks.frameworks import Once, helics, mosaik
from benchmarks.ours import Ours
from benchmarks.peers import Absent, Ecos, Libcosim, imported
from benchmarks.race import Session
from cosim.base.clock import stopwatch
from cosim.schedule.plan import Plan


@dataclass(frozen=True, slots=True)
class Entrant:
    """`make`: plan, whether to record -> session; `share` of a block's ticks, by what it costs."""

    name: str
    make: Callable[[Plan, bool], Session]
    share: float = 1.0
    records: bool = True


def _ours(plan: Plan, recorded: bool) -> Session:
    return Ours(plan, plan.ticks if recorded else 0)


def _missing(module: str, why: str, plan: Plan, recorded: bool) -> Session:
    """A peer that could not be installed where this was written, so there is no session of it."""
    try:
        imported(module)
    except Absent as absent:
        raise Absent(why) from absent
    raise Absent("is installed, but nothing here knows how to run it")


#: What pip says where this was written.
NO_PYFMI = "no wheel on PyPI; needs FMI Library"
NO_OMSIMULATOR = "no wheel on PyPI; fetches its own"
ENTRANTS = (
    Entrant("engine", _ours),
    Entrant("FMPy container, one call", partial(Container, build=rust, together=True),
            records=False),
    Entrant("fmucontainer, one call", partial(Container, build=renault, together=True),
            records=False),
    Entrant("FMPy container, in the engine", partial(in_engine, build=rust)),
    Entrant("fmucontainer, in the engine", partial(in_engine, build=renault)),
    Entrant("FMPy container, in Ecos", partial(in_ecos, build=rust), 0.5),
    Entrant("fmucontainer, in Ecos", partial(in_ecos, build=renault), 0.5),
    Entrant("FMPy container", partial(Container, build=rust), 0.5),
    Entrant("fmucontainer", partial(Container, build=renault), 0.5),
    Entrant("Ecos", Ecos, 0.5),
    Entrant("FMPy", Ring, 0.05),
    Entrant("libcosim", Libcosim, 0.05),
    Entrant("HELICS", partial(Once, prepare=helics), 0.02),
    Entrant("mosaik", partial(Once, prepare=mosaik), 0.02),
    Entrant("PyFMI", partial(_missing, "pyfmi", NO_PYFMI), records=False),
    Entrant("OMSimulator", partial(_missing, "OMSimulator", NO_OMSIMULATOR),
            records=False),
)  # fmt: skip


def entrant(name: str) -> Entrant:
    """By name."""
    return next(e for e in ENTRANTS if e.name == name)


def peer_cases(scale: float) -> list[Case]:
    """1, 2 and 12 coupled, and the wide ones: the standard cases without links."""
    return standard(scale)[:4]


def begin(request: dict[str, Any]) -> tuple[Session | None, dict[str, Any]]:
    """Make the session that a request describes; `startup` instead times up to the first step.

    Keys: `entrant`, `case`, `fmi`, `ticks`, `recorded`, and `paths` of FMUs for `startup`.
    """
    case = next(c for c in peer_cases(1.0) if c.name == request["case"])
    choice: Choice = request["fmi"]
    if "paths" in request:
        return None, startup(request["entrant"], case, request["paths"])
    if request["entrant"] == "":  # the process as it is before anybody starts
        case.plan(choice, 1)
        return None, {}
    plan = case.plan(choice, request["ticks"])
    return entrant(request["entrant"]).make(plan, request["recorded"]), {}


def startup(name: str, case: Case, paths: list[str]) -> dict[str, Any]:
    """Seconds from FMU files that lie in every cache there is to the end of the first step.

    The peers get the wires as they come out of a plan and import their own packages in that
    time; the engine reads the scenario and makes the plan in it.
    """
    from cosim.scenario.assemble import assemble
    from cosim.scenario.spec import build

    document = case.document()
    for spec, path in zip(document["components"].values(), paths, strict=True):
        spec["model"] = path
    place = Path(paths[0]).with_name("ring.toml")
    if name == "engine":
        watch = stopwatch()
        scenario = build(document, place)
        read = watch()
        plan = assemble(scenario)
        wired = watch()
        session: Session = Ours(plan)
        started = watch()
        session.run(1)
        stages = {"scenario": read, "plan": wired - read, "engine": started - wired}
        return {"seconds": watch(), "stages": stages}
    plan = assemble(build(document, place))
    watch = stopwatch()
    session = entrant(name).make(plan, False)
    session.run(1)
    return {"seconds": watch()}
