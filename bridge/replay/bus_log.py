"""Frames of a bus log as a deployment sees them: buses, samples by sequence number, t = 0."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bridge.can.codec import Codec
from bridge.can.log import FrameLog, frame_of, read_log
from bridge.deployment.carried import Carried
from bridge.deployment.spec import BusSpec
from bridge.deployment.system import System
from bridge.native.bus import Accept
from bridge.native.load import frame_time_ns
from bridge.native.message import Decoded
from bridge.native.safety import LifeState
from cosim.base.errors import ScenarioError
from cosim.bus.timing import Bits

#: Bits of a status byte that say in which state its sender is.
LIFE = 7
#: Frames of a message that have to fit a guess of t = 0, and how many guesses there are: counters
#: of 4 bits at 200 Hz and stamps of 16 bits begin again together after 41 s.
ASKED, GUESSES = 50, 625


@dataclass(frozen=True, slots=True)
class LoggedSample:
    """A frame of a message that passed its checks; times in ns, `t_ns` as logged.

    `wire_ns`: from its first bit to the end of its last, when it is received.
    """

    t_ns: int
    wire_ns: int
    counter: int
    stamp_us: int
    life: int  # of its sender; -1: the message does not tell
    values: NDArray[np.float64]

    @property
    def running(self) -> bool:
        """True if its sender was in the run, according to the status."""
        return self.life not in (LifeState.UNCONFIGURED, LifeState.INACTIVE)


def read_buses(system: System, logs: Sequence[Path]) -> dict[str, NDArray[np.void]]:
    """Rows (n,) of frames by bus of the deployment, in order of time.

    The bus of a log is the one with its channel or name, or with the name of its file. Raises
    ScenarioError for a log of another bus, LogError for a file that is not a log.
    """
    found: dict[str, list[NDArray[np.void]]] = {}
    for path in logs:
        log = read_log(path)
        for number, name in enumerate(log.buses):
            bus = _bus(system, name, path, log)
            found.setdefault(bus, []).append(log.rows[log.rows["bus"] == number])
    joined = {name: np.concatenate(parts) for name, parts in found.items()}
    return {name: rows[np.argsort(rows["t_ns"], kind="stable")] for name, rows in joined.items()}


def _bus(system: System, name: str, path: Path, log: FrameLog) -> str:
    buses = {n: b for n, b in system.deployment.buses.items() if b.kind == "can"}
    for bus, spec in buses.items():
        if name in (bus, spec.channel):
            return bus
    if path.stem in buses and len(log.buses) == 1:
        return path.stem
    if len(buses) == 1:
        return next(iter(buses))
    known = ", ".join(f"{n} ({b.channel})" for n, b in buses.items())
    raise ScenarioError(f"bus {name!r} is none of the deployment; it has {known}", str(path))


def samples(carried: Carried, rows: NDArray[np.void], bus: BusSpec) -> Iterator[LoggedSample]:
    """The samples of a message, frame by frame; `rows` (n,) are the frames of its bus."""
    codec = carried.encoding
    assert isinstance(codec, Codec)
    intermission = bus.timing.time_ns(Bits(3))
    tells = codec.layout.status_mask & LIFE == LIFE
    for row in rows[Accept.of(codec.message).among(rows)]:
        frame = frame_of(row)
        result, values, header = codec.decode(frame.payload)
        if result is Decoded.OK:
            life = header.status & LIFE if tells else -1
            wire = frame_time_ns(frame, bus.timing) - intermission
            yield LoggedSample(frame.t_ns, wire, header.counter, header.t_us, life, values)


def start_of(system: System, heard: Mapping[str, Sequence[LoggedSample]]) -> int:
    """Time of t = 0 on the log's clock, ns, from the time stamps in the frames.

    A stamp of 16 bits gives it modulo 65.5 ms; counters and slots resolve this, which is unique
    for 41 s at 200 Hz. Raises ScenarioError if no message has a time stamp.
    """
    bits = max((_time_bits(system.messages[n]) for n, s in heard.items() if s), default=0)
    if not bits:
        raise ScenarioError("no message with a time stamp in the log; give the time of t = 0")
    stamped = {n: s for n, s in heard.items() if s and _time_bits(system.messages[n]) == bits}
    running = [s for frames in stamped.values() for s in frames if s.running]
    if not running:
        raise ScenarioError(f"no {', '.join(stamped)} of a node that was running in the log")
    span = 1000 << bits
    first = _origin(running[0])
    start = first + min((_origin(s) - first + span // 2) % span - span // 2 for s in running)
    if bits >= 32:
        return start
    start += (min(s.t_ns for s in running) - start) // span * span
    fitting, late = np.ones(GUESSES, np.bool_), np.zeros(GUESSES)
    for name, frames in stamped.items():
        asked = [s for s in frames if s.running][:ASKED]
        if asked:
            fits, after = _at_guesses(system.messages[name], asked, start, span)
            fitting &= fits
            late += after
    if not fitting.any():
        raise ScenarioError(f"counters of {', '.join(stamped)} fit no common t = 0")
    return start - span * int(np.argmin(np.where(fitting, late, np.inf)))


def _origin(sample: LoggedSample) -> int:
    """The time that t = 0 would have if the frame was not held up: the earliest possible; ns."""
    return sample.t_ns - sample.wire_ns - 1000 * sample.stamp_us


def _time_bits(carried: Carried) -> int:
    codec = carried.encoding
    assert isinstance(codec, Codec)
    return codec.layout.time_bits


def _at_guesses(
    carried: Carried, asked: Sequence[LoggedSample], start: int, span: int
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """True if samples have the counters that they would have, and ns from their slots to them.

    (GUESSES,) each, of t = 0 at `start` and some `span` (ns) before. One counter in ten may be
    wrong. Samples are stamped with the begin of a slot: at another t = 0 they would lie between.
    """
    since = np.array([sent_ns(carried, s, start) for s in asked]) - carried.offset_ns + 1000
    numbers, after = np.divmod(since + span * np.arange(GUESSES)[:, None], carried.period_ns)
    turn = 1 << counter_bits(carried)
    wrong = ((numbers - [s.counter for s in asked]) % turn != 0).sum(axis=1)
    early = asked[0].t_ns - start + span * np.arange(GUESSES) < 0
    return (wrong <= len(asked) // 10) & ~early, after.min(axis=1)


def counter_bits(carried: Carried) -> int:
    """The number of bits of a message's counter; 0: it has none."""
    codec = carried.encoding
    assert isinstance(codec, Codec)
    return codec.layout.counter.length if codec.layout.counter else 0


def sent_ns(carried: Carried, sample: LoggedSample, start: int) -> int:
    """The time since `start` at which it was sent, by its stamp, else by the log; ns."""
    arrival = sample.t_ns - start
    bits = _time_bits(carried)
    if not bits:
        return arrival
    span = 1 << bits
    behind = (sample.stamp_us - arrival // 1000 - span // 4) % span - span * 3 // 4
    return (arrival // 1000 + behind) * 1000


def sequence(carried: Carried, sample: LoggedSample, start: int) -> int:
    """Number of the sample: the slot of its sender in which it was sent, by hits of the message."""
    t = sent_ns(carried, sample, start) - carried.offset_ns
    number = (t + 1000) // carried.period_ns  # a stamp is cut to us
    bits = counter_bits(carried)
    if not bits:
        return number
    # Late by whole periods: the counter is right, the time only near.
    behind = (number - sample.counter + (1 << bits - 1)) % (1 << bits) - (1 << bits - 1)
    return number - behind if abs(behind) <= (1 << bits) // 4 else number
