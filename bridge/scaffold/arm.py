"""The files of ``cosim new arm NAME --urdf FILE``: two arms of the file coupled over a network.

Gains follow from the file: in no posture does the damping K change a velocity by more than a third
in one period, and the operator's stiffness is five times K. They are meant to be changed.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bridge.can.link_dbc import MOST_JOINTS
from bridge.scaffold.files import bus, check_name, dbc, write_files
from cosim.base.errors import ScenarioError
from cosim.base.toml import as_toml
from fmus.arms import chain
from fmus.arms.serial import Robot, serial
from fmus.arms.urdf import Urdf, read
from fmus.model.numeric import Array
from fmus.robots.report import sampled_positions

#: Period of the controllers, s, and by which share K changes a velocity in it at the most.
PERIOD, SHARE = 0.004, 0.33
#: Reflected inertia of a geared motor, kg.m2 for each N.m of its torque: the least of three motors
#: of docs/arm.md is 2.6e-4, the greatest 1.2e-3. Of a sliding joint kg for each N, by a pulley of a
#: radius of 0.1 m.
ROTOR, SLIDING_ROTOR = 4e-4, 4e-3
#: Where the file has no limit: torque (N.m), speed (rad/s), and position (rad) to either side; and
#: of a sliding joint force (N), speed (m/s) and position (m).
TORQUE, SPEED, REACH = (100.0, 500.0), (20.0, 2.0), (3.0, 0.5)
#: How near the arms have to come, and the largest jump of a position: rad, m.
NEAR, JUMP = (0.02, 0.005), (0.5, 0.05)

_SCENARIO = """\
# Two arms of {file}: the operator holds the master, and the slave follows over the network.
# armature: rotor inertia times gear ratio squared, which the file does not have. It is guessed from
# the torque of each joint. Replace it by that of your motors, and then K may be as much larger.
{units}
title = "Two arms of {file}"

[run]
step = "1 ms"
stop = "20 s"
seed = 0
record = {{ every = 4 }}

[components.master]
model = "fmus.models.arm"
options = {options}
parameters = {{ armature = {armature}, k_p = {k_p}, k_d = {K}, q_h = {q_h} }}
start = {{ q = {q} }}
inputs = {{ tau = "master_control.tau" }}

[components.slave]
model = "fmus.models.arm"
options = {options}
parameters = {{ armature = {armature} }}
start = {{ q = {q} }}
inputs = {{ tau = "slave_control.tau" }}

[components.master_control]
model = "fmus.models.arm_teleoperation"
sizes = {{ joints = {n} }}
options = {options}
period = "4 ms"
parameters = {{ armature = {armature}, K = {K}, alpha = 0.5, lambda = 2.0, lambda_M = 4.0 }}
inputs = {{ q = "master.q", dq = "master.dq" }}

[components.slave_control]
model = "fmus.models.arm_teleoperation"
sizes = {{ joints = {n} }}
options = {options}
period = "4 ms"
parameters = {{ armature = {armature}, K = {K}, alpha = 0.5, lambda = 2.0, lambda_M = 4.0 }}
inputs = {{ q = "slave.q", dq = "slave.dq" }}

[[links]]
from = "master_control.xi"
to = "slave_control.xi_in[0]"
semantics = "newest-stamp"
delay = {{ law = "preset", name = "wifi5" }}

[[links]]
from = "slave_control.xi"
to = "master_control.xi_in[0]"
semantics = "newest-stamp"
delay = {{ law = "preset", name = "wifi5" }}

[metrics]
{metrics}
"""

_DEPLOYMENT = """\
# The rehearsal of {name}.toml: four processes on a CAN FD bus.
#
#   master --STATE_1: q, dq--> master_control --LINK_2: tau, xi--> master, slave_control
#   slave  --STATE_3: q, dq--> slave_control  --LINK_4: tau, xi--> slave, master_control
#
# The bus is simulated. On SocketCAN, also a virtual one: interface = "socketcan" and
# channel = "vcan0".
# Motors with their own protocol (Damiao, ODrive, CiA 402): docs/your-own-arm.md, section 3.

