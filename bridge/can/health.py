"""State of a bus: counters of the tick, and the kernel's state of the interface."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from bridge.native.bus import Bus, BusState, Rate, last_second

#: What may be wrong with a bus, in words, by the count that tells it.
WRONG = {
    "send_failed": "not sent",
    "overruns": "lost on the way in",
    "error_frames": "error frames",
    "restarts": "restarts",
    "peers_left": "times a peer left",
    "oversized": "longer than any message",
    "log_dropped": "not logged",
}


@dataclass(frozen=True)
class InterfaceCounters:
    """Counters of a network interface since it exists, from /proc/net/dev: frames, not packets."""

    received: int
    receive_errors: int
    receive_dropped: int
    sent: int
    send_errors: int
    send_dropped: int


@dataclass(frozen=True)
class BusHealth:
    """A bus at one moment. Counts are frames since it was opened."""

    name: str
    state: BusState
    received: int
    sent: int
    send_failed: int
    """Not handed over: queue full (ENOBUFS), interface down, refused."""
    overruns: int
    """Arrived, and lost before the tick read them: the queue was full."""
    error_frames: int
    restarts: int
    """After bus-off, and after the interface was down."""
    tx_errors: int
    rx_errors: int
    """Error counters of the controller, where its error frames carry them; else 0."""
    clock_steps: int
    """Times the wall clock was set by 1 ms or more while frames were stamped with it."""
    log_dropped: int
    last_error: str
    """Of the last frame that could not be sent or received; "": none."""
    last_second: Rate
    interface: InterfaceCounters | None = None
    foreign: int = 0
    """Received, but nothing this node listens to: another identifier or another format."""
    peers_left: int = 0
    """Times the presence of a peer ended; on Zenoh only."""
    oversized: int = 0
    """Longer than any message can be; on Zenoh only."""

    @property
    def ok(self) -> bool:
        """True if the bus works and nothing was lost at this end."""
        lost = self.overruns or self.send_failed or self.log_dropped
        return self.state <= BusState.WARNING and not lost

    def sentence(self) -> str:
        """State and what is wrong, in words."""
        wrong = [f"{n} {what}" for key, what in WRONG.items() if (n := getattr(self, key))]
        reason = [self.last_error] if self.last_error else []
        state = self.state.name.lower()
        return f"{self.name}: {', '.join([state, *wrong, *reason])}"


def bus_health(bus: Bus, name: str, now_ns: int, interface: str = "") -> BusHealth:
    """The health of a bus now (`now_ns`, monotonic); `interface`: the one to ask, if any."""
    s = bus.struct
    return BusHealth(
        name=name,
        state=bus.state,
        received=s.received,
        sent=s.sent,
        send_failed=s.send_failed,
        overruns=s.overruns,
        error_frames=s.error_frames,
        restarts=s.restarts,
        tx_errors=s.tx_errors,
        rx_errors=s.rx_errors,
        clock_steps=s.clock_steps,
        log_dropped=bus.log.dropped if bus.log is not None else 0,
        last_error=os.strerror(s.last_errno) if s.last_errno else "",
        last_second=last_second(bus.traffic, now_ns),
        interface=interface_counters(interface) if interface else None,
        foreign=s.foreign,
    )


def interface_counters(name: str, table: Path = Path("/proc/net/dev")) -> InterfaceCounters | None:
    """Counters of a network interface; None if the interface or the table does not exist."""
    try:
        lines = table.read_text().splitlines()
    except OSError:
        return None
    for line in lines:
        head, colon, tail = line.partition(":")
        if colon and head.strip() == name:
            n = [int(x) for x in tail.split()]
            return InterfaceCounters(n[1], n[2], n[3], n[9], n[10], n[11])
    return None
