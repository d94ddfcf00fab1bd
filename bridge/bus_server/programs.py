"""Programs that run in the time of a simulated bus, unmodified, from their start to their end."""

from __future__ import annotations

import contextlib
import os
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import final

from bridge.bus_server.can_sockets import CanSockets
from bridge.bus_server.listener import listen
from bridge.bus_server.program_file import ProgramError, check_program
from bridge.bus_server.program_table import ProgramTable, ProgramThread, preload_path
from bridge.bus_server.program_time import ProgramTime
from bridge.bus_server.server import BusServer
from bridge.simulated_can.channel import Channel
from bridge.simulated_can.options import ChannelOptions
from bridge.simulated_can.protocol import BUS_TABLE, SERVED_BUS, BusAddress
from cosim.base.clock import monotonic_ns, sleep

DATE = 1_767_225_600
"""CLOCK_REALTIME of programs at time 0 of the bus by default, s: 2026-01-01 00:00 UTC."""
MONOTONIC_NS = 1_000_000_000_000
"""CLOCK_MONOTONIC of programs at time 0 of the bus, ns."""
MOST_COMPUTING_NS = 60_000_000_000
"""Processor time for which a thread may compute without waiting by default, ns."""
_GRACE_NS = 2_000_000_000
"""Wall time that programs have to end after SIGTERM, ns."""
_IDLE = 0.01


@final
class Programs:
    """Starts `commands` on a bus whose time passes when all their threads wait.

    `channel` names the bus; `date`: CLOCK_REALTIME at time 0, s. Close it to end what still runs.
    Raises ProgramError for a program that cannot be run so, before any is started.
    """

    def __init__(
        self,
        name: str,
        options: ChannelOptions,
        commands: Sequence[Sequence[str]],
        *,
        date: float = DATE,
        most_computing_ns: int = MOST_COMPUTING_NS,
    ) -> None:
        for command in commands:
            check_program(command)
        self._most = most_computing_ns
        self._commands = commands
        self._busy: tuple[ProgramThread, int] | None = None
        self._started: list[subprocess.Popen[bytes]] = []
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="cosim-bus-")))
            table = ProgramTable(folder / "table", round(date * 1e9), MONOTONIC_NS)
            self.time = ProgramTime(table, date)
            self.channel = Channel(name, options, self.time.shared)
            address = BusAddress(name, "", 0, str(folder / "bus"))
            server = BusServer(self.channel, listen(address), attention=self.time.attention)
            stack.callback(server.close)
            self.time.sockets = CanSockets(folder / "sockets", self.channel)
            stack.callback(self.time.sockets.close)
            self._given = {
                "LD_PRELOAD": os.pathsep.join(
                    filter(None, (str(preload_path()), os.environ.get("LD_PRELOAD")))
                ),
                BUS_TABLE: str(folder / "table"),
                SERVED_BUS: f"{name}@{address.path}",
                "COSIM_BUS_SOCKETS": str(folder / "sockets"),
                "COSIM_BUS_INTERFACE": name,
                **({"COSIM_BUS_FD": "1"} if self.channel.timing.fd else {}),
            }
            self._stack = stack.pop_all()

    def start(self) -> None:
        """Start all programs. Raises ProgramError."""
        usual = {
            "CAN_INTERFACE": "cosim",
            "CAN_CHANNEL": str(self.channel.name),
            "PYTHONHASHSEED": "0",
        }
        for number, command in enumerate(self._commands):
            environment: Mapping[str, str] = {
                **usual, **os.environ, **self._given, "COSIM_BUS_PROGRAM": str(number),
            }  # fmt: skip
            try:
                self._started.append(subprocess.Popen(command, env=environment))
            except OSError as error:
                raise ProgramError(f"{command[0]}: {error.strerror}") from error

    def run(self, seconds: float | None) -> int:
        """Let time pass until the last program has ended, or for so many s; the exit status.

        It is that of the last program, or of the first one before it that failed by itself.
        Raises ProgramError for a thread that computes without end.
        """
        from cosim.base.interrupts import act_on_signal

        end_ps = None if seconds is None else round(seconds * 1e12)
        while not self._is_over():
            act_on_signal()
            if not self._all_there() or not self.time.step(end_ps, self._is_over):
                if end_ps is not None and self.channel.now_ps >= end_ps:
                    break
                self._look()
            else:
                self._busy = None
        codes = [process.poll() for process in self._started]
        failed = next((code for code in codes if code), 0)
        return codes[-1] or failed or 0

    def close(self) -> None:
        """End the programs that still run, and the bus."""
        for signal in (subprocess.Popen.terminate, subprocess.Popen.kill):
            for process in self._started:
                if process.poll() is None:
                    signal(process)
            deadline = monotonic_ns() + _GRACE_NS
            while any(p.poll() is None for p in self._started) and monotonic_ns() < deadline:
                self.time.step(None)
        self._stack.close()

    def _is_over(self) -> bool:
        """True if the last program has ended."""
        return self._started[-1].poll() is not None

    def _all_there(self) -> bool:
        """True if each program has begun, or has ended already."""
        return all(
            self.time.table.threads(number) or process.poll() is not None
            for number, process in enumerate(self._started)
        )

    def _look(self) -> None:
        """Nothing went on: name a thread that computes for too long, else wait a little."""
        thread = self.time.table.culprit()
        used = _processor_ns(thread)
        if self._busy is None or self._busy[0] != thread:
            self._busy = (thread, used)
        elif used - self._busy[1] > self._most:
            raise ProgramError(
                f"{' '.join(self._commands[thread.program])}: found thread {thread.number} "
                f"(process {thread.pid}), which computes since {self._most / 1e9:g} s of processor "
                "time without waiting, so that bus time stands still; expected a call that waits, "
                "or a longer --most-computing"
            )
        sleep(_IDLE)


def _processor_ns(thread: ProgramThread) -> int:
    """The processor time of a thread, ns; 0 where it is gone."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        path = Path(f"/proc/{thread.pid}/task/{thread.tid or thread.pid}/schedstat")
        return int(path.read_text().split()[0])
    return 0
