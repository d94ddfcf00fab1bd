"""The keys of a scenario for its simulated CAN buses.

::

    [bus.can0]
    bitrate = 500e3                   # bit/s
    fd = true                         # FD frames, with
    data_bitrate = 2e6                # this rate in their data phase
    [bus.can0.nodes.slave_control]    # a component, or a node of other traffic
    queue = "fifo"                    # "sorted" (default), "fifo" or "mailboxes"
    [[bus.can0.traffic]]
    kind = "periodic"                 # or "babbling", "random", "dbc", "log"
    id = 0x90
    period = "2 ms"
    [[bus.can0.errors]]
    kind = "rate"                     # or "script", "interruption"
    rate = 1e-6                       # of a bit

    [[links]]
    bus = "can0"
    frame = { id = 0x101, bytes = 8 }
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from cosim.base.convert import Number

Count = Annotated[int, msgspec.Meta(ge=1, le=65535)]


class LinkFrameSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The frame that carries a link: `data` as random bytes from the seed, all zero bits, or the
    values of its links in this type, one behind the other, low byte first.

    `offset`: how long after the sample the sender requests it. `scale`: the value of 1 in integers.
    """

    id: int
    bytes: Annotated[int, msgspec.Meta(ge=0, le=64)] = 8
    extended: bool = False
    fd: bool = False
    data: Literal["random", "zeros", "float32", "float64", "int16", "int32"] = "random"
    offset: Number = 0
    scale: Annotated[float, msgspec.Meta(gt=0)] = 1.0


class ScenarioBusNodeSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A node: its transmit queue, whether it recovers from bus-off automatically, and how much
    faster than nominal its clock is, parts per million.
    """

    queue: Literal["sorted", "fifo", "mailboxes"] = "sorted"
    length: Count = 64
    one_shot: bool = False
    recovers: bool = True
    clock_ppm: float = 0.0


class _Times(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    node: str = "traffic"
    start: Number = 0
    stop: Number | None = None


class PeriodicTraffic(_Times, frozen=True, tag_field="kind", tag="periodic"):
    """A frame every `period`, each late by up to `jitter` at random."""

    id: int
    period: Number
    bytes: Annotated[int, msgspec.Meta(ge=0, le=64)] = 8
    offset: Number = 0
    jitter: Number = 0
    extended: bool = False


class BabblingTraffic(_Times, frozen=True, tag_field="kind", tag="babbling"):
    """A node that asks for `share` of the bus with one identifier."""

    id: int
    share: float = 1.0


class RandomTraffic(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="random"
):
    """Frames of 8 bytes at random times that take `share` of the bus on average."""

    share: float
    node: str = "traffic"


class DbcTraffic(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="dbc"
):
    """The messages of a DBC file that have a period; `jitter` is a share of the period."""

    file: str
    jitter: float = 0.0


class LogTraffic(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="log"
):
    """A log as candump -l writes it, from its first frame on at `start`."""

    file: str
    node: str = "traffic"
    start: Number = 0


class RateErrors(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="rate"
):
    """Each bit is inverted with probability `rate`, `length` bits in a row."""

    rate: float
    length: Count = 1
    node: str = ""


class ScriptErrors(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="script"
):
    """Bit `bit` of the `attempt`-th attempt (0: each) to send `id` is inverted."""

    id: int
    bit: int
    attempt: int = 1
    length: Count = 1
    extended: bool = False
    node: str = ""


class InterruptionErrors(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="interruption"
):
    """A level that the bus, or `node`'s view of it, has from `start` to `stop`."""

    start: Number
    stop: Number
    level: Literal["inverted", "dominant", "recessive", "disconnected"] = "recessive"
    node: str = ""


Traffic = PeriodicTraffic | BabblingTraffic | RandomTraffic | DbcTraffic | LogTraffic
BusErrors = RateErrors | ScriptErrors | InterruptionErrors


class ScenarioBusSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A bus: bit rates (bit/s), nodes by name, traffic besides the links, and errors.

    `simulated`: ahead of the run or inside its ticks; "auto": ahead unless frames carry values.
    """

    bitrate: float = 500e3
    data_bitrate: float | None = None
    fd: bool = False
    simulated: Literal["auto", "ahead", "in-tick"] = "auto"
    nodes: dict[str, ScenarioBusNodeSpec] = {}
    traffic: tuple[Traffic, ...] = ()
    errors: tuple[BusErrors, ...] = ()
