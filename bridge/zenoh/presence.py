"""Presence: liveliness tokens of nodes, and subscribers of published messages."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import final

import zenoh

from bridge.can.socket import BusError
from bridge.deployment.zenoh_keys import Names
from bridge.zenoh.callbacks import aside
from cosim.base.clock import sleep, stopwatch

#: s between two looks.
LOOK = 0.02


@final
class Presence:
    """The nodes of a bus whose tokens are present; :meth:`declare` publishes that of `node`.

    `what`: the token, ``alive`` or ``ready``.
    """

    def __init__(
        self, session: zenoh.Session, names: Names, node: str, what: str = "alive"
    ) -> None:
        self._session, self._names, self._node = session, names, node
        self._what = "there" if what == "alive" else what
        self._there: set[str] = set()
        self.lost = 0
        """Times a token went away."""
        self._tokens: list[zenoh.LivelinessToken] = []
        self._subscriber = session.liveliness().declare_subscriber(
            names.of("*", what), aside(self._changed), history=True
        )

    def _changed(self, sample: zenoh.Sample) -> None:
        node = str(sample.key_expr).split("/")[-2]
        if sample.kind == zenoh.SampleKind.PUT:
            self._there.add(node)
        elif node in self._there:
            self._there.discard(node)
            self.lost += 1

    @property
    def there(self) -> frozenset[str]:
        """Nodes whose token is present, without this one."""
        return frozenset(self._there - {self._node})

    def declare(self) -> None:
        """This node is there: after its subscriptions, so that who sees it is heard by it."""
        self._tokens.append(self._token("alive"))

    def ready(self) -> None:
        """This node is ready for a start."""
        self._tokens.append(self._token("ready"))

    def _token(self, what: str) -> zenoh.LivelinessToken:
        return self._session.liveliness().declare_token(self._names.of(self._node, what))

    def missing(self, peers: Iterable[str], publishers: Mapping[str, zenoh.Publisher]) -> list[str]:
        """The `peers` that are not present, and the `publishers` (by key) without a subscriber."""
        absent = sorted(set(peers) - self._there)
        unheard = [key for key, p in publishers.items() if not _matching(p)]
        said = [f"not {self._what}: {', '.join(absent)}"] if absent else []
        return said + ([f"no node listens to {', '.join(unheard)}"] if unheard else [])


def present_nodes(session: zenoh.Session, names: Names) -> frozenset[str]:
    """The nodes whose sessions are present, by one query."""
    found = session.liveliness().get(names.of("*", "alive"))
    keys = [str(reply.ok.key_expr) for reply in found if reply.ok is not None]
    return frozenset(key.split("/")[-2] for key in keys)


def wait_until_there(
    missing: Callable[[], list[str]], seconds: float, stop: Callable[[], bool] = lambda: False
) -> None:
    """Until nothing is `missing`. Raises BusError after `seconds` (s), naming what is."""
    elapsed = stopwatch()
    while not stop() and (found := missing()):
        if elapsed() > seconds:
            raise BusError(
                f"{'; '.join(found)} after {seconds:g} s; check that these nodes run with the same"
                " prefix and that endpoints, certificates and access rules let them connect"
            )
        sleep(LOOK)


def _matching(publisher: zenoh.Publisher) -> bool:
    """Zenoh's stub declares bool, but the value is an object that is always true."""
    status: object = publisher.matching_status
    return bool(getattr(status, "matching", status))
