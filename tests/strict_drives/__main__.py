"""All drives of one bus, until the standard input ends or SIGTERM."""

from __future__ import annotations

import argparse
import contextlib
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import can

from tests.strict_drives.cia402 import Cia402
from tests.strict_drives.core import EventLog, Fault, Joint, Setup, StrictDrive, numbers
from tests.strict_drives.damiao import RANGES, Damiao
from tests.strict_drives.odrive import ODrive
from tests.strict_drives.ours import Ours

IP_MULTICAST_ALL = 49
TIMES = ("timeout", "enable", "answer", "jitter", "boot", "period", "beat")
#: s after the last frame from which a bus is quiet, and then between two looks: others want to
#: start meanwhile.
QUIET, SELDOM = 0.5, 0.02


class Group:
    """A multicast group as python-can opens it, without what it sends itself, which costs time.

    Python-can sends from the group's own port, the nodes do not.
    """

    def __init__(self, channel: str) -> None:
        from can.interfaces.udp_multicast.utils import unpack_message  # slow, and of this bus only

        self.unpack = unpack_message
        self.bus = can.Bus(interface="udp_multicast", channel=channel, fd=True)
        self.group = self.bus._multicast  # type: ignore[attr-defined]
        self.group._socket.setsockopt(0, IP_MULTICAST_ALL, 0)
        self.send, self.shutdown = self.bus.send, self.bus.shutdown

    def recv(self, timeout: float) -> can.Message | None:
        """The next frame of another, with the kernel's stamp; None: there is none in time."""
        while (got := self.group.recv(timeout)) is not None:
            data, sender, stamp = got
            if sender[1] != self.group.port:
                return self.unpack(data, replace={"timestamp": stamp})
            timeout = 0.0
        return None


def open_bus(interface: str, channel: str, fd: bool) -> can.BusABC | Group:
    """A bus of python-can."""
    if interface == "udp_multicast":
        return Group(channel)
    return can.Bus(interface=interface, channel=channel, fd=fd)


def arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="strict_drives", description=__doc__)
    parser.add_argument("kind", choices=("damiao", "odrive", "cia402", "ours"))
    parser.add_argument("--interface", default="socketcan")
    parser.add_argument("--channel", required=True)
    parser.add_argument("--drives", required=True, help="numbers, with commas")
    parser.add_argument("--types", default="4310", help="damiao: one, or one for each drive")
    parser.add_argument("--log", type=Path, required=True)
    parser.add_argument("--fault", action="append", default=[], help="[DRIVE:]KIND[=VALUE]@SECONDS")
    parser.add_argument("--fd", action="store_true")
    parser.add_argument("--armed", action="store_true", help="ours: armed by a switch")
    parser.add_argument("--torques", action="store_true", help="odrive: Get_Torques cyclic")
    parser.add_argument("--host", type=int, default=0)
    parser.add_argument("--look", type=float, default=1.0, help="ms between looks at the clock")
    for name in TIMES:
        default = getattr(Setup(), name) * 1e3
        parser.add_argument(f"--{name}", type=float, default=default, help="ms")
    for name, default in (("start", "0"), ("inertia", "1"), ("damping", "1"), ("spring", "0")):
        parser.add_argument(f"--{name}", default=default, help="one, or one for each drive; SI")
    return parser.parse_args(words)


def each(text: str, n: int) -> list[float]:
    """A number for each drive."""
    found = list(numbers(text))
    return found * n if len(found) == 1 else found


def made(a: argparse.Namespace, log: EventLog) -> dict[int, StrictDrive]:
    """The drives of the command."""
    setup = Setup(host=a.host, fd=a.fd, **{name: getattr(a, name) * 1e-3 for name in TIMES})
    names = [int(x) for x in numbers(a.drives)]
    n = len(names)
    q, inertia, damping, spring = (
        each(getattr(a, name), n) for name in ("start", "inertia", "damping", "spring")
    )
    types = a.types.split(",") if "," in a.types else [a.types] * n
    assert set(types) <= set(RANGES), f"--types: some of {', '.join(RANGES)}"
    build: dict[str, Callable[[int, int, Joint], StrictDrive]] = {
        "damiao": lambda k, m, joint: Damiao(m, setup, joint, log, types[k]),
        "odrive": lambda k, m, joint: ODrive(m, setup, joint, log, a.torques),
        "cia402": lambda k, m, joint: Cia402(m, setup, joint, log),
        "ours": lambda k, m, joint: Ours(m, setup, joint, log, a.armed),
    }
    found = {}
    for k, number in enumerate(names):
        joint = Joint(q[k], inertia[k], damping[k], spring[k])
        drive = found[number] = build[a.kind](k, number, joint)
        faults = (Fault.parse(text) for text in a.fault)
        drive.faults = [f for f in faults if not f.drives or number in f.drives]
    return found


def serve(
    bus: can.BusABC | Group,
    drives: dict[int, StrictDrive],
    ended: Callable[[], bool],
    often: float,
) -> None:
    """Until the end: what has arrived first, then what the clocks of the drives bring.

    `often`: s between two looks at the clock where nothing comes.
    """
    due: list[tuple[float, int, can.Message]] = []
    count, heard = 0, 0.0
    while not ended():
        now = time.time()
        look = often if now - heard < QUIET else SELDOM
        m = bus.recv(0 if due and due[0][0] <= now else look)
        untold = [drive for drive in drives.values() if drive.told is None]
        if m is None:
            for drive in drives.values():
                drive.inject(now)
                drive.tick(now)
        else:
            stamp = m.timestamp or now
            heard = now
            for drive in drives.values():
                drive.inject(stamp)
                if drive.hears(m, stamp):
                    drive.receive(m, stamp)
        for drive in drives.values():
            for at, message in drive.out:
                count += 1
                due.append((at, count, message))
            drive.out.clear()
        due.sort(key=lambda entry: entry[:2])
        while due and due[0][0] <= time.time():
            bus.send(due.pop(0)[2])
        for drive in untold:  # frames that came while this process stood still had been sent before
            if drive.told is not None:
                drive.told = max(drive.told, time.time())


def main(words: Sequence[str] | None = None) -> int:
    a = arguments(words)
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append(1))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal's Ctrl-C is for others
    with contextlib.suppress(OSError, AttributeError):
        # The drives of the other bus come in turn, also while the frames of this one never end.
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(40))

    def ended() -> bool:
        return bool(stopped) or bool(select.select([sys.stdin], [], [], 0)[0])

    bus = open_bus(a.interface, a.channel, a.fd or a.kind == "ours")
    with a.log.open("w", encoding="utf-8") as file:
        log = EventLog(file)
        drives = made(a, log)
        print("ready", flush=True)
        serve(bus, drives, ended, a.look * 1e-3)
        for drive in drives.values():
            drive.summary(time.time())
    bus.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
