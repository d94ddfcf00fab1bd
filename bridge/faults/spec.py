"""The tables of a fault script, one struct per kind, with its keys (docs/faults.md)."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from cosim.base.convert import Number

Names = str | tuple[str, ...]
Range = Number | tuple[Number, Number]
Count = Annotated[int, msgspec.Meta(ge=1, le=2**20)]


class Spec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One table ``[[fault]]``; its fields are the keys allowed for its kind."""

    kind: str


class DriveFaultSpec(Spec, frozen=True, kw_only=True, rename={"lasts": "for"}):
    """Something happens to the emulated drives with these numbers on `bus`, which `does` names.

    `code`: the vendor's error (trip), what is added to its identifiers (other-id), the part that is
    hot (1: electronics, 2: motor); `by`: how much later it answers (late); `lasts`: until it is
    over, where it can be; default: never.
    """

    bus: Names
    drive: int | tuple[int, ...]
    does: Literal["trip", "reboot", "unplug", "late", "other-id", "old", "hot", "drop"]
    at: Number
    code: Annotated[int, msgspec.Meta(ge=-(2**31), lt=2**32)] = 1
    by: Number = 0
    lasts: Number | None = None


class SyncLossSpec(Spec, frozen=True, kw_only=True, rename={"start": "from", "end": "to"}):
    """The messages called SYNC are not received. No `end`: to the end of the run."""

    node: Names = "*"
    start: Number = 0
    end: Number | None = None
    probability: Number = 1


class DropSpec(SyncLossSpec, frozen=True, kw_only=True):
    """Frames are not received: of `message` (a name, a pattern or an identifier), on `bus`."""

    message: str | int | tuple[str | int, ...] = "*"
    bus: str = ""


class CountSpec(DropSpec, frozen=True, kw_only=True):
    """`burst`: frames lost in a row; `corrupt`: bits flipped in one."""

    count: Count = 1


class LateSpec(DropSpec, frozen=True, kw_only=True):
    """`delay`, `jitter`: by so long, or by a time between two."""

    by: Range


class DuplicateSpec(CountSpec, frozen=True, kw_only=True):
    """`count` more, each `by` later than the first."""

    by: Range = 0


class ReorderSpec(DropSpec, frozen=True, kw_only=True):
    """After the next one, or `within` so long if there is none."""

    within: Number = 1


class ForgeSpec(CountSpec, frozen=True, kw_only=True):
    """One more, with the right CRC: `by` is added to its values, its counter `count` ahead."""

    by: Range = 1.0


class AbsurdSpec(DropSpec, frozen=True, kw_only=True):
    """Its values become so large, of both signs, with the right CRC."""

    by: Range = 1e6


class FloodSpec(DropSpec, frozen=True, kw_only=True):
    """Valid frames with continuing counters at this rate."""

    rate: Number


class KillSpec(Spec, frozen=True, kw_only=True):
    """SIGKILL, for good."""

    node: Names
    at: Number


class RestartSpec(KillSpec, frozen=True, kw_only=True, rename={"lasts": "for"}):
    """SIGKILL, and a new process `lasts` later."""

    lasts: Number = 0


class FreezeSpec(KillSpec, frozen=True, kw_only=True, rename={"lasts": "for"}):
    """SIGSTOP, and SIGCONT `lasts` later."""

    lasts: Number


class NoiseSpec(KillSpec, frozen=True, kw_only=True):
    """`count` random bytes on the serial line of an image, before what it sends next."""

    count: Count = 16


class ClockJumpSpec(KillSpec, frozen=True, kw_only=True):
    """The node's clock jumps `by`, forwards or (negative) back."""

    by: Number


class BusDownSpec(Spec, frozen=True, kw_only=True, rename={"lasts": "for"}):
    """The interface is down for `lasts`."""

    bus: Names
    at: Number
    lasts: Number


class BabbleSpec(Spec, frozen=True, kw_only=True, rename={"start": "from", "end": "to"}):
    """A babbling node sends frames of `length` bytes with this identifier at this rate."""

    bus: Names
    id: Annotated[int, msgspec.Meta(ge=0, le=0x9FFFFFFF)]
    rate: Number
    length: Annotated[int, msgspec.Meta(ge=0, le=64)] = 8
    start: Number = 0
    end: Number | None = None


class NetDownSpec(Spec, frozen=True, kw_only=True, rename={"lasts": "for"}):
    """Nothing gets from one host to another on `link` (``FROM>TO``, ``"*"``: any) for `lasts`."""

    at: Number
    lasts: Number
    link: str = "*"


class NetDelaySpec(NetDownSpec, frozen=True, kw_only=True):
    """Packets take so long, redrawn every 30 ms; not `ordered`: they may overtake."""

    by: Range
    ordered: bool = True


class NetLossSpec(NetDownSpec, frozen=True, kw_only=True):
    """Packets are lost with this probability, in runs of `burst` on average."""

    probability: Number
    burst: Number = 1


class NetRateSpec(NetDownSpec, frozen=True, kw_only=True):
    """A link of `rate` bit/s with an unlimited queue."""

    rate: Number


SPECS: dict[str, type[Spec]] = {
    "drop": DropSpec,
    "burst": CountSpec,
    "delay": LateSpec,
    "jitter": LateSpec,
    "duplicate": DuplicateSpec,
    "reorder": ReorderSpec,
    "corrupt": CountSpec,
    "forge": ForgeSpec,
    "replay": CountSpec,
    "absurd": AbsurdSpec,
    "flood": FloodSpec,
    "sync-loss": SyncLossSpec,
    "kill": KillSpec,
    "restart": RestartSpec,
    "freeze": FreezeSpec,
    "noise": NoiseSpec,
    "clock-jump": ClockJumpSpec,
    "bus-down": BusDownSpec,
    "babble": BabbleSpec,
    "net-down": NetDownSpec,
    "net-delay": NetDelaySpec,
    "net-loss": NetLossSpec,
    "net-rate": NetRateSpec,
    "drive": DriveFaultSpec,
}
