"""The task of a host, which a rehearsal sends to the agent there."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from cosim.base.copies import asdict

#: s between two signs of life, both ways.
BEAT = 0.5


@dataclass(frozen=True, slots=True)
class HostTask:
    """The task of a host: `settings` are those of the run and this host's own.

    `folder`: for its journals; "": its own, and they are sent at the end. `listen`, `connect`:
    endpoints of its Zenoh router; `router`: its configuration file, "": the usual one; `client`:
    the endpoint of it for the nodes; `buses`: those of Zenoh. `silence`: a connection without a
    line for so long is given up, s. `name`: of the host; `others`: how many other hosts there are;
    `keys`: folder of certificates for TLS between routers, "": none.
    """

    scenario: str
    deployment: str
    settings: tuple[str, ...]
    folder: str
    listen: tuple[str, ...]
    connect: tuple[str, ...]
    client: str
    buses: tuple[str, ...]
    silence: float
    name: str
    others: int
    router: str = ""
    keys: str = ""
    insecure: bool = False

    def text(self) -> str:
        """The task as JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def parse(cls, text: str) -> Self:
        """The task that :meth:`text` wrote."""
        said = json.loads(text)
        found: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in said.items()}
        return cls(**found)


def digest_of(scenario: Path, deployment: Path) -> str:
    """A digest of both files. Raises OSError."""
    found = hashlib.sha256()
    for path in (scenario, deployment):
        found.update(hashlib.sha256(path.read_bytes()).digest())
    return found.hexdigest()
