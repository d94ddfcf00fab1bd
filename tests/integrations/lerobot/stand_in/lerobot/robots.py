"""Abstract classes with the members of lerobot.robots (0.4.4)."""

import abc
from dataclasses import dataclass
from typing import ClassVar


class Registry:
    """Kinds of a configuration by name."""

    known: ClassVar[dict] = {}

    @classmethod
    def register_subclass(cls, name):
        """Register a kind."""

        def register(kind):
            cls.known[name] = kind
            return kind

        return register


@dataclass(kw_only=True)
class RobotConfig(Registry):
    """The configuration of a robot."""

    id: str | None = None
    known: ClassVar[dict] = {}


class Robot(abc.ABC):
    """The abstract robot."""

    def __init__(self, config):
        self.id = config.id

    @property
    @abc.abstractmethod
    def observation_features(self):
        """As in LeRobot."""

    @property
    @abc.abstractmethod
    def action_features(self):
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
    def get_observation(self):
        """As in LeRobot."""

    @abc.abstractmethod
    def send_action(self, action):
        """As in LeRobot."""

    @abc.abstractmethod
    def disconnect(self):
        """As in LeRobot."""
