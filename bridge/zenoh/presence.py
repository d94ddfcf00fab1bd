"""Who is there: liveliness tokens of nodes, and whether somebody listens to what is published."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import final

import zenoh

from bridge.can.socket import BusError
from bridge.zenoh.names import Names
from cosim.clock import sleep, stopwatch

#: s between two looks.
LOOK = 0.02


@final
class Presence:
    """The nodes of a bus whose tokens are there; `node` declares its own with :meth:`declare`."""

    def __init__(self, session: zenoh.Session, names: Names, node: str) -> None:
        self._session, self._names, self._node = session, names, node
        self._there: set[str] = set()
        self.lost = 0
        """Times a token went away."""
        self._token: zenoh.LivelinessToken | None = None
        self._subscriber = session.liveliness().declare_subscriber(
            names.of("*", "alive"), zenoh.handlers.Callback(self._changed, indirect=True),
            history=True,
        )  # fmt: skip

    def _changed(self, sample: zenoh.Sample) -> None:
        node = str(sample.key_expr).split("/")[-2]
        if sample.kind == zenoh.SampleKind.PUT:
            self._there.add(node)
        elif node in self._there:
            self._there.discard(node)
            self.lost += 1

    @property
    def there(self) -> frozenset[str]:
        """Nodes whose token is there, this one's not counted."""
        return frozenset(self._there - {self._node})

    def declare(self) -> None:
        """This node is there: after its subscriptions, so that who sees it is heard by it."""
        self._token = self._session.liveliness().declare_token(self._names.of(self._node, "alive"))

    def wait(
        self,
        peers: Iterable[str],
        publishers: Mapping[str, zenoh.Publisher],
        seconds: float,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        """Until all `peers` are there and all `publishers` (by key) have a subscriber.

        Raises BusError after `seconds` (s), naming what is missing.
        """
        elapsed = stopwatch()
        wanted = set(peers)
        while not stop():
            absent = sorted(wanted - self._there)
            unheard = [key for key, p in publishers.items() if not _matching(p)]
            if not absent and not unheard:
                return
            if elapsed() > seconds:
                raise BusError(_missing(absent, unheard, seconds))
            sleep(LOOK)


def _matching(publisher: zenoh.Publisher) -> bool:
    """Zenoh's stub says bool; what comes is an object that is always true."""
    status: object = publisher.matching_status
    return bool(getattr(status, "matching", status))


def _missing(absent: list[str], unheard: list[str], seconds: float) -> str:
    said = []
    if absent:
        said.append(f"not there: {', '.join(absent)}")
    if unheard:
        said.append(f"nobody listens to {', '.join(unheard)}")
    return (
        f"{'; '.join(said)} after {seconds:g} s; do these nodes run, with the same prefix, and "
        "do endpoints, certificates and access rules let them connect?"
    )
