"""``cosim identify``: base parameters of an arm from a recorded run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from cosim.base.copies import asdict
from cosim.cli.options import Json, Quiet, write_json

if TYPE_CHECKING:
    from cosim.predict.inputs import RunWithInputs
    from cosim.record import Run
    from cosim.schedule.parts import Step
    from cosim.schedule.plan import Plan
    from fmus.arms.chain import Table
    from fmus.arms.identification import BaseParameter, Identified
    from fmus.model.numeric import Array

#: Condition number up to which a motion is usually called exciting.
_EXCITING = 100.0
#: Parameters of a combination that are printed.
_TERMS = 4


def identify(
    run: Annotated[Path, typer.Argument(help="Run folder of a scenario with a serial arm.")],
    component: Annotated[str, typer.Option(metavar="NAME", help="The arm (fmus.models.arm).")],
    q: Annotated[
        str,
        typer.Option(
            metavar="SIGNAL", help="Measured positions, e.g. encoder.q_m.", show_default="NAME.q"
        ),
    ] = "",
    cutoff: Annotated[
        float, typer.Option(min=0.01, max=1000.0, help="Use what is slower than this, Hz.")
    ] = 5.0,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Identify the base parameters of an arm from a recorded run, with intervals.

    Positions and torques are those of the run; the kinematics is that of its scenario. Parameters
    of the scenario are printed beside what the motion says.
    """
    from cosim.cli.summary import live_line

    _check_scipy()
    recorded = _recorded(run, component)
    table, before, v_f = _arm(recorded.plan.component(component), run)
    motion = _motion(recorded, component, q or f"{component}.q")
    with live_line(quiet) as say:
        from fmus.arms.identification import identified

        found = identified(table, before, v_f, motion, cutoff, say)
    if json is not None:
        _write(json, found)
    if not quiet:
        for line in report(found, component):
            typer.echo(line)


def _check_scipy() -> None:
    from importlib.util import find_spec

    from cosim.base.errors import RunError

    if find_spec("scipy") is None:
        raise RunError("cosim identify needs SciPy: pip install 'cosim-bridge[fit]'")


class _Recorded(NamedTuple):
    run: Run
    plan: Plan


def _recorded(folder: Path, component: str) -> _Recorded:
    from cosim.analysis.analyzed_port import stored_scenario
    from cosim.base.errors import ScenarioError
    from cosim.record import Run
    from cosim.scenario.assemble import assemble
    from cosim.scenario.connect import unknown

    run = Run.open(folder)
    plan = assemble(stored_scenario(run.metadata))
    names = [c.name for c in plan.components]
    if component not in names:
        raise ScenarioError(unknown(component, names, "component"), str(folder))
    return _Recorded(run, plan)


def _arm(step: Step, folder: Path) -> tuple[Table, Array, Array]:
    """(table, its 13 n parameters, v_f) of the arm in the scenario. Raises ScenarioError."""
    import numpy as np

    from cosim.base.errors import ScenarioError
    from cosim.predict.system import values_of
    from fmus.arms.chain import of_values

    shapes = {p.name: p.shape for p in step.component.parameters}
    if not {"inertia", "rotation", "v_f"} <= shapes.keys():
        raise ScenarioError(f"{step.name} is no fmus.models.arm; expected one", str(folder))
    given = values_of(step)
    values = {k: np.array(given[k], float).reshape(shapes[k]) for k in shapes}
    rest = [values[k] for k in ("armature", "damping", "friction")]
    return of_values(values), np.concatenate([values["inertia"].ravel(), *rest]), values["v_f"]


def _motion(recorded: _Recorded, component: str, q: str) -> tuple[Array, Array, Array]:
    """Times (k,), q (k, n), and torques (k, n) of motors, outside forces, grip and wall."""
    import numpy as np

    from cosim.predict.inputs import RunWithInputs

    signals = RunWithInputs(*recorded)
    held = sum(_middle(signals, recorded.run, f"{component}.{p}") for p in ("tau", "tau_ext"))
    touched = _touch(recorded, signals, component)
    return signals.t, signals.array(q), np.asarray(held + touched)


