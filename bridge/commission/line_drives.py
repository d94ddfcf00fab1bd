"""The drives of a deployment that take torques by a profile, as `cosim doctor` knows them."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from bridge.can.codec import Codec
from bridge.deployment.drive_messages import command_codec, feedback_codec, profile_of
from bridge.deployment.drive_sequences import Foreign
from bridge.deployment.spec import Deployment
from bridge.drives.status import DriveTold
from bridge.native.commanded import CommandedStruct
from bridge.safety.limits import to_si


@dataclass(eq=False)
class LineDrive:
    """A drive of the deployment, and what it has told: its state, its position (rad).

    `joint`: the signal that carries its torque; `host`: the node that commands it. `limit`: of the
    torque at the joint, N.m, the lower one of guard and profile. `entry`: what the node's own
    functions know of it, from its first bring-up on.
    """

    foreign: Foreign
    joint: str
    host: str
    command: Codec
    position: Codec | None
    limit: float = 0.0
    entry: CommandedStruct | None = None
    q: float | None = None

    @property
    def name(self) -> str:
        """``drive 1 on bus left``."""
        return self.foreign.name

    @property
    def heard(self) -> int:
        """The number of states it has told since its last bring-up began."""
        return 0 if self.entry is None else int(self.entry.heard)

    @property
    def told_ns(self) -> int:
        """The time of the last state it told, CLOCK_MONOTONIC; -1: never."""
        return -1 if self.entry is None else int(self.entry.told_ns)

    @property
    def state(self) -> DriveTold | None:
        """The state that it told last; None: nothing yet, or one that its profile does not have."""
        if self.entry is None or not self.heard or self.entry.row < 0:
            return None
        return self.foreign.profile.status.states[int(self.entry.row)]

    def is_enabled(self) -> bool:
        """Tell if the state that it told last is an enabled one."""
        return self.state is not None and self.state.kind == "enabled"

    @property
    def says(self) -> str:
        """That state for people."""
        if self.entry is None or not self.heard:
            return "nothing"
        return self.foreign.profile.status.describe(int(self.entry.word))


def line_drives(d: Deployment) -> list[LineDrive]:
    """The drives that take torques by a profile, in the order of the deployment."""
    found: dict[tuple[str, int], LineDrive] = {}
    owner = {part: name for name, spec in d.nodes.items() for part in spec.components}
    for name, spec in d.messages.items():
        torque = next((c for c in spec.carries if c.partition(".")[2].startswith("tau")), "")
        host = owner.get(torque.partition(".")[0], "")
        if not spec.profile or not host or (spec.bus, spec.drive) in found:
            continue
        profile = profile_of(d, name)
        gear = spec.gear if profile.side == "motor" else 1.0
        found[spec.bus, spec.drive] = LineDrive(
            Foreign(spec.bus, profile, spec.drive),
            torque,
            host,
            command_codec(d, name),
            feedback_codec(d, name, "q"),
            _limit(d, torque, profile.limits.get("tau_max", inf) * gear),
        )
    return list(found.values())


def _limit(d: Deployment, torque: str, most: float) -> float:
    """The limit of a torque (``component.tau[0]``) at the joint, N.m; `most`: of its drive."""
    component, _, index = torque.partition(".")
    found = [most]
    for name, node in d.nodes.items():
        limit = node.guard.tau_max if node.guard and component in node.components else None
        if limit is not None:
            at = int(index.partition("[")[2].rstrip("]") or 0)
            value = limit if isinstance(limit, str | float | int) else limit[at]
            found.append(to_si(value, "N.m", d.place("nodes", name, "guard", "tau_max")))
    return min(found) if min(found) < inf else 0.0
