"""The threads of clients, and the answers to their calls."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any, final

import can

from bridge.bus_server.remote_port import RemotePort
from bridge.simulated_can.options import ChannelOperationError
from bridge.simulated_can.pace import act_as
from bridge.simulated_can.protocol import CallSocket
from cosim.base.errors import CosimError

#: Exceptions of a call with senseless arguments; its client is told.
REFUSED = (
    CosimError, can.CanError, ValueError, TypeError, LookupError, ArithmeticError, AttributeError,
)  # fmt: skip


@final
class RemoteThread:
    """A thread of a client: one participant, on however many servers it has connections."""

    def __init__(self) -> None:
        self._connections = 0
        self._lock = threading.Lock()

    def is_alive(self) -> bool:
        """True if it has a connection."""
        return self._connections > 0

    def __enter__(self) -> None:
        with self._lock:
            self._connections += 1
        act_as(self)

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._connections -= 1


@final
class RemoteThreads:
    """The threads of all clients, by their names."""

    def __init__(self) -> None:
        self._known: dict[str, RemoteThread] = {}
        self._lock = threading.Lock()

    def of(self, name: str) -> RemoteThread:
        """The thread of this name; it is made when it is new."""
        with self._lock:
            return self._known.setdefault(name, RemoteThread())


@final
class ThreadCalls:
    """The calls of one thread, ``[method, bus, after, argument, ...]``, for the `ports` of buses.

    A call is taken after so many messages of its bus. A message that is posted has no answer; if
    it is refused, the next call of the thread is refused in its place.
    """

    def __init__(self, calls: CallSocket, ports: Mapping[int, RemotePort]) -> None:
        self._calls, self._ports = calls, ports
        self._used: dict[int, RemotePort] = {}
        self._failed: list[Any] | None = None

    def answer(self) -> bool:
        """Answer the next call; False if there is none, or the client is gone."""
        call = self._calls.receive()
        if not isinstance(call, list) or not call:
            return False
        try:
            answer = self._take(*call)
        except REFUSED as error:
            answer = refusal(error)
        if call[0] != "post":
            try:
                self._calls.send(answer)
            except OSError:
                return False
        elif answer is not None:
            self._failed = self._failed or answer
        return True

    def close(self) -> None:
        """The thread has no more calls."""
        for port in self._used.values():
            port.count(-1)

    def _take(self, method: str, bus: int, after: int, *arguments: Any) -> Any:
        port = self._used.get(bus) or self._enter(bus)
        port.reach(after)
        if method == "post":
            return port.post(after + 1, *arguments)
        if method == "send":
            port.take(after + 1)
        failed, self._failed = self._failed, None
        return failed or ["ok", port.call(method, *arguments), port.room()]

    def _enter(self, bus: int) -> RemotePort:
        port = self._ports.get(bus)
        if port is None:
            raise ChannelOperationError("found a bus that is not open")
        port.count(1)
        self._used[bus] = port
        return port


def refusal(error: Exception) -> list[Any]:
    """The answer to a call that is refused."""
    return ["error", type(error).__name__, str(error)]