def _touch(recorded: _Recorded, signals: RunWithInputs, component: str) -> Array | float:
    """Torque (k, n) of the grip, less that on the wall; needed where the scenario has them."""
    from cosim.predict.system import values_of

    values = values_of(recorded.plan.component(component))
    found: Array | float = 0.0
    for port, sign, gains in (("tau_h", 1.0, ("k_p", "k_d")), ("tau_e", -1.0, ("k_w", "b_w"))):
        if any(any(values[gain]) for gain in gains):
            found = found + sign * signals.array(f"{component}.{port}")
    return found


def _middle(signals: RunWithInputs, run: Run, name: str) -> Array:
    """A torque (k, n) that is held from row to row, at the rows: the mean of before and after.

    A recorded input is what acted before the row; otherwise it is what its sources give from then.
    """
    held = signals.array(name)
    middle = held.copy()
    if any(c.split("[")[0] == name for c in run.names):
        middle[:-1] = 0.5 * (held[1:] + held[:-1])
    else:
        middle[1:] = 0.5 * (held[1:] + held[:-1])
    return middle


# ---- what is printed --------------------------------------------------------------------------


def report(found: Identified, component: str) -> list[str]:
    """The parameters with intervals, how well the motion shows them, and what cannot be known."""
    import numpy as np

    from cosim.cli.show import aligned

    good = found.condition <= _EXCITING
    quality = "exciting" if good else f"not exciting: expected {_EXCITING:g} or less"
    rows = [["parameter", "found", "95 %", "scenario", "unit"]]
    for p in found.parameters:
        rows.append(
            [_expression(p), f"{p.value:.5g}", f"± {p.interval:.2g}", f"{p.before:.5g}", p.unit]
        )
    residuals = ", ".join(
        f"{100.0 * a / max(b, 1e-300):.2g}%"
        for a, b in zip(found.residuals, found.torques, strict=True)
    )
    lines = [
        f"{component}: {len(found.parameters)} base parameters from {found.rows} values of each "
        "joint",
        f"condition of the motion {found.condition:.3g} ({quality}); torque not explained: "
        f"{residuals}",
        "",
        *aligned(rows),
        "",
        f"without effect on any motion: {', '.join(found.without_effect) or 'none'}",
    ]
    if not good:
        lines.append(
            "note: values and intervals are not to be trusted; move every joint far and fast, "
            "alone and with the others"
        )
    lines += [f"note: {trace.text}; the parameters allow for it" for trace in found.traces]
    for j in np.flatnonzero(found.memory):
        lines.append(
            f"note: joint {j}: the torque not explained is correlated over {found.memory[j]:.2g} "
            "s: intervals allow for such noise, but not for errors of the model"
        )
    if found.unexcited:
        lines.append(f"not shown by this motion: {', '.join(found.unexcited)}")
    return lines


def _expression(p: BaseParameter) -> str:
    text = ""
    for name, k in list(p.factors.items())[:_TERMS]:
        size = f"{abs(k):.4g} "
        text += f" {'-' if k < 0.0 else '+'} {'' if size == '1 ' else size}{name}"
    return text.removeprefix(" + ") + (" ..." if len(p.factors) > _TERMS else "")


def _write(path: Path, found: Identified) -> None:
    data: Mapping[str, Any] = {
        "parameters": [
            {"factors": p.factors, "unit": p.unit, "value": p.value, "interval_95": p.interval,
             "scenario": p.before}
            for p in found.parameters
        ],
        "condition": found.condition,
        "rows": found.rows,
        "residuals": found.residuals.tolist(),
        "torques": found.torques.tolist(),
        "without_effect": list(found.without_effect),
        "unexcited": list(found.unexcited),
        "traces": [asdict(trace) for trace in found.traces],
        "memory": found.memory.tolist(),
    }  # fmt: skip
    write_json(path, "identify", data)