title = "Two arms of {file} on a CAN FD bus"
sync = "master"

{bus}{nodes}
[messages.STATE_1]
bus = "bench"
carries = ["master.q", "master.dq"]
period = "4 ms"

[messages.LINK_2]
bus = "bench"
carries = ["master_control.tau", "master_control.xi"]

[messages.STATE_3]
bus = "bench"
carries = ["slave.q", "slave.dq"]
period = "4 ms"

[messages.LINK_4]
bus = "bench"
carries = ["slave_control.tau", "slave_control.xi"]

[set]
"components.master_control.parameters.tau_max" = {tau_max}
"components.slave_control.parameters.tau_max" = {tau_max}
"components.master_control.parameters.age_max" = "40 ms"
"components.slave_control.parameters.age_max" = "40 ms"
"components.master_control.parameters.age_fade" = "0.1 s"
"components.slave_control.parameters.age_fade" = "0.1 s"
"""

_NODES = """
[nodes.{side}]          # an emulated drive with the arm behind it
components = ["{side}"]
number = {drive}
drive = {{ tau_max = {tau_max}, watchdog = "200 ms" }}

[nodes.{side}_control]
components = ["{side}_control"]
number = {control}
phase = "0.5 ms"        # the frame with the encoders of this period is there
requires = ["{side}"]
guard = {{ tau_max = {tau_max}, dq_max = {dq_max}, q_jump = {q_jump} }}
[nodes.{side}_control.stale]
"{side}_control.q" = {{ stop = "200 ms" }}
"{side}_control.xi_in" = {{ age = "age[0]" }}
"""

_TEST = """\
# The plug-in of pytest that comes with cosim gives this test its argument: docs/testing.md.
def test_the_arms_come_together(cosim_run):
    run = cosim_run("{name}.toml")
    assert run.passes()
