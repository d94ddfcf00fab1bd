"""Loops of the two sides with force feedback, which LeRobot's own teleoperation does not send.

Each yields a row of numbers a cycle; with a table as connection these are the same in every run.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeAlias

from lerobot.robots import Robot
from lerobot.teleoperators import Teleoperator

from cosim.base.clock import sleep, stopwatch
from lerobot_robot_cosim.robot import LinkRobot
from lerobot_robot_cosim.teleoperator import LinkTeleoperator

#: A row of a data set: number by column.
Step: TypeAlias = "dict[str, float]"


def operate(leader: Teleoperator, robot: LinkRobot, cycles: int) -> Iterator[Step]:
    """The operator's side at the rate of the robot's `fps`, in real time."""
    for _ in _paced(cycles, robot.config.fps):
        yield _operated(leader, robot)


def serve(follower: Robot, teleoperator: LinkTeleoperator, cycles: int) -> Iterator[Step]:
    """The robot's side at the rate of the teleoperator's `fps`, in real time."""
    for _ in _paced(cycles, teleoperator.config.fps):
        yield _served(follower, teleoperator)


def pair(
    leader: Teleoperator, robot: LinkRobot, follower: Robot, teleoperator: LinkTeleoperator,
    cycles: int, *, paced: bool = False,
) -> Iterator[Step]:  # fmt: skip
    """Both sides in one process: in a cycle the robot's side sends, then the operator's side sends
    and looks, then the robot's side looks.

    `paced`: in real time, for hardware; otherwise as fast as they are.
    """
    for _ in _paced(cycles, robot.config.fps) if paced else range(cycles):
        observation = _observed(follower, teleoperator)
        near = _operated(leader, robot)
        far = _moved(follower, teleoperator, observation)
        yield {f"far.{k}": v for k, v in far.items()} | {f"near.{k}": v for k, v in near.items()}


def _operated(leader: Teleoperator, robot: LinkRobot) -> Step:
    """One cycle: the leader's action there, and the torques that have come back to the leader."""
    action = robot.send_action(leader.get_action())
    observation = robot.get_observation()
    torques = {k: v for k, v in observation.items() if k in leader.feedback_features}
    if torques:
        leader.send_feedback(torques)
    return _columns(action, observation)


def _served(follower: Robot, teleoperator: LinkTeleoperator) -> Step:
    """One cycle: the robot's observation back, and the action that has come to the robot."""
    return _moved(follower, teleoperator, _observed(follower, teleoperator))


def _observed(follower: Robot, teleoperator: LinkTeleoperator) -> dict[str, Any]:
    observation: dict[str, Any] = follower.get_observation()
    teleoperator.send_feedback(observation)
    return observation


def _moved(follower: Robot, teleoperator: LinkTeleoperator, observation: dict[str, Any]) -> Step:
    action = follower.send_action(teleoperator.get_action())
    late = {"link.age": teleoperator.held.age, "link.delay": teleoperator.held.delay}
    return _columns(action, observation | late)


def _columns(action: dict[str, Any], observation: dict[str, Any]) -> Step:
    row = {f"action.{k}": float(v) for k, v in action.items()}
    return row | {f"observation.{k}": float(v) for k, v in observation.items()}


def _paced(cycles: int, fps: int) -> Iterator[int]:
    """Numbers of cycles, each at its time; a late one does not move those after it."""
    elapsed = stopwatch()
    for k in range(cycles):
        sleep(k / fps - elapsed())
        yield k
