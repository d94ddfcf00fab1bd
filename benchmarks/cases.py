"""What is stepped: small networks of FMUs, and the teleoperator, as scenarios.

A case can be had with every *choice* of what a component is: an FMU of FMI 2.0 or 3.0, the C
kernel called from Python, or the NumPy reference.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario, build
from cosim.schedule.plan import Plan

Choice = Literal["fmi2", "fmi3", "kernel", "numpy"]
Document = dict[str, Any]

CHOICES: dict[Choice, str] = {
    "fmi2": "FMU, FMI 2.0",
    "fmi3": "FMU, FMI 3.0",
    "kernel": "C kernel called from Python",
    "numpy": "NumPy reference in Python",
}
TELEOPERATION = Path(__file__).parents[1] / "configs" / "teleoperation.toml"
_REFERENCE = {
    "benchmarks.models.vdp": "VanDerPol",
    "benchmarks.models.wide": "Wide",
    "fmus.models.planar2r": "Planar2R",
    "fmus.models.teleoperation": "Teleoperation",
}


@dataclass(frozen=True, slots=True)
class Case:
    """`fmu_steps`: FMU steps a tick, on average; `ticks`: in one timed block of a C loop."""

    name: str
    title: str
    document: Callable[[], Document]
    fmu_steps: float
    ticks: int

    def scenario(self, choice: Choice, ticks: int | None = None) -> Scenario:
        """The case as a scenario of `ticks` ticks (default: as many as the document says)."""
        document = self.document()
        for spec in document["components"].values():
            spec.update(_chosen(spec["model"], choice))
        if ticks is not None:
            step = document["run"]["step"]
            h = step if isinstance(step, float) else float(step.partition(" ")[0]) / 1e3
            document["run"]["stop"] = ticks * h
        return build(document, TELEOPERATION.parent / f"{self.name}.toml")

    def plan(self, choice: Choice, ticks: int | None = None) -> Plan:
        """The case as a plan; every call makes new components."""
        return assemble(self.scenario(choice, ticks))


def _chosen(module: str, choice: Choice) -> Document:
    if choice == "kernel":
        return {"model": f"{module}:kernel"}
    if choice == "numpy":
        return {"model": f"{module}:{_REFERENCE[module]}"}
    return {"model": module, "fmi": "2.0" if choice == "fmi2" else "3.0"}


def _network(components: Document, links: list[Document] | None = None) -> Document:
    # 1/128 s and its multiples are exact in binary and in ns: masters that add up or subtract
    # times come to the same numbers as those that count ticks.
    return {
        "run": {"step": 1 / 128, "stop": 1000.0},
        "components": components,
        "links": links or [],
    }


def vdp_ring(n: int) -> Document:
    """`n` oscillators, each driven by the one before; alone, one is not driven at all."""
    components: Document = {}
    for i in range(n):
        spec: Document = {"model": "benchmarks.models.vdp", "start": {"x": 2.0 - 0.1 * i}}
        if n > 1:
            spec["inputs"] = {"u": f"f{(i - 1) % n:02}.x"}
        components[f"f{i:02}"] = spec
    return _network(components)


def wide_ring(n: int = 4) -> Document:
    """`n` FMUs with 14 inputs and 14 outputs; gains of 2 and 1/2 take turns."""
    components: Document = {}
    for i in range(n):
        start = [0.1 + j + 20 * i for j in range(14)]
        components[f"f{i:02}"] = {
            "model": "benchmarks.models.wide",
            "start": {"y": start},
            "parameters": {"gain": 2.0 if i % 2 else 0.5},
            "inputs": {"u": f"f{(i - 1) % n:02}.y"},
        }
    return _network(components)


def delayed(document: Document, port: str, source: str, scalars: int) -> Document:
    """The same network with a time-varying delay on every connection.

    0.05 s + U[0, 0.2] s, redrawn every 30 ms. `scalars`: links a connection, one a scalar; 0: one
    link that carries all of them.
    """
    links = []
    delay = {"law": "uniform", "low": 0.05, "high": 0.25, "hold": 0.03}
    for name, spec in document["components"].items():
        origin = spec.pop("inputs")[port].partition(".")[0]
        for index in [f"[{i}]" for i in range(scalars)] or [""]:
            ends = {"from": f"{origin}.{source}{index}", "to": f"{name}.{port}{index}"}
            links.append({**ends, "delay": delay, "semantics": "signal"})
    return {**document, "links": links}


def teleoperation() -> Document:
    """The scenario that `cosim run configs/teleoperation.toml` runs."""
    return tomllib.loads(TELEOPERATION.read_text(encoding="utf-8"))


def rings(n: int, ticks: int, title: str = "") -> Case:
    """A ring of `n` oscillators."""
    return Case(f"ring{n}", title or f"{n} in a ring", lambda: vdp_ring(n), n, ticks)


def standard(scale: float = 1.0) -> list[Case]:
    """The cases of the main table; `scale` shortens all of them."""

    def ticks(n: int) -> int:
        return max(60, round(scale * n))

    return [
        rings(1, ticks(25_000), "1 FMU"),
        rings(2, ticks(15_000), "2 coupled"),
        rings(12, ticks(3_000)),
        Case("wide4", "4 in a ring, 14 in + 14 out", wide_ring, 4, ticks(5_000)),
        Case("teleoperation", "teleoperation", teleoperation, 2 + 2 / 5, ticks(2_500)),
    ]
