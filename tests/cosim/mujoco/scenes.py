"""Scenes of the tests; importing this skips a module of tests where MuJoCo is not installed."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.mujoco import MujocoOptions
from cosim.mujoco.component import MujocoComponent

pytest.importorskip("mujoco", reason="the extra `mujoco` is not installed")

CONFIGS = Path(__file__).parents[3] / "configs" / "mujoco"
ARM, WALL = CONFIGS / "arm.xml", CONFIGS / "wall.xml"

#: One hinge about y with a mass at 1 m, without gravity.
HINGE = """<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody><body name="b">
<joint name="j" axis="0 1 0"/><geom pos="1 0 0" type="sphere" size=".1" mass="2"/></body>
</worldbody></mujoco>"""

#: A balls' heap whose contacts need more memory than the file allows.
SMALL_MEMORY = (
    '<mujoco><size memory="32K"/><worldbody>'
    + "".join(
        f'<body pos="0 0 .1"><joint axis="{k % 2} {1 - k % 2} 0"/><geom type="sphere" size=".01"/>'
        for k in range(100)
    )
    + "</body>" * 100
    + "</worldbody></mujoco>"
)

#: Every kind of joint, of actuator, and sensors of several units.
MANY = """<mujoco><worldbody>
<body name="box" pos="0 0 1"><freejoint/><geom type="box" size=".1 .1 .1"/></body>
<body><joint name="left_1" axis="0 1 0"/><geom size=".1"/>
  <body pos="1 0 0"><joint name="left_2" axis="0 1 0"/><geom size=".1"/><site name="tool"/></body>
</body>
<body pos="0 3 0"><joint name="right_1" axis="0 1 0"/><geom size=".1"/>
  <body pos="1 0 0"><joint name="right_2" axis="0 1 0"/><geom size=".1"/></body>
</body>
<body pos="0 6 0"><joint name="rail" type="slide" axis="1 0 0"/><geom size=".1"/></body>
<body pos="0 9 0"><joint name="ball" type="ball"/><geom size=".1"/></body>
</worldbody><actuator>
<motor joint="left_1" gear="2"/><motor joint="left_2" gear="-4"/>
<position name="p1" joint="right_1" kp="10"/><position name="p2" joint="right_2" kp="10"/>
<velocity name="v" joint="rail" kv="5"/>
<general name="muscle" joint="rail" dyntype="filter" dynprm="0.1" gainprm="3"/>
</actuator><sensor>
<jointpos name="s_angle" joint="left_1"/><jointpos name="s_rail" joint="rail"/>
<actuatorfrc name="s_force" actuator="v"/><framequat name="s_quat" objtype="site" objname="tool"/>
<accelerometer name="s_acc" site="tool"/><clock/>
</sensor><keyframe>
<key name="home" qpos="0 0 2  1 0 0 0  0.1 0.2  0.3 0.4  0.5  1 0 0 0"/>
</keyframe></mujoco>"""


def scene(folder: Path, text: str, **options: object) -> MujocoComponent:
    """The component of a scene that is written into `folder`."""
    path = folder / "scene.xml"
    path.write_text(text)
    return MujocoComponent(path, MujocoOptions(**options))  # type: ignore[arg-type]
