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
        """As in LeRobot."""

    @property
    @abc.abstractmethod
    def feedback_features(self):
        """As in LeRobot."""

    @property
    @abc.abstractmethod
    def is_connected(self):
        """As in LeRobot."""

    @property
    @abc.abstractmethod
    def is_calibrated(self):
        """As in LeRobot."""

    @abc.abstractmethod
    def connect(self, calibrate=True):
        """As in LeRobot."""

    @abc.abstractmethod
    def calibrate(self):
        """As in LeRobot."""

    @abc.abstractmethod
    def configure(self):
        """As in LeRobot."""

    @abc.abstractmethod
    def get_action(self):
        """As in LeRobot."""

    @abc.abstractmethod
    def send_feedback(self, feedback):
        """As in LeRobot."""

    @abc.abstractmethod
    def disconnect(self):
        """As in LeRobot."""
