"""Hosts and the router between them, for as long as a ``with`` lasts."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from itertools import count
from pathlib import Path
from typing import Any, Self, final

import numpy as np
from numpy.typing import NDArray

from bridge.native.journal import Journal
from bridge.relay import namespaces
from bridge.relay.namespaces import NetworkError
from cosim.base.python import python_call

_NUMBER = count()
#: Packets a record has room for.
ROWS = 400_000


@final
class RelayNetwork:
    """Hosts in separate network namespaces, ``10.77.0.N``, and links between any two.

    `links`: tables of :class:`bridge.relay.impairment.RelayLinkSpec` by ``FROM>TO``, or ``*`` for
    all. `record`: file for one row per packet. Raises NetworkError without root privileges.
    """

    def __init__(
        self,
        hosts: Sequence[str],
        record: Path,
        links: Mapping[str, Mapping[str, Any]] | None = None,
        seed: int = 0,
    ) -> None:
        unique = f"{namespaces.PREFIX}{os.getpid()}-{next(_NUMBER)}"
        self.namespaces = {host: f"{unique}-{host}" for host in hosts}
        self.addresses = {host: f"10.77.0.{i + 1}" for i, host in enumerate(hosts)}
        self.record, self._links, self._seed = record, dict(links or {}), seed
        self.names: Sequence[str] = ()
        self._made: list[str] = []
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Self:
        try:
            for namespace in self.namespaces.values():
                namespaces.add(namespace)
                self._made.append(namespace)
            self._start()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _start(self) -> None:
        hosts = [
            {"name": h, "namespace": self.namespaces[h], "address": f"{self.addresses[h]}/24"}
            for h in self.namespaces
        ]
        given: dict[str, Any] = {
            "hosts": hosts, "record": str(self.record), "rows": ROWS, "seed": self._seed,
            "links": self._links,
        }  # fmt: skip
        self._process = subprocess.Popen(
            python_call("bridge.relay", json.dumps(given)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        event: Mapping[str, Any] = {"error": "it ended without a word"}
        if line:
            event = json.loads(line)
        if event.get("event") != "ready":
            raise NetworkError(f"the relay did not start: {event['error']}")
        self.names = event["links"]

    def on_host(self, host: str) -> AbstractContextManager[None]:
        """Move the calling thread to a host, with all that it opens and starts there."""
        return namespaces.in_namespace(self.namespaces[host])

    def set(self, link: str, **spec: Any) -> None:
        """Change a link from now on, ``*``: all; without a spec it is perfect."""
        assert self._process is not None and self._process.stdin is not None
        self._process.stdin.write(json.dumps({"link": link, "spec": spec}) + "\n")
        self._process.stdin.flush()

    def packets(self) -> NDArray[np.void]:
        """The packets recorded so far, (n,), of type :data:`bridge.relay.router.PACKET`."""
        return Journal.open(self.record)

    def of(self, link: str) -> NDArray[np.void]:
        """The packets of one link, (n,), of type :data:`bridge.relay.router.PACKET`."""
        rows = self.packets()
        found: NDArray[np.void] = rows[rows["link"] == self.names.index(link)]
        return found

    def close(self) -> None:
        """End the router and remove the hosts."""
        process, self._process = self._process, None
        if process is not None:
            for stream in (process.stdin, process.stdout):
                if stream is not None:
                    stream.close()
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        while self._made:
            namespaces.delete(self._made.pop())
