"""Abilities of importers, each asked of every one that installs: cells of peers.md.

A probe runs a test FMU or SSP in a peer and says "yes", or "no" with what was seen.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import exp
from pathlib import Path

from tests.cosim.fmi.exporter import events3, exchange2, exchange3, export, nasty2, strict2, strict3
from tests.cosim.fmi.test_calls import ENDS as ASKS
from tests.cosim.fmi.test_calls import ERROR, FATAL, IGNORES, JUMPS, LATER, RETURNS
from tests.cosim.fmi.test_old import old1, written
from tests.cosim.fmi.test_scheduled import scheduled3
from tests.fmi.peers import Outcome, outcome
from tests.fmi.runs import judged
from tests.fmi.watch import Call, calls, watched
from tests.ssp import parts

GROWS, CRASH = 1, 1
H = 0.125
Probe = Callable[[str, Path], str]


@dataclass(frozen=True, slots=True)
class Ability:
    """A row: what is asked, how, our test of it, and what others' documentation says of them."""

    title: str
    probe: Probe
    test: str
    read: tuple[str, str] = ("", "")  # OMSimulator, MasterSim


class Run:
    """One FMU in one peer, with the calls that it got."""

    def __init__(
        self, peer: str, folder: Path, text: str, values: Mapping[str, float], output: str,
        steps: int = 8, h: float = H,
    ) -> None:  # fmt: skip
        self.fmu = export(text, folder / "plain.fmu")
        path, log = watched(self.fmu, folder / "x.fmu"), folder / "calls"
        log.write_text("")
        self.outcome: Outcome = outcome(peer, path, steps, h, values, [output], log)
        self.calls: list[Call] = calls(log)
        self.output, self.steps = output, steps

    @property
    def wrong(self) -> str:
        """The reason for which it did not run, "" if it did."""
        if self.outcome.status < 0:
            return "no: the process ends"
        stepped = any(c.name in ("DoStep", "SetTime", "ActivateModelPartition") for c in self.calls)
        return "no" if self.outcome.error or not stepped else ""

    def gives(self, value: float, within: float = 1e-9) -> str:
        """True if the last output has this value."""
        found = self.outcome.last(self.output)
        return self.wrong or ("yes" if abs(found - value) <= within else f"no: {found:.4g}")

    def in_order(self) -> str:
        """True if the calls are those that the state machine allows."""
        if self.outcome.status < 0:
            return "no: the process ends"
        found = [x for x in judged(self.calls, self.fmu) if "was not freed" not in x]
        return "no: " + found[0].partition(", ")[2].partition("{")[0] if found else "yes"


def runs(text: str, output: str, value: float, within: float = 1e-9, **values: float) -> Probe:
    """True if an FMU runs, and its last output has this value after 1 s."""

    def probe(peer: str, folder: Path) -> str:
        return Run(peer, folder, text, values, output).gives(value, within)

    return probe


def ordered(text: str, **values: float) -> Probe:
    def probe(peer: str, folder: Path) -> str:
        return Run(peer, folder, text, values, "y").in_order()

    return probe


def first_row(peer: str, folder: Path) -> str:
    found = Run(peer, folder, strict2(), {"how": JUMPS, "gain": 5.0}, "y")
    rows = found.outcome.rows.get("y", [])
    if len(rows) == found.steps:
        return "no row at the start"
    return found.wrong or ("yes" if rows[0] == 5.0 else f"no: {rows[0]:g} for 5")


def noticed(peer: str, folder: Path) -> str:
    found = Run(peer, folder, strict2(), {"how": IGNORES, "gain": 5.0}, "y").outcome
    return "yes" if found.error else "no"


def ended(peer: str, folder: Path) -> str:
    found = Run(peer, folder, strict2(), {"how": ASKS, "when": 0.5}, "y")
    return found.wrong or ("no: an error" if not found.outcome.good else found.in_order())


