"""Abstract classes with the members of lerobot.teleoperators (0.4.4)."""

import abc
from dataclasses import dataclass
from typing import ClassVar

from lerobot.robots import Registry


@dataclass(kw_only=True)
class TeleoperatorConfig(Registry):
    """The configuration of a teleoperator."""

    id: str | None = None
    known: ClassVar[dict] = {}


class Teleoperator(abc.ABC):
    """The abstract teleoperator."""

    def __init__(self, config):
        self.id = config.id

    @property
    @abc.abstractmethod
    def action_features(self):
        """The member `action_features` of LeRobot."""

    @property
    @abc.abstractmethod
    def feedback_features(self):
        """The member `feedback_features` of LeRobot."""

    @property
    @abc.abstractmethod
    def is_connected(self):
        """The member `is_connected` of LeRobot."""

    @property
    @abc.abstractmethod
    def is_calibrated(self):
        """The member `is_calibrated` of LeRobot."""

    @abc.abstractmethod
    def connect(self, calibrate=True):
        """The member `connect` of LeRobot."""

    @abc.abstractmethod
    def calibrate(self):
        """The member `calibrate` of LeRobot."""

    @abc.abstractmethod
    def configure(self):
        """The member `configure` of LeRobot."""

    @abc.abstractmethod
    def get_action(self):
        """The member `get_action` of LeRobot."""

    @abc.abstractmethod
    def send_feedback(self, feedback):
        """The member `send_feedback` of LeRobot."""

    @abc.abstractmethod
    def disconnect(self):
        """The member `disconnect` of LeRobot."""
