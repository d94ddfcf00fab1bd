"""``cosim analyze --linear``: A, B, C, D of a scenario at an operating point, and its poles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cosim.base.convert import Struct
from cosim.cli.options import finite, write_json

if TYPE_CHECKING:
    from cosim.linear.model import LinearModel

#: Modes that are printed.
_MOST = 24
#: Distance from z = 1 below which a pole counts as an integral.
_AT_ONE = 1e-9


class LinearOptions(Struct, frozen=True):
    """The linear model of a scenario."""

    linear: Annotated[
        bool,
        typer.Option(
            "--linear", help="Linearize a scenario at a time of its run: A, B, C, D and the poles."
        ),
    ] = False
    at: Annotated[
        float | None,
        typer.Option(
            callback=finite,
            min=0.0,
            help="With --linear: time of the run, s.",
            show_default="the end",
        ),
    ] = None
    component: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="With --linear: this component alone.", show_default="all"
        ),
    ] = ""
    inputs: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help="With --linear: inputs, separated by commas, e.g. master.tau_ext.",
            show_default="those that nothing feeds",
        ),
    ] = ""
    outputs: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help="With --linear: outputs, e.g. master.q[0],slave.q.",
            show_default="those of continuous components",
        ),
    ] = ""
    size: Annotated[
        float,
        typer.Option(
            callback=finite,
            min=1e-9,
            max=1.0,
            help="With --linear: change of a value for the differences; relative where it is "
            "above 1.",
        ),
    ] = 1e-3
    mat: Annotated[
        Path | None,
        typer.Option("--mat", metavar="FILE", help="With --linear: write the model for MATLAB."),
    ] = None


def linearize(
    scenario: Path, settings: Sequence[str], options: LinearOptions, json: Path | None, quiet: bool
) -> None:
    """Print the linear model of a scenario, and write it.

    The model goes from one period of the slowest component to the next, and contains the rates and
    the delays of links at this time.
    """
    from cosim.cli.summary import live_line
    from cosim.linear.scenario import linearized

    with live_line(quiet) as say:
        found = linearized(
            scenario,
            settings,
            options.at,
            options.component,
            _names(options.inputs),
            _names(options.outputs),
            options.size,
            lambda name: say(f"derivatives of {name}"),
        )
    if json is not None:
        write_json(json, "linearize", found.as_data())
    if options.mat is not None:
        _save(options.mat, _matlab(found))
    if not quiet:
        for line in report(found):
            typer.echo(line)


def _names(text: str) -> list[str]:
    """Names between commas; a comma inside of an index separates nothing."""
    names, depth = [""], 0
    for letter in text:
        depth += (letter == "[") - (letter == "]")
        if letter == "," and not depth:
            names.append("")
        else:
            names[-1] += letter
    return [name.strip() for name in names if name.strip()]


def report(found: LinearModel) -> list[str]:
    """The size of the model, its poles, and components that are not smooth, as text."""
    from cosim.cli.show import aligned
    from cosim.linear.model import ROUGH
    from cosim.linear.poles import LARGE

    every = found.modes()
    modes = [m for m in every if abs(m.z - 1.0) > _AT_ONE]
    lines = [
        f"linear at t = {found.time:g} s, in periods of {found.period:g} s: {len(found.states)} "
        f"states, {len(found.inputs)} inputs, {len(found.outputs)} outputs",
        *aligned([["pole, 1/s", "|z|", "Hz", "damping", "mostly"], *(
            [_complex(m.s), f"{abs(m.z):.9g}", f"{m.frequency:.4g}", f"{m.damping:.4g}", m.state]
            for m in modes[:_MOST])]),
    ]  # fmt: skip
    if len(every) > len(modes):
        lines.append(f"  and {len(every) - len(modes)} at z = 1: integrals, estimates at rest")
    if len(modes) > _MOST:
        lines.append(f"  and {len(modes) - _MOST} faster ones")
    if len(found.states) > LARGE:
        lines.append("  these are the poles near z = 1, and some near the rest of the unit circle")
    outside = sum(abs(m.z) > 1.0 + 1e-7 for m in modes)
    if outside:
        lines.append(f"unstable: {outside} poles or pairs grow")
    lines += [
        f"note: {name} is not smooth here: its derivatives change by {error:.1g} with the size of "
        "the differences (--size)"
        for name, error in found.errors.items()
        if error > ROUGH
    ]
    return lines


def _complex(s: complex) -> str:
    return f"{s.real:.6g}" if abs(s.imag) < 1e-12 else f"{s.real:.6g} ± {abs(s.imag):.6g}j"


def _matlab(found: LinearModel) -> bytes:
    """A file of MATLAB level 5: ss(A, B, C, D, period) makes the model."""
    from io import BytesIO

    import numpy as np

    from cosim.base.errors import RunError

    try:
        from scipy.io import savemat
    except ImportError:
        raise RunError(
            "--mat needs SciPy: pip install 'cosim-bridge[fit]'; --json needs nothing"
        ) from None
    data = found.as_data()
    ports = {
        key: np.array([[p["name"], p["unit"]] for p in data[key]], dtype=object)
        for key in ("states", "inputs", "outputs")
    }
    file = BytesIO()
    matrices = {key: getattr(found, key) for key in "ABCD"}
    savemat(file, {**matrices, **ports, "period": found.period, "time": found.time})
    return file.getvalue()


def _save(path: Path, data: bytes) -> None:
    from cosim.base.files import write_file

    write_file(path, data)
