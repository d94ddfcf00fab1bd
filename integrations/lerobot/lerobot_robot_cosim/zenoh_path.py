"""A direction over Zenoh: samples as in docs/network.md, with their date as the last value."""

from __future__ import annotations

import json
import threading
from collections.abc import Sequence

import zenoh

from bridge.deployment.zenoh_keys import codec
from bridge.native.message import Decoded
from cosim.base.clock import wall_time
from lerobot_robot_cosim.connection import Connection, Held

_NUMBER = 0x1000  # any: a direction has one message
_WRAP = 1 << 16


class ZenohDirection:
    """A direction between two processes, from one end: `sends`, or receives.

    Ages compare the dates of two hosts: they are as exact as these agree.
    """

    def __init__(self, session: zenoh.Session, key: str, names: Sequence[str], *, sends: bool):
        self._codec = codec(key, _NUMBER, [*names, "date"])
        self._sequence, self._held, self._date, self._began = -1, Held(), 0.0, 0.0
        self.refused = 0  # samples that were damaged, repeated or older
        self._lock = threading.Lock()
        if sends:
            self._publisher = session.declare_publisher(
                key, express=True, priority=zenoh.Priority.REAL_TIME,
                congestion_control=zenoh.CongestionControl.DROP,
            )  # fmt: skip
            self._end: zenoh.Publisher | zenoh.Subscriber[None] = self._publisher
        else:
            self._end = session.declare_subscriber(key, self._receive)

    def push(self, values: Sequence[float]) -> None:
        """Send a sample."""
        self._sequence += 1
        now = wall_time()
        self._began = self._began or now
        stamp = round((now - self._began) * 1e6) % 2**32
        self._publisher.put(self._codec.encode([*values, now], 0, stamp, self._sequence % _WRAP))

    def pull(self) -> Held:
        """The newest sample that has come."""
        with self._lock:
            if self._held.values is None:
                return self._held
            age = wall_time() - self._date
            return Held(self._held.values, self._held.sequence, age, self._held.delay)

    def _receive(self, sample: zenoh.Sample) -> None:
        now = wall_time()
        decoded, values, header = self._codec.decode(sample.payload.to_bytes())
        with self._lock:
            newest = self._sequence
            ahead = (header.counter - newest) % _WRAP if newest >= 0 else 1
            if decoded is not Decoded.OK or not 0 < ahead < _WRAP // 2:
                self.refused += 1
                return
            self._sequence = newest + ahead if newest >= 0 else int(header.counter)
            self._date = float(values[-1])
            read = tuple(float(v) for v in values[:-1])
            self._held = Held(read, self._sequence, now - self._date, now - self._date)

    def close(self) -> None:
        """Withdraw the publisher or subscriber."""
        self._end.undeclare()


class ZenohConnection(Connection):
    """A connection over a Zenoh session of its own, from one end.

    `listen`, `connect`: endpoints such as ``tcp/192.168.2.7:7461``; without scouting. `key`: the
    prefix of both keys. `names`: of the numbers in each direction, "there" and "back".
    """

    def __init__(
        self, key: str, listen: str, connect: str, names: dict[str, tuple[str, ...]], *, near: bool
    ) -> None:
        config = zenoh.Config()
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("scouting/gossip/enabled", "false")
        config.insert_json5("listen/endpoints", json.dumps([listen] if listen else []))
        config.insert_json5("connect/endpoints", json.dumps([connect] if connect else []))
        self._session = zenoh.open(config)
        there = ZenohDirection(self._session, f"{key}/there", names["there"], sends=near)
        back = ZenohDirection(self._session, f"{key}/back", names["back"], sends=not near)
        super().__init__(there, back, 1, dict(names))

    def close(self) -> None:
        """Close both directions and the session."""
        Connection.close(self)
        self._session.close()
