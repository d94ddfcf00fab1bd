"""Peers whose messages no longer arrive although the session exists, and their recovery.

There are three cases. After a partition that only one end of a connection has noticed, the other
end may keep a transport without traffic, and the peer's token remains. After a pause of a second, a
UDP listener may hold a datagram of a connection that it has given up, and then accepts no
connection, and the token is permanently lost. If a declaration was lost, only one key receives no
samples. In each case only a new session receives from the peer again.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import final

#: s between two looks.
LOOK = 0.25
#: A key is silent after so long, s, after so many leases, and after so many of its periods.
SILENT, LEASES, PERIODS = 5.0, 1.5, 4.0
#: The same, s, of a node whose token is gone, where this end listens over UDP.
GONE = 0.5


@final
class LostPeers:
    """Time for which each key has been silent; `counts`: messages by key.

    `senders`: the node that publishes each key; `lease`, s; `period`: the longest of a key, s;
    `udp`: whether this end listens over UDP. Receivers increment the counts; :meth:`silent` reads
    them.
    """

    def __init__(
        self, senders: Mapping[str, str], lease: float, *, period: float = 0.0, udp: bool = False
    ) -> None:
        self.counts = dict.fromkeys(senders, 0)
        self.limit_ns = round(1e9 * max(SILENT, LEASES * lease, PERIODS * period))
        self.gone_ns = round(1e9 * GONE) if udp else self.limit_ns
        self._senders = dict(senders)
        self._seen = dict.fromkeys(senders, 0)
        self._last: dict[str, int] = {}
        self._met: set[str] = set()
        self._factor = dict.fromkeys(senders, 1)

    def silent(self, there: Collection[str], now_ns: int) -> list[str]:
        """Nodes that have not published one of their keys for too long.

        `there`: nodes whose tokens are present; a node that was never present is not silent. A
        reported node is reported again only after twice the time, until it is received.
        """
        found = []
        self._met.update(there)
        for key, node in self._senders.items():
            count = self.counts[key]
            limit = self.limit_ns if node in there else self.gone_ns
            if count != self._seen[key]:
                self._seen[key], self._last[key], self._factor[key] = count, now_ns, 1
            elif (
                node in self._met
                and now_ns - self._last.setdefault(key, now_ns) > limit * self._factor[key]
            ):
                found.append(node)
                self._factor[key] *= 2
                self._last[key] = now_ns
        return sorted(set(found))
