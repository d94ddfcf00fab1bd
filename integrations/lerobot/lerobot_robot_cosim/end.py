"""The part that both plug-ins share: an end of a connection."""

from __future__ import annotations

from typing import ClassVar

from lerobot_robot_cosim.connection import Connection, Held, closed
from lerobot_robot_cosim.settings import LinkSettings


class LinkEnd:
    """An end of a connection; a plug-in names it before LeRobot's class.

    `near`: it is the operator's side. `held`: what it held at its last look.
    """

    near: ClassVar[bool]
    config: LinkSettings

    def __init__(self, config: LinkSettings) -> None:
        super().__init__(config)  # type: ignore[call-arg]
        self.config = config
        self.connection: Connection | None = None
        self.held = Held()
        self._known = config.first()

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
        self.connection = self.config.open(near=self.near)

    def disconnect(self) -> None:
        """Close the connection."""
        if self.connection is not None:
            closed(self.config.connection, self.connection)
            self.connection = None

    def _open(self) -> Connection:
        if self.connection is None:
            raise RuntimeError(f"{self} is not connected; expected connect() before")
        return self.connection
