"""A mass on a spring and a damper, with another pair to a moved end: half of a coupled oscillator.

::

    m dv/dt = force - k s - d v + k_c (s_in - s) + d_c (v_in - v)        ds/dt = v
    reaction = k_c (s - s_in) + d_c (v - v_in)

The `reaction` on the moved end depends on its position and velocity at once. Two of these, one with
k_c = d_c = 0, are the two-mass oscillator of the literature on co-simulation (force-displacement
coupling; Busch 2016, Schweizer and Lu 2014).
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from fmus.build.archive import Version, find
from fmus.model import Model, Variable

_MOVED = ("s_in", "v_in")


def model() -> Model:
    """Declare the mass."""
    stiffness, damping = "N/m", "N.s/m"
    return Model(
        identifier="bench_sprung_mass",
        description="Mass on springs and dampers",
        kind="continuous",
        variables=(
            Variable("force", "input", (), "N", description="Force on the mass"),
            Variable("s_in", "input", (), "m", description="Position of the moved end"),
            Variable("v_in", "input", (), "m/s", description="Its velocity"),
            Variable("s", "output", (), "m", description="Position", settable=True),
            Variable("v", "output", (), "m/s", description="Velocity", settable=True),
            Variable(
                "reaction", "output", (), "N", description="Force on the end", depends=_MOVED,
                start_depends=("s", "v", "k_c", "d_c"),
            ),
            Variable("m", "parameter", (), "kg", 1.0, "Mass", minimum=0.0),
            Variable("k", "parameter", (), stiffness, 1.0, "Stiffness to the wall"),
            Variable("d", "parameter", (), damping, 0.1, "Damping to the wall"),
            Variable("k_c", "parameter", (), stiffness, 0.0, "Stiffness to the moved end"),
            Variable("d_c", "parameter", (), damping, 0.0, "Damping to the moved end"),
        ),
        sources=(str(Path(__file__).with_name("sprung_mass.c")),),
        step=1e-2,
        documentation=__doc__ or "",
    )  # fmt: skip


@lru_cache(maxsize=2)
def fmu(version: Version = "2.0") -> Path:
    """Path of the FMU, built into the cache if it is not there."""
    return find(model(), version)
