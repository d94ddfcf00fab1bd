"""Paths over Zenoh: questions and answers under own keys (:mod:`bridge.zenoh.exchange`)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bridge.ping.exchanges import PingPath
from bridge.ping.queued import QueuedPath
from bridge.zenoh.exchange import answering, asking, plain_session
from cosim.base.clock import monotonic_ns


@contextmanager
def zenoh_path(
    endpoint: str, config: Path | None = None, reliability: str = "best-effort"
) -> Iterator[PingPath]:
    """The asking end. Raises BusError, RunError, ScenarioError where there is no other end."""
    path = QueuedPath()
    with (
        plain_session(endpoint, config) as session,
        asking(session, f"{monotonic_ns():x}", path.put, reliability) as ask,
    ):
        path.sender = lambda data, to: ask(data)
        yield path


@contextmanager
def zenoh_responder(
    endpoint: str, config: Path | None = None, *, listen: bool = True
) -> Iterator[PingPath]:
    """The answering end, at `endpoint` or connected to a router there."""
    path = QueuedPath()
    with (
        plain_session(endpoint, config, listen=listen) as session,
        answering(session, path.put) as answer,
    ):
        path.sender = lambda data, to: answer(data, str(to))
        yield path