"""


def write_arm(
    name: str,
    urdf: Path,
    folder: Path,
    base: str = "",
    tip: str = "",
    fixed: Mapping[str, float | str] | None = None,
) -> tuple[list[Path], str]:
    """Write a scenario, a deployment with a DBC file and a test of an arm from `base` to `tip`.

    "": the root of the file, and its only end. `fixed`: joints that are held, with their values
    (rad or m, or texts with a unit). Returns the paths, and why there is no deployment, or "".
    Raises ScenarioError for a file that is no arm, ends that are not unique, and if one of the
    files exists.
    """
    check_name(name, "a test", "my_arm")
    found = read(urdf)
    base = base or next(link for link in found.links if found.joint_above(link) is None)
    tip = tip or _only_end(found, base)
    fixed = dict(fixed or {})
    robot = serial(urdf, base, tip, fixed)
    words = _words(robot, name, folder, base, tip, fixed)
    contents = {f"{name}.toml": _SCENARIO, f"test_{name}.py": _TEST}
    files = {path: text.format(**words) for path, text in contents.items()}
    missing = _without_bus(robot)
    if not missing:
        sides = (("master", 1, 2), ("slave", 3, 4))
        nodes = (_NODES.format(side=s, drive=d, control=c, **words) for s, d, c in sides)
        files[f"deploy/{name}.toml"] = _DEPLOYMENT.format(
            nodes="".join(nodes), bus=bus(name), **words
        )
        files[f"can/{name}.dbc"] = dbc(robot.table.joints, 4, _slides(robot))
    return write_files(folder, files), missing


def _only_end(found: Urdf, base: str) -> str:
    """The link in which the only branch with moving joints ends; Raises ScenarioError."""
    ends = sorted(name for name in found.links if not list(found.joints_on(name)))
    if len(ends) != 1:
        raise ScenarioError(
            f"the arm may end in {', '.join(ends)}; expected --tip with one of them, or a link "
            f"between them and {base}",
            str(found.path),
        )
    return ends[0]


def _slides(robot: Robot) -> list[bool]:
    return [bool(kind) for kind in robot.table.joint_type]


def _words(
    robot: Robot, name: str, folder: Path, base: str, tip: str, fixed: Mapping[str, float | str]
) -> dict[str, object]:
    """The words of the templates, as TOML."""
    slides = np.array(_slides(robot))
    reach = np.where(slides, *REACH[::-1])
    low = np.where(np.isfinite(robot.lower), robot.lower, -reach)
    high = np.where(np.isfinite(robot.upper), robot.upper, reach)
    effort = np.where(np.isfinite(robot.effort), robot.effort, np.where(slides, *TORQUE[::-1]))
    armature = np.where(slides, SLIDING_ROTOR, ROTOR) * effort
    speed = np.where(slides, *SPEED[::-1])
    gain = _damping(robot, armature)
    start = low + 0.45 * (high - low)
    file = os.path.relpath(robot.path, folder)
    return {
        "name": name,
        "file": robot.path.name,
        "n": robot.table.joints,
        "options": f'{{ urdf = "{file}", base = "{base}", tip = "{tip}"{_held(fixed)} }}',
        "units": _units(robot.names, slides) if slides.any() else "",
        "metrics": _metrics(slides),
        "q_jump": _list(np.where(slides, *JUMP[::-1])) if slides.any() else '"0.5 rad"',
        "K": _list(gain),
        "k_p": _list(5 * gain),
        "q": _list(start),
        "q_h": _list(start + np.minimum(0.3, 0.1 * (high - low))),
        "armature": _list(armature),
        "tau_max": _list(effort),
        "dq_max": _list(np.where(np.isfinite(robot.velocity), robot.velocity, speed)),
    }


def _held(fixed: Mapping[str, float | str]) -> str:
    """The option with the joints that are held, or ""."""
    return f", fixed = {as_toml(dict(fixed))}" if fixed else ""


def _units(names: Sequence[str], slides: NDArray[np.bool_]) -> str:
    """The comment on the units of joints, of which some slide."""
    sliding = [name for name, slide in zip(names, slides, strict=True) if slide]
    return f"# Of {', '.join(sliding)} all numbers are in m, m/s, N and kg: they slide.\n"


def _metrics(slides: NDArray[np.bool_]) -> str:
    """The metrics of the scenario: one distance and one peak for joints that turn, and that slide.

    Angles and lengths have no common distance.
    """
    lines = []
    for kind, (title, force) in enumerate((("together", "torque"), ("together_sliding", "force"))):
        joints = np.flatnonzero(slides == bool(kind))
        if not len(joints):
            continue
        every = len(joints) == len(slides)
        of, target, peaks = (
            ", ".join(f'"{port}"' if every else _entries(port, joints) for port in ports)
            for ports in (["slave.q"], ["master.q"], ["master_control.tau", "slave_control.tau"])
        )
        target = target if every else f"[{target}]"
        lines += [
            f'{title} = {{ kind = "error", of = [{of}], target = {target}, '
            f"within = {NEAR[kind]} }}",
            f'peak_{force} = {{ kind = "peak", of = [{peaks}] }}',
        ]
    return "\n".join(lines)


def _entries(port: str, joints: Iterable[int]) -> str:
    return ", ".join(f'"{port}[{i}]"' for i in joints)


def _damping(robot: Robot, armature: Array) -> Array:
    """K (n,): shares of the least effective inertias, so that K T / M is SHARE at the most."""
    inverses = [
        np.linalg.inv(chain.mass_matrix(robot.table, q) + np.diag(armature))
        for q in sampled_positions(robot)
    ]
    least = 1 / np.max([np.diag(inverse) for inverse in inverses], axis=0)
    root = np.sqrt(least)
    most = max(np.linalg.eigvalsh(root[:, None] * inverse * root)[-1] for inverse in inverses)
    return np.asarray(SHARE * least / (most * PERIOD))


def _list(values: Array) -> str:
    return f"[{', '.join(_number(v) for v in values)}]"


def _number(value: float) -> str:
    return repr(float(f"{value:.3g}"))


def _without_bus(robot: Robot) -> str:
    """The reason why the messages of the DBC file do not fit the arm, or ""."""
    joints = robot.table.joints
    return f"a frame has room for {MOST_JOINTS} of {joints} joints" if joints > MOST_JOINTS else ""
