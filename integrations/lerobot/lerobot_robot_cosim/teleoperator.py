"""The far operator, as the robot's side sees it: a LeRobot Teleoperator behind a connection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lerobot.teleoperators import Teleoperator, TeleoperatorConfig

from lerobot_robot_cosim.connection import Connection, Held, closed
from lerobot_robot_cosim.settings import LinkSettings


@TeleoperatorConfig.register_subclass("cosim_link")
@dataclass(kw_only=True)
class LinkTeleoperatorConfig(TeleoperatorConfig, LinkSettings):
    """``--teleop.type=cosim_link``; the keys are those of :class:`.settings.LinkSettings`."""


class LinkTeleoperator(Teleoperator):
    """Actions come from the far side, and feedback goes back to it, each as late as its link.

    Until an action has come, it is the position that was sent back last: the robot stays where it
    is.
    """

    config_class = LinkTeleoperatorConfig
    name = "cosim_link"

    def __init__(self, config: LinkTeleoperatorConfig) -> None:
        super().__init__(config)
        self.config = config
        self.connection: Connection | None = None
        self.held = Held()
        self._here = config.first()

    @property
    def action_features(self) -> dict[str, Any]:
        """Positions."""
        return dict.fromkeys(self.config.actions, float)

    @property
    def feedback_features(self) -> dict[str, Any]:
        """Positions and torques."""
        return dict.fromkeys(self.config.observations, float)

    @property
    def is_connected(self) -> bool:
        """True between connect() and disconnect()."""
        return self.connection is not None

    @property
    def is_calibrated(self) -> bool:
        """True: the far device is calibrated at its own side."""
        return True

    def calibrate(self) -> None:
        """Nothing to do here."""

    def configure(self) -> None:
        """Nothing to do here."""

    def connect(self, calibrate: bool = True) -> None:
        """Open the connection. Raises ScenarioError for keys that do not fit."""
        self.connection = self.config.open(near=False)

    def get_action(self) -> dict[str, Any]:
        """The action that is held here now."""
        self.held = held = self._open().there.pull()
        if held.values is None:
            return {name: self._here[name] for name in self.config.actions}
        return dict(zip(self.config.actions, held.values, strict=True))

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Send positions and torques of the robot to the operator's side."""
        self._here = {name: float(feedback[name]) for name in self.config.observations}
        self._open().back.push(list(self._here.values()))

    def disconnect(self) -> None:
        """Close the connection."""
        if self.connection is not None:
            closed(self.config.connection, self.connection)
            self.connection = None

    def _open(self) -> Connection:
        if self.connection is None:
            raise RuntimeError(f"{self} is not connected; expected connect() before")
        return self.connection
