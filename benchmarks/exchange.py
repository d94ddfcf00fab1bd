"""FMUs for model exchange here and in FMPy: ``python benchmarks/exchange.py X.fmu [--set m=2]``.

One FMU, the same communication steps, in turns: with each solver of the engine, in FMPy with its
two solvers, and by co-simulation where the FMU has that interface too. The table gives the least
processor time of all turns, from the instance to its end, without reading files; how far each final
value is from that of CVODE with the tolerance 1e-12; and what the engine evaluated.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import fmpy

from cosim.base.errors import RunError
from cosim.engine.engine import Engine
from cosim.fmi import FmuComponent
from cosim.native import structs
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build

EXCHANGE = {"kind": "model exchange"}
#: The keys of a component for each solver of the engine.
OURS: tuple[Mapping[str, object], ...] = (
    *({**EXCHANGE, "solver": solver} for solver in ("euler", "heun", "rk4")),
    {**EXCHANGE, "solver": "cvode", "tolerance": 1e-6},
)
REFERENCE: Mapping[str, object] = {**EXCHANGE, "solver": "cvode", "tolerance": 1e-12}


def ours(
    path: Path,
    output: str,
    step: float,
    stop: float,
    given: Mapping[str, float],
    keys: Mapping[str, object],
) -> tuple[float, float, str]:
    """Processor time (s), the final value of `output`, and what was evaluated."""
    component = {"model": str(path), **keys, "parameters": dict(given)}
    document = {"run": {"step": step, "stop": stop}, "components": {"x": component}}
    plan = assemble(build(document, Path("benchmark.toml").absolute()))
    start = time.process_time()
    with Engine(plan) as engine:
        engine.initialize()
        try:
            engine.run(plan.ticks)
        except RunError as error:
            return time.process_time() - start, float("nan"), str(error)
        slot = plan.slots()[f"x.{output}"]
        value, unit = float(engine.signals[slot.start]), engine.state.units
        count = _evaluated(structs.UnitStruct.from_address(unit or 0))
    return time.process_time() - start, value, count


def _evaluated(unit: structs.UnitStruct) -> str:
    if not unit.exchange:
        return ""
    x = structs.ExchangeStruct.from_address(unit.exchange)
    return f"{x.steps} steps, {x.evaluations} derivatives, {x.events} events"


def theirs(
    path: Path, output: str, step: float, stop: float, given: Mapping[str, float], solver: str
) -> tuple[float, float, str]:
    """The same by FMPy: ``Euler`` with steps of `step` (s), or ``CVode`` with 1e-6."""
    folder = fmpy.extract(str(path))
    description = fmpy.read_model_description(folder, validate=False)
    start = time.process_time()
    rows = fmpy.simulate_fmu(
        folder, model_description=description, validate=False, fmi_type="ModelExchange",
        solver=solver, step_size=step, relative_tolerance=1e-6, stop_time=stop,
        output_interval=step, start_values=dict(given), output=[output],
    )  # fmt: skip
    return time.process_time() - start, float(rows[output][-1]), ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("fmu", type=Path)
    parser.add_argument("--output", help="default: the first")
    parser.add_argument("--step", type=float, default=0.01, help="s (%(default)s)")
    parser.add_argument("--stop", type=float, default=10.0, help="s (%(default)s)")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("--turns", type=int, default=5)
    asked = parser.parse_args()
    path = asked.fmu.absolute()
    given = {name: float(value) for name, _, value in (x.partition("=") for x in asked.set)}
    output = asked.output or FmuComponent(path).outputs[0].name
    case = (path, output, asked.step, asked.stop, given)
    entrants: dict[str, Callable[[], tuple[float, float, str]]] = {
        f"engine, {keys['solver']}": partial(ours, *case, keys) for keys in OURS
    }
    for solver in ("Euler", "CVode"):
        entrants[f"FMPy, {solver}"] = partial(theirs, *case, solver)
    if FmuComponent(path).description.interfaces[0] == "CoSimulation":
        entrants["engine, co-simulation"] = partial(ours, *case, {"kind": "continuous"})
    exact = ours(*case, REFERENCE)[1]
    least = {name: min(run() for _ in range(asked.turns)) for name, run in entrants.items()}
    print(f"{path.name}, {asked.stop:g} s in steps of {asked.step:g} s, {output} = {exact:.12g}")
    for name, (seconds, value, count) in least.items():
        print(f"{name:24}{1e3 * seconds:10.2f} ms{abs(value - exact):12.1e}  {count}")


if __name__ == "__main__":
    main()