def exact_time(peer: str, folder: Path) -> str:
    found = Run(peer, folder, strict2(), {}, "y", steps=20_000, h=0.01)
    times = [c.said["currentCommunicationPoint"] for c in found.calls if c.name == "DoStep"]
    apart = max((abs(t - k * 0.01) for k, t in enumerate(times)), default=float("inf"))
    return found.wrong or ("yes" if apart < 1e-12 else f"no: {apart:.0e} s off")


def tolerance(peer: str, folder: Path) -> str:
    experiment = '<DefaultExperiment tolerance="1e-05"/><ModelVariables>'
    text = strict2().replace("<ModelVariables>", experiment)
    found = Run(peer, folder, text, {}, "y")
    setup = [c.said for c in found.calls if c.name == "SetupExperiment"]
    given = bool(setup) and setup[0]["toleranceDefined"] and setup[0]["tolerance"] == 1e-5
    return found.wrong or ("yes" if given else "no")


def crash(peer: str, folder: Path) -> str:
    own = {"components.nasty2.isolate": "true"} if peer == "cosim" else {}
    path = watched(export(nasty2(), folder / "plain.fmu"), folder / "x.fmu")
    found = outcome(peer, path, 8, H, {"how": CRASH, "when": 0.5, **own}, ["y"])  # type: ignore[dict-item]
    return "yes" if found.error and found.status == 0 else "no: the process ends"


def old(peer: str, folder: Path) -> str:
    found = outcome(peer, written(old1(), folder / "x.fmu"), 8, H, {"u": 1.0, "gain": 2.0}, ["y"])
    if found.status < 0:
        return "no: the process ends"
    last = found.last("y")
    return (
        "no" if found.error else "yes" if abs(last - 2.0 + exp(-1.0)) < 1e-9 else f"no: {last:.4g}"
    )


# ---- SSP ------------------------------------------------------------------------------------

IO = {"u": "input", "y": "output"}
RATE = parts.bindings(parts.embedded({"rate": "1"})).replace('name="set"', 'name="initialValues"')


def system(
    peer: str, folder: Path, first: str, second: str, wires: str, name: str, value: float,
    units: tuple[str, str] = ("", ""),
) -> str:  # fmt: skip
    """True if a system of two FMUs gives this value of an output after 1 s."""
    text = strict2()
    out, into = (f'<Real unit="{u}"' if u else "<Real" for u in units)
    head, tail = text.split('name="y"')
    fmus = {
        "resources/a.fmu": export(
            head + 'name="y"' + tail.replace("<Real", out, 1), folder / "a.fmu"
        ),
        "resources/b.fmu": export(text.replace("<Real", into, 1), folder / "b.fmu"),
    }
    inside = (
        f"<ssd:Elements>{first}{second}</ssd:Elements><ssd:Connections>{wires}</ssd:Connections>"
    )
    for fmu in fmus.values():
        watched(fmu, copy := fmu.with_suffix(".copy"))
        copy.replace(fmu)
    path = parts.pack(folder / "x.ssp", parts.ssd(inside), fmus=fmus)
    found = outcome(peer, path, 8, H, {}, [name])
    if found.status < 0:
        return "no: the process ends"
    last = found.last(name)
    return "no" if found.error else "yes" if abs(last - value) < 1e-9 else f"no: {last:.4g}"


KIND = 'type="application/x-fmu-sharedlibrary"'


def one(name: str, inside: str = "") -> str:
    """A component; FMPy needs a connection to every input connector, so `a` has none."""
    kinds = {"y": "output"} if name == "a" else IO
    return parts.part(name, f"resources/{name}.fmu", inside, KIND, **kinds)


def integral(u: float) -> float:
    """The output of b after 1 s, fed with a constant: 1 + 2 u."""
    return 1.0 + 2.0 * u


def ssp_values(peer: str, folder: Path) -> str:
    return system(peer, folder, one("a", RATE), one("b"), parts.wire("a.y", "b.u"), "a.y", 2.0)


def ssp_nested(peer: str, folder: Path) -> str:
    ports = parts.connector("y", "output")
    inner = (
        f'<ssd:System name="box"><ssd:Connectors>{ports}</ssd:Connectors><ssd:Elements>'
        f"{one('a')}</ssd:Elements><ssd:Connections>{parts.wire('a.y', '.y')}</ssd:Connections>"
        "</ssd:System>"
    )
    return system(peer, folder, inner, one("b"), parts.wire("box.y", "b.u"), "b.y",
                  integral(1.0))  # fmt: skip


