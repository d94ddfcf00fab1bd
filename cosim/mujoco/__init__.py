"""A scene of MuJoCo (MJCF or URDF) as a Component; MuJoCo itself is loaded when a scene is."""

from cosim.mujoco.component import MujocoComponent
from cosim.mujoco.options import PREFIX, read_options, scene_path

__all__ = ["PREFIX", "MujocoComponent", "read_options", "scene_path"]
