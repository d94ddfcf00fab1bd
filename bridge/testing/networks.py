"""Networks of a test: hosts on a real IP stack, and links with delays and losses between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import Any, final

from bridge.relay.network import RelayNetwork
from bridge.testing.case import PytestCase


@final
class HostNetworks:
    """Networks that no other test sees, removed at the end of the test by `closing`."""

    def __init__(self, case: PytestCase, closing: ExitStack) -> None:
        self._case, self._closing, self._count = case, closing, 0

    def __call__(
        self, hosts: Sequence[str], links: Mapping[str, Mapping[str, Any]] | None = None
    ) -> RelayNetwork:
        """Hosts in network namespaces of their own, connected by a relay.

        `links` by ``FROM>TO``, or ``*`` for all: tables with `delay` and `loss` as links of a
        scenario have them (also ``{"law": "trace", "file": "measured.csv"}``), `rate` in bit/s,
        `ordered` and `down`. Delays and losses are drawn from the seed of the test. Raises
        NetworkError without the rights of root, which namespaces need.
        """
        self._count += 1
        folder = self._case.folder
        folder.mkdir(parents=True, exist_ok=True)
        record = folder / f"network-{self._count}.packets"
        with self._case.at_home():
            network = RelayNetwork(hosts, record, links, self._case.seed)
            return self._closing.enter_context(network)
