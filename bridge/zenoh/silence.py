"""Peers that are there but say nothing any more: what a session does not notice by itself.

After a partition that only one end of a connection has noticed, Zenoh's other end may keep a
transport nothing comes through. Its peer's token is still there; only a new session hears it again.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import final

#: s between two looks.
LOOK = 0.5
#: A peer is silent after so long, s, and after so many leases.
SILENT, LEASES = 5.0, 1.5


@final
class Silence:
    """How long each peer that was heard once has been silent; `counts`: messages by key.

    `senders`: the node that says each key. Whoever hears counts up; :meth:`silent` looks.
    """

    def __init__(self, senders: Mapping[str, str], lease: float) -> None:
        self.counts = dict.fromkeys(senders, 0)
        self.limit_ns = round(1e9 * max(SILENT, LEASES * lease))
        self._keys = {
            node: [key for key in senders if senders[key] == node]
            for node in sorted(set(senders.values()))
        }
        self._seen = dict.fromkeys(self._keys, 0)
        self._last: dict[str, int] = {}
        self._factor = dict.fromkeys(self._keys, 1)

    def silent(self, there: Collection[str], now_ns: int) -> list[str]:
        """Peers of `there` that were heard before and have said nothing for too long.

        Who has been named is so again only after twice the time, until it is heard.
        """
        found = []
        for node, keys in self._keys.items():
            count = sum(self.counts[key] for key in keys)
            if count != self._seen[node]:
                self._seen[node], self._last[node], self._factor[node] = count, now_ns, 1
            elif node not in there:
                self._last.pop(node, None)
            elif now_ns - self._last.setdefault(node, now_ns) > self.limit_ns * self._factor[node]:
                if count:
                    found.append(node)
                    self._factor[node] *= 2
                self._last[node] = now_ns
        return found
