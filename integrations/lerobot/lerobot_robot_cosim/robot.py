"""The far robot, as the operator's side sees it: a LeRobot Robot behind a connection."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from typing import Any

from lerobot.robots import Robot, RobotConfig

from lerobot_robot_cosim.end import LinkEnd
from lerobot_robot_cosim.settings import LinkSettings

#: The columns of an observation that tell how late it is, s.
AGE, DELAY = "link.age", "link.delay"


@RobotConfig.register_subclass("cosim_link")
@dataclass(kw_only=True)
class LinkRobotConfig(RobotConfig, LinkSettings):
    """``--robot.type=cosim_link``; the keys are those of :class:`.settings.LinkSettings`."""


class LinkRobot(LinkEnd, Robot):
    """Actions go to the far side, and its observations come back, each as late as its link.

    An observation has, besides the far robot's positions and torques, ``link.age``: the time since
    the far side sent it, and ``link.delay``: from then until it was held here first, s (nan: none
    has come).
    """

    config_class = LinkRobotConfig
    name = "cosim_link"
    near = True

    @property
    def observation_features(self) -> dict[str, Any]:
        """Positions, torques, age and delay."""
        return dict.fromkeys((*self.config.observations, AGE, DELAY), float)

    @property
    def action_features(self) -> dict[str, Any]:
        """Positions."""
        return dict.fromkeys(self.config.actions, float)

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Send the positions; returned as they were sent."""
        sent = {name: float(action[name]) for name in self.config.actions}
        self._open().there.push(list(sent.values()))
        return sent

    def get_observation(self) -> dict[str, Any]:
        """The observation that is held here now."""
        self.held = held = self._open().back.pull()
        if held.values is None:
            return {**self._known, AGE: nan, DELAY: nan}
        values = dict(zip(self.config.observations, held.values, strict=True))
        return {**values, AGE: held.age, DELAY: held.delay}
