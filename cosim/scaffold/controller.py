"""The three files of ``cosim new controller NAME``.

The controller is a PD law with damping on the measured velocity, on the planar arm that comes with
this project, 5 ms sampled. It is meant to be changed.
"""

from __future__ import annotations

import keyword
import re
from pathlib import Path

from cosim.base.errors import ScenarioError

_COMPONENT = '''\
"""A controller of your own: see docs/own-component.md."""

from cosim.base.component import Parameter, Port


class {cls}:
    """tau = K (q_d - q) - D dq."""

    kind = "sampled"  # reads its inputs at t, its outputs hold until t + h
    inputs = (Port("q", (2,), "rad"), Port("dq", (2,), "rad/s"), Port("q_d", (2,), "rad"))
    outputs = (Port("tau", (2,), "N.m"),)
    parameters = (Parameter("K", (20.0,), (), "N.m/rad"), Parameter("D", (8.0,), (), "N.m.s/rad"))

    def initialize(self, values):
        self.x = {{p.name: values.get(p.name, p.default[0]) for p in self.parameters}}

    def initial(self, u):
        return {{"tau": self.x["K"] * (u["q_d"] - u["q"]) - self.x["D"] * u["dq"]}}

    def step(self, t, h, u):
        return self.initial(u)  # no state: the same law at every t

    def get_state(self):
        return None

    def set_state(self, state):
        pass
'''

_SCENARIO = """\
title = "{cls} on a planar arm"

[run]
step = "1 ms"
stop = "5 s"

[components.arm]
model = "fmus.models.planar2r"
start = {{ q = [0.5, -0.5] }}                  # rad
inputs = {{ tau = "control.tau" }}

[components.control]
model = "{name}:{cls}"
period = "5 ms"                              # the controller's sampling
parameters = {{ K = 20.0, D = 8.0 }}
start = {{ q_d = ["40 deg", "-60 deg"] }}      # where the arm is to go
inputs = {{ q = "arm.q", dq = "arm.dq" }}

[metrics]
error = {{ kind = "error", of = ["arm.q"], target = [0.6981317, -1.0471976], within = 0.01 }}
peak_torque = {{ kind = "peak", of = ["control.tau"] }}

[figures.motion]
panels = [{{ y = ["arm.q"], title = "Joint positions" }}, {{ y = ["control.tau"] }}]
"""

_TEST = """\
from math import radians
from pathlib import Path

import numpy as np

from cosim.record import Run
from cosim.loading.files import load
from cosim.engine.simulate import simulate

SCENARIO = Path(__file__).with_name("{name}.toml")


def test_the_arm_arrives(tmp_path):
    run = Run.open(simulate(load(SCENARIO), tmp_path / "run").folder)
    q = run.array("arm.q")  # (rows, 2), rad
    assert np.abs(q[-1] - [radians(40), radians(-60)]).max() < 0.01
"""


def write_controller(name: str, folder: Path) -> tuple[Path, Path, Path]:
    """Write ``NAME.py``, ``NAME.toml`` and ``test_NAME.py`` into `folder`; return their paths.

    Raises ScenarioError for a name that is not a valid module name, and if one of the files exists.
    """
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) or keyword.iskeyword(name):
        raise ScenarioError(
            f"{name!r} is not a valid name of a Python module; expected e.g. my_law"
        )
    cls = "".join(part[:1].upper() + part[1:] for part in name.split("_")) or "Controller"
    if cls[0].isdigit():
        cls = f"C{cls}"
    contents = {
        folder / f"{name}.py": _COMPONENT,
        folder / f"{name}.toml": _SCENARIO,
        folder / f"test_{name}.py": _TEST,
    }
    for path in contents:
        if path.exists():
            raise ScenarioError("exists already; choose another name or --dir", str(path))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, text in contents.items():
            path.write_text(text.format(name=name, cls=cls), encoding="utf-8")
    except OSError as error:
        raise ScenarioError(f"cannot be written: {error.strerror}", str(folder)) from None
    module, scenario, test = contents
    return module, scenario, test
