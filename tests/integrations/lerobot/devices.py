"""A leader and a follower for the tests: a hand that follows a curve and feels, and an arm."""

from __future__ import annotations

from math import sin
from typing import Any

from lerobot.robots import Robot, RobotConfig
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig

JOINTS = ("shoulder", "elbow")


class Leader(Teleoperator):
    """A hand on two joints: it follows a curve, and each torque that it feels moves it back."""

    config_class = TeleoperatorConfig
    name = "curve"

    def __init__(self) -> None:
        super().__init__(TeleoperatorConfig(id="leader"))
        self.cycle, self.back = 0, dict.fromkeys(JOINTS, 0.0)
        self.felt: list[dict[str, float]] = []

    action_features = property(lambda self: {f"{j}.pos": float for j in JOINTS})
    feedback_features = property(lambda self: {f"{j}.torque": float for j in JOINTS})
    is_connected = property(lambda self: True)
    is_calibrated = property(lambda self: True)

    def connect(self, calibrate: bool = True) -> None:
        """It is."""

    def calibrate(self) -> None:
        """It is."""

    def configure(self) -> None:
        """It is."""

    def get_action(self) -> dict[str, Any]:
        """The position of the hand."""
        self.cycle += 1
        moved = {j: sin(0.05 * self.cycle * (i + 1)) for i, j in enumerate(JOINTS)}
        return {f"{j}.pos": moved[j] - 0.02 * self.back[j] for j in JOINTS}

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Torques on the hand."""
        self.felt.append(feedback)
        self.back = {j: feedback[f"{j}.torque"] for j in JOINTS}

    def disconnect(self) -> None:
        """It is."""


class Follower(Robot):
    """Two joints, each a damped spring towards its target; the torque is that of the spring."""

    config_class = RobotConfig
    name = "springs"

    def __init__(self) -> None:
        super().__init__(RobotConfig(id="follower"))
        self.position = dict.fromkeys(JOINTS, 0.0)
        self.torque = dict.fromkeys(JOINTS, 0.0)
        self.actions: list[dict[str, float]] = []

    observation_features = property(
        lambda self: {f"{j}.{k}": float for j in JOINTS for k in ("pos", "torque")}
    )
    action_features = property(lambda self: {f"{j}.pos": float for j in JOINTS})
    is_connected = property(lambda self: True)
    is_calibrated = property(lambda self: True)

    def connect(self, calibrate: bool = True) -> None:
        """It is."""

    def calibrate(self) -> None:
        """It is."""

    def configure(self) -> None:
        """It is."""

    def get_observation(self) -> dict[str, Any]:
        """Positions and torques."""
        position = {f"{j}.pos": self.position[j] for j in JOINTS}
        return position | {f"{j}.torque": self.torque[j] for j in JOINTS}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Targets of the springs; a cycle passes."""
        self.actions.append(action)
        for j in JOINTS:
            away = action[f"{j}.pos"] - self.position[j]
            self.torque[j] = 40.0 * away
            self.position[j] += 0.3 * away
        return action

    def disconnect(self) -> None:
        """It is."""