def ssp_transformation(peer: str, folder: Path) -> str:
    line = parts.wire("a.y", "b.u", '<ssc:LinearTransformation factor="2" offset="1"/>')
    return system(peer, folder, one("a"), one("b"), line, "b.y", integral(3.0))


def ssp_units(peer: str, folder: Path) -> str:
    return system(peer, folder, one("a"), one("b"), parts.wire("a.y", "b.u"), "b.y",
                  integral(100.0), ("m", "cm"))  # fmt: skip


ABILITIES = (
    Ability("FMI 1.0, co-simulation", old, "tests/cosim/fmi/test_old.py", ("no", "yes")),
    Ability("FMI 2.0, co-simulation", runs(strict2(), "y", 2.0, rate=1.0),
            "tests/cosim/fmi/test_calls.py", ("yes", "yes")),
    Ability("FMI 3.0, co-simulation", runs(strict3(), "y", 2.0, rate=1.0),
            "tests/cosim/fmi/test_calls.py", ("yes", "no")),
    Ability("FMI 2.0, model exchange", runs(exchange2(), "x0", 2.3198, 1e-2, model=GROWS),
            "tests/cosim/fmi/test_exchange.py", ("yes", "no")),
    Ability("FMI 3.0, model exchange", runs(exchange3(), "x0", 2.3198, 1e-2, model=GROWS),
            "tests/cosim/fmi/test_exchange.py", ("yes", "no")),
    Ability("FMI 3.0, scheduled execution", runs(scheduled3(), "y", 0.0, 1e9),
            "tests/cosim/fmi/test_scheduled.py", ("no: the process ends", "no")),
    Ability("events and clocks in co-simulation (FMI 3.0)",
            runs(events3('intervalVariability="constant" intervalDecimal="0.25"'), "ticks", 4.0),
            "tests/cosim/fmi/test_clocks.py", ("no", "no")),
    Ability("start values that the FMU resets on entering Initialization Mode",
            runs(strict2(), "y", 7.0, how=LATER, x=7.0), "tests/cosim/fmi/test_calls.py"),
    Ability("a parameter that the FMU does not take is an error", noticed,
            "tests/cosim/fmi/test_calls.py"),
    Ability("the first row is that after initialization", first_row,
            "tests/cosim/fmi/test_calls.py"),
    Ability("the tolerance of the DefaultExperiment is handed over", tolerance,
            "tests/cosim/fmi/test_calls.py"),
    Ability("no call that FMI 2.0 does not allow", ordered(strict2(), gain=3.0, rate=1.0),
            "tests/fmi/test_order.py"),
    Ability("nor after an error", ordered(strict2(), how=RETURNS, status=ERROR, when=0.5),
            "tests/fmi/test_order.py"),
    Ability("nor after a fatal one", ordered(strict2(), how=RETURNS, status=FATAL, when=0.5),
            "tests/fmi/test_order.py"),
    Ability("an FMU that ends the simulation", ended, "tests/cosim/fmi/test_ended.py"),
    Ability("the time of each of 20 000 steps is exact", exact_time,
            "tests/fmi/test_peers_page.py", ("no: adds up", "no: adds up")),
    Ability("a crash of an FMU is a message", crash, "tests/cosim/fmi/test_bad_behaviour.py"),
    Ability("SSP 1.0: parameter sets", ssp_values, "tests/ssp/test_read.py", ("yes", "no SSP")),
    Ability("SSP 1.0: systems in systems", ssp_nested, "tests/ssp/test_read.py",
            ("yes", "no SSP")),
    Ability("SSP 1.0: linear transformations", ssp_transformation, "tests/ssp/test_read.py",
            ("", "no SSP")),
    Ability("SSP 1.0: conversion of units", ssp_units, "tests/ssp/test_published.py",
            ("", "no SSP")),
)  # fmt: skip
