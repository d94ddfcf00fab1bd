"""Plants that wires connect: algebraic loops in a run, and lines that lose their order."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, inf, log

from cosim.base.errors import CosimError
from cosim.checks import Finding
from cosim.engine.engine import Engine
from cosim.engine.plant_loops import PlantLoop, possible_loops
from cosim.predict.system import AnalyzedSystem

#: A difference that counts as gone, as a share, and a factor that is 0 but for rounding.
GONE, NONE = 0.01, 1e-6


def coupled(system: AnalyzedSystem) -> Iterator[Finding]:
    """Loops of outputs that depend on each other at once, and lines through such outputs.

    Both follow from the start of the plants, which is made of components of its own, and only where
    wires may close a circle or a line is asked for.
    """
    plan = system.plan
    if not possible_loops(plan) and not any(step.extrapolate for step in plan.components):
        return
    from cosim.scenario.assemble import assemble

    with Engine(assemble(system.scenario)) as engine:
        try:
            engine.initialize()
        except CosimError as error:
            yield Finding(
                rule="algebraic-loop", severity="error", where="run", number=inf, unit="1",
                reason=f"the plants do not start: {error}",
            )  # fmt: skip
            return
        yield from (_loop(loop) for loop in engine.loops if loop.factor > NONE)
        yield from (_late(name) for name in engine.late)


def _loop(loop: PlantLoop) -> Finding:
    steps = max(1, ceil(log(GONE) / log(loop.factor)))
    return Finding(
        rule="algebraic-loop",
        severity="warning",
        where=", ".join(sorted({w.source.component for w in loop.wires})),
        number=loop.factor,
        unit="1",
        reason=f"{loop.sentence}, so that what is left of a change is below 1 % after {steps} of"
        " them",
        advice='use algorithm = "adaptive", which solves the loop at the end of each step, or a'
        " smaller step",
    )


def _late(name: str) -> Finding:
    return Finding(
        rule="late-output",
        severity="warning",
        where=name,
        number=0.5,
        unit="1",
        reason="it depends directly on an input that takes the mean of a line over a step, so it is"
        ' half a step old: the coupling has order 1, as without extrapolate = "linear"',
        advice='use algorithm = "adaptive", which has order 2 here, or a smaller step',
    )
