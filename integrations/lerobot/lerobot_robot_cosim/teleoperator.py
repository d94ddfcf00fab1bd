"""The far operator, as the robot's side sees it: a LeRobot Teleoperator behind a connection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lerobot.teleoperators import Teleoperator, TeleoperatorConfig

from lerobot_robot_cosim.end import LinkEnd
from lerobot_robot_cosim.settings import LinkSettings


@TeleoperatorConfig.register_subclass("cosim_link")
@dataclass(kw_only=True)
class LinkTeleoperatorConfig(TeleoperatorConfig, LinkSettings):
    """``--teleop.type=cosim_link``; the keys are those of :class:`.settings.LinkSettings`."""


class LinkTeleoperator(LinkEnd, Teleoperator):
    """Actions come from the far side, and feedback goes back to it, each as late as its link.

    Until an action has come, it is the position that was sent back last: the robot stays where it
    is.
    """

    config_class = LinkTeleoperatorConfig
    name = "cosim_link"
    near = False

    @property
    def action_features(self) -> dict[str, Any]:
        """Positions."""
        return dict.fromkeys(self.config.actions, float)

    @property
    def feedback_features(self) -> dict[str, Any]:
        """Positions and torques."""
        return dict.fromkeys(self.config.observations, float)

    def get_action(self) -> dict[str, Any]:
        """The action that is held here now."""
        self.held = held = self._open().there.pull()
        if held.values is None:
            return {name: self._known[name] for name in self.config.actions}
        return dict(zip(self.config.actions, held.values, strict=True))

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Send positions and torques of the robot to the operator's side."""
        self._known = {name: float(feedback[name]) for name in self.config.observations}
        self._open().back.push(list(self._known.values()))
