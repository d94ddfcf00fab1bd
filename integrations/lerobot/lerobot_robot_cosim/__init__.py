"""A LeRobot pair over a network: the robot ``cosim_link`` and the teleoperator ``cosim_link``.

The operator's side sees the far robot as a Robot, and the robot's side sees the far operator as a
Teleoperator. Between them are two directions: actions there, observations and torques back. They
run over the delays of a file or a law, in one process, or over Zenoh, between two.
"""

from lerobot_robot_cosim.loop import Step, operate, pair, serve
from lerobot_robot_cosim.robot import LinkRobot, LinkRobotConfig
from lerobot_robot_cosim.teleoperator import LinkTeleoperator, LinkTeleoperatorConfig

__all__ = [
    "LinkRobot",
    "LinkRobotConfig",
    "LinkTeleoperator",
    "LinkTeleoperatorConfig",
    "Step",
    "operate",
    "pair",
    "serve",
]
