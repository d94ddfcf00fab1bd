"""The files of ``cosim new controller NAME``.

The controller is a PD law with damping on the measured velocity, on the planar arm that comes with
this project, 5 ms sampled. It is meant to be changed.
"""

from __future__ import annotations

from pathlib import Path

from bridge.scaffold.files import bus, check_module_name, dbc, write_files

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

_DEPLOYMENT = """\
# The rehearsal of {name}.toml: the arm and the controller are two processes on a CAN FD bus.
#
#   arm (emulated drive)  --STATE_1: q, dq-->  control  --LINK_2: tau-->  arm
#
# The bus is simulated. On SocketCAN, also a virtual one: interface = "socketcan" and
# channel = "vcan0".
# For the real arm, see docs/hardware.md.

title = "{cls} and its arm on a CAN FD bus"
sync = "arm"

{bus}
[nodes.arm]
components = ["arm"]
number = 1
drive = {{ tau_max = "40 N.m", watchdog = "200 ms" }}

[nodes.control]
components = ["control"]
number = 2
phase = "0.5 ms"        # the frame with the encoders of this period is there
requires = ["arm"]
guard = {{ tau_max = "30 N.m", dq_max = "20 rad/s", q_jump = "0.5 rad" }}
stale = {{ "control.q" = {{ stop = "200 ms" }} }}

[messages.STATE_1]
bus = "bench"
carries = ["arm.q", "arm.dq"]
period = "5 ms"

[messages.LINK_2]
bus = "bench"
carries = ["control.tau"]
"""

_TEST = """\
# The plug-in of pytest that comes with cosim gives these tests their arguments: docs/testing.md.
TARGET = ["40 deg", "-60 deg"]


def test_the_arm_arrives(cosim_run):
    run = cosim_run("{name}.toml")
    assert run.settles("arm.q", TARGET, band="0.01 rad", within="4 s")
    assert run.stays_below("control.tau", "30 N.m")


def test_the_arm_arrives_with_frames_on_a_bus(twin):
    run = twin("{name}.toml")
    assert run.settles("arm.q", TARGET, band="0.01 rad", within="4 s")
"""


def write_controller(name: str, folder: Path) -> list[Path]:
    """Write a controller, its scenario, its deployment with a DBC file, and a test into `folder`.

    ``NAME.py``, ``NAME.toml``, ``deploy/NAME.toml``, ``can/NAME.dbc`` and ``test_NAME.py``; returns
    their paths. Raises ScenarioError for a name that a new module cannot have, and if one of the
    files exists.
    """
    check_module_name(name, "my_law")
    cls = "".join(part[:1].upper() + part[1:] for part in name.split("_")) or "Controller"
    if cls[0].isdigit():
        cls = f"C{cls}"
    templates = {
        f"{name}.py": _COMPONENT,
        f"{name}.toml": _SCENARIO,
        f"deploy/{name}.toml": _DEPLOYMENT,
        f"test_{name}.py": _TEST,
    }
    contents = {
        path: text.format(name=name, cls=cls, bus=bus(name)) for path, text in templates.items()
    }
    return write_files(folder, {**contents, f"can/{name}.dbc": dbc(2, 2)})
