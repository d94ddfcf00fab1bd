"""The keys that both plug-ins have: joints, loop, and the connection between the two sides."""

from __future__ import annotations

from dataclasses import dataclass, field

from cosim.base.errors import ScenarioError
from cosim.links.keys import Drop, Semantics, Take
from lerobot_robot_cosim.connection import Connection, LinkOptions, closed, opened


@dataclass(kw_only=True)
class LinkSettings:
    """Keys of the plug-ins; those of a connection have to be equal on both sides.

    `joints`: names of the joints, in the order of the robot; an action has ``JOINT.pos``, and an
    observation ``JOINT.pos`` and, with `torques`, ``JOINT.torque``. `start`: positions until
    something has come, in the unit of the robot; default 0. `fps`: cycles of the loop in a second.
    `connection`: the name of the pair in this process, or the prefix of its Zenoh keys.

    `there`, `back`: delays of actions and observations (:class:`.connection.LinkOptions`), with
    `there_loss`, `back_loss`, `semantics`, `playout`, `depth`, `drop`, `take` and `seed`.

    `listen`, `connect`: an endpoint of Zenoh, such as ``tcp/192.168.2.7:7461``; one of them makes
    the connection a Zenoh path.
    """

    joints: list[str] = field(default_factory=list)
    torques: bool = True
    start: list[float] = field(default_factory=list)
    fps: int = 30
    connection: str = "pair"
    there: str = "0 s"
    back: str = "0 s"
    there_loss: str = ""
    back_loss: str = ""
    semantics: Semantics = "newest-stamp"
    playout: float | None = None
    depth: int | None = None
    drop: Drop | None = None
    take: Take | None = None
    seed: int = 0
    listen: str = ""
    connect: str = ""

    @property
    def actions(self) -> tuple[str, ...]:
        """The names of the numbers of an action."""
        return tuple(f"{joint}.pos" for joint in self.joints)

    @property
    def observations(self) -> tuple[str, ...]:
        """The names of the numbers that come back."""
        found = [self.actions]
        if self.torques:
            found.append(tuple(f"{joint}.torque" for joint in self.joints))
        return tuple(name for names in found for name in names)

    def first(self) -> dict[str, float]:
        """The observation until something has come. Raises ScenarioError."""
        if self.start and len(self.start) != len(self.joints):
            raise ScenarioError(
                f"found {len(self.start)} positions, expected {len(self.joints)}: one a joint",
                "start",
            )
        found = dict.fromkeys(self.observations, 0.0)
        return found | dict(zip(self.actions, self.start, strict=False))

    def open(self, *, near: bool) -> Connection:
        """The connection of the operator's side (`near`) or the robot's. Raises ScenarioError."""
        if not self.joints:
            raise ScenarioError("found no joints, expected the names of the robot's", "joints")
        if not (self.listen or self.connect):
            rule = self.semantics, self.playout, self.depth, self.drop, self.take
            there = LinkOptions(self.there, self.there_loss, *rule)
            back = LinkOptions(self.back, self.back_loss, *rule)
            found = opened(self.connection, self.fps, there, back, self.seed)
            self._agree(found)
            return found
        from lerobot_robot_cosim.zenoh_path import ZenohConnection

        names = {"there": self.actions, "back": self.observations}
        return ZenohConnection(self.connection, self.listen, self.connect, names, near=near)

    def _agree(self, connection: Connection) -> None:
        """Refuse a side with other joints than the one that opened the connection."""
        mine = {"there": self.actions, "back": self.observations}
        if connection.names and connection.names != mine:
            closed(self.connection, connection)
            theirs = ", ".join(connection.names["back"])
            raise ScenarioError(
                f"found the observation {', '.join(mine['back'])} on one side of the connection "
                f"{self.connection} and {theirs} on the other, expected the same",
                "joints",
            )
        connection.names |= mine
