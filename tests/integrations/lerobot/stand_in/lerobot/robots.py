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
        """The member `observation_features` of LeRobot."""

    @property
    @abc.abstractmethod
    def action_features(self):
        """The member `action_features` of LeRobot."""

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
    def get_observation(self):
        """The member `get_observation` of LeRobot."""

    @abc.abstractmethod
    def send_action(self, action):
        """The member `send_action` of LeRobot."""

    @abc.abstractmethod
    def disconnect(self):
        """The member `disconnect` of LeRobot."""
