"""The whole analysis of a port: numbers of a run, and of test forces, with curves to draw."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from cosim.analysis.analyzed_port import Subject
from cosim.analysis.conditions import unmet_conditions
from cosim.analysis.contacts import by_grip, by_wall, margin
from cosim.analysis.experiments import LOWEST, Bench, rest_position
from cosim.analysis.force_tests import (
    PortSweep,
    by_frequency,
    by_push,
    felt_free,
    sweep,
    with_known,
)
from cosim.analysis.predicted import MANY, predicted
from cosim.analysis.quantity import Quantity, absent
from cosim.analysis.recorded_numbers import least_feedback, numbers
from cosim.analysis.recorded_port import RecordedPort
from cosim.base.copies import field_names, replace
from cosim.base.errors import CosimError
from cosim.predict import closed_form as closed
from cosim.predict.elimination import quick_rows
from cosim.predict.facts import Array
from cosim.predict.network import RobotNetwork, network
from cosim.predict.port import PortSignals
from cosim.predict.system import AnalyzedSystem


@dataclass(frozen=True, slots=True)
class Analysis:
    """The results: `quantities` in two groups, and the data of the figures.

    `bound`: O6 at times (n,), s, if it is known and its conditions hold; `swept`: the port
    by frequency; `tested`: whether forces were applied, or `tests` are closed forms alone;
    `remarks`: parts that were not possible, with reasons.
    """

    title: str
    port: PortSignals
    run: tuple[Quantity, ...]
    tests: tuple[Quantity, ...]
    recorded: RecordedPort
    bound: Callable[[Array], Array] | None
    swept: tuple[PortSweep, ...] = ()
    remarks: tuple[str, ...] = field(default=())
    tested: bool = True

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """All of them."""
        return (*self.run, *self.tests)

    def as_data(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "title": self.title,
            "port": {name: getattr(self.port, name) for name in field_names(self.port)},
            "run": [q.as_data() for q in self.run],
            "tests": [q.as_data() for q in self.tests],
            "gain": [_gain(s) for s in self.swept],
            "remarks": list(self.remarks),
        }


def _gain(swept: PortSweep) -> dict[str, Any]:
    return {
        "title": swept.title,
        "omega": swept.measured.omega.tolist(),
        "gain": swept.measured.size.tolist(),
        "real_part": swept.measured.real_part().tolist(),
        "gain_closed": swept.closed.size.tolist() if swept.closed else None,
    }


#: What is said where test forces were left out.
_UNTESTED = (
    f"no test forces: an hour or so of simulated time with more than {MANY} components; --tests"
    " applies them all the same"
)


def analyse(
    subject: Subject,
    *,
    tests: bool | None = None,
    lowest: float = LOWEST,
    progress: Callable[[str], None] = lambda what: None,
) -> Analysis:
    """Compute all results about a port.

    Without a system there are no closed forms and no tests. `tests`: whether test forces are
    applied; None: unless there are more than MANY components, which leaves their closed forms.
    `lowest`: frequency of the slowest test force, rad/s; `progress` is called with the name of each
    next step. Raises ScenarioError for signals that were not recorded.
    """
    port, known, remarks = subject.port, subject.system, list(subject.remarks)
    recorded = RecordedPort(subject.signals, port)
    net, hand = None, None
    if known is not None and known.is_position(port.response):
        net = network(known, port.arm)
        hand = known.hand(port.arm) if port.arm in known.arms else None
    if known is not None:
        remarks += [f"{name}: its facts failed: {why}" for name, why in known.silent.items()]
    missed = unmet_conditions(known, net) if known is not None and net is not None else ()
    if net is not None and len(net.names) > 1 and not recorded.mean:
        missed += ("recorded positions of all robots",)
    if net is not None and len(net.names) * recorded.size > quick_rows():
        remarks.append(
            f"no gain, and no closed forms by frequency: {len(net.names)} robots would take minutes"
            f" (more than {quick_rows()} coordinates)"
        )
        net, missed = None, ()
    applied = tests if tests is not None else known is None or _few(known)
    swept: list[PortSweep] = []
    tested: Iterator[Quantity] = iter(())
    if known is not None and applied and not port.inject:
        remarks.append("no test forces: no input for them is named ([analysis] inject)")
    elif known is not None and port.inject and tests is not False:
        bench = Bench(known, port, rest_position(known, port, recorded.final()))
        tested = _tests(bench, lowest, swept, progress) if applied else predicted(bench, lowest)
    if not applied and tests is None:
        remarks.append(_UNTESTED)
    found = tuple(tested)
    return Analysis(
        title=subject.title,
        port=port,
        run=tuple(numbers(recorded, net, hand, missed)),
        tests=found,
        recorded=recorded,
        bound=None if missed else _bound(net),
        swept=tuple(swept),
        remarks=tuple(remarks),
        tested=applied,
    )


def _few(system: AnalyzedSystem) -> bool:
    """True if a system can be simulated for an hour or so within a minute."""
    return len(system.plan.components) <= MANY


def _bound(net: RobotNetwork | None) -> Callable[[Array], Array] | None:
    if net is None:
        return None
    return lambda t: closed.manipulability_bound(net, t, least_feedback(net))


def _tests(
    bench: Bench, lowest: float, swept: list[PortSweep], progress: Callable[[str], None]
) -> Iterator[Quantity]:
    benches = [b for b in (bench, with_known(bench)) if b is not None]
    for b in benches:
        progress("port by frequency")
        try:
            one = sweep(b, lowest)
        except CosimError as error:
            how = "test forces of many frequencies"
            yield absent("degree", "degree of manipulability", "1", how, str(error))
            continue
        swept.append(one)
        yield from by_frequency(one, b)
    progress("constant push")
    settable = bench.network is not None and bool(bench.network.law.estimate)
    pushed = list(by_push(replace(bench, known=settable)))
    yield from pushed
    yield from margin(bench)
    if bench.arm is not None:
        progress("stiffest grip")
        for b in benches:
            yield from by_grip(b)
    progress("wall")
    yield from by_wall(bench, felt_free(pushed))
