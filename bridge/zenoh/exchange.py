"""Raw bytes between two sessions under two keys: for measurements of a path."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import zenoh

from bridge.deployment.system import System
from bridge.zenoh.channel import control_publisher
from bridge.zenoh.node_channel import rules_of
from bridge.zenoh.options import ZenohOptions, options_of
from bridge.zenoh.session import close_session, configure, open_session
from cosim.base.clock import monotonic_ns, sleep, stopwatch
from cosim.base.errors import RunError, ScenarioError

OpenSession = zenoh.Session
#: Where a responder listens and a client connects unless an endpoint is given.
ENDPOINT = "tcp/127.0.0.1:7462"


class PingKeys(NamedTuple):
    """Keys of questions and of answers, with the name of who asks in place of the chunk ``*``.

    `responder`: the command that answers, for messages.
    """

    ask: str = "cosim/ping/ask/*"
    answer: str = "cosim/ping/answer/*"
    responder: str = "cosim pong zenoh"

    def asker(self, key: str) -> str:
        """The name of who asks under `key`."""
        return key.split("/")[self.ask.split("/").index("*")]


KEYS = PingKeys()


@contextmanager
def plain_session(
    endpoint: str, config: Path | None = None, *, listen: bool = False
) -> Iterator[zenoh.Session]:
    """A session without a deployment: connected to `endpoint` or listening on it.

    `config`: a Zenoh configuration (JSON5), for TLS. Raises ScenarioError, BusError.
    """
    place, here = "cosim ping zenoh", (endpoint,)
    options = ZenohOptions(place, connect=here, config=config, insecure=True)
    if listen:
        options = ZenohOptions(place, listen=here, config=config, insecure=True)
    configured = configure(options, "ping")
    if listen:
        configured.insert_json5("listen/exit_on_failure", json.dumps(True))
    session = open_session(configured, "ping")
    try:
        yield session
    finally:
        close_session(session)


@contextmanager
def node_session(system: System, bus: str, node: str) -> Iterator[tuple[OpenSession, str]]:
    """A session as that of a node, and the reliability of its messages. Raises BusError,
    ScenarioError.
    """
    options = options_of(system.deployment, bus, node)
    session = open_session(configure(options, node, rules_of(system, bus)), bus)
    try:
        yield session, options.reliability
    finally:
        close_session(session)


@contextmanager
def asking(
    session: zenoh.Session, name: str, heard: Callable[[bytes, int], None],
    keys: PingKeys = KEYS, reliability: str = "best-effort", patience: float = 5.0,
) -> Iterator[Callable[[bytes], None]]:  # fmt: skip
    """A function that publishes questions of `name`; `heard(data, t_ns)` gets the answers.

    Raises RunError if no responder subscribes within `patience` (s).
    """
    key = keys.ask.replace("*", name)

    def came(sample: zenoh.Sample) -> None:
        t_ns = monotonic_ns()
        heard(sample.payload.to_bytes(), t_ns)

    subscriber = session.declare_subscriber(
        keys.answer.replace("*", name), zenoh.handlers.Callback(came, indirect=False)
    )
    publisher = control_publisher(session, key, reliability)
    elapsed = stopwatch()
    while not getattr(publisher.matching_status, "matching", False):
        if elapsed() > patience:
            raise RunError(
                f"zenoh: no responder on {key} after {patience:g} s; expected "
                f"`{keys.responder}` on this network"
            )
        sleep(0.01)
    try:
        yield publisher.put
    finally:
        subscriber.undeclare()  # type: ignore[no-untyped-call]


@contextmanager
def answering(
    session: zenoh.Session,
    heard: Callable[[bytes, int, str], None],
    keys: PingKeys = KEYS,
    reliability: str = "best-effort",
) -> Iterator[Callable[[bytes, str], None]]:
    """A function that answers a sender; `heard(data, t_ns, sender)` gets its questions."""
    publishers: dict[str, zenoh.Publisher] = {}

    def came(sample: zenoh.Sample) -> None:
        t_ns = monotonic_ns()
        heard(sample.payload.to_bytes(), t_ns, keys.asker(str(sample.key_expr)))

    def answer(data: bytes, sender: str) -> None:
        if sender not in publishers:
            for oldest in list(itertools.islice(publishers, max(0, len(publishers) - 63))):
                publishers.pop(oldest).undeclare()  # type: ignore[no-untyped-call]
            publishers[sender] = control_publisher(
                session, keys.answer.replace("*", sender), reliability
            )
        publishers[sender] = publishers.pop(sender)  # the oldest is the one that is quiet
        publishers[sender].put(data)

    subscriber = session.declare_subscriber(keys.ask, zenoh.handlers.Callback(came, indirect=False))
    try:
        yield answer
    finally:
        subscriber.undeclare()  # type: ignore[no-untyped-call]


@contextmanager
def listening(
    session: zenoh.Session,
    key: str,
    heard: Callable[[str, bytes, bytes | None, int | None, int], None],
) -> Iterator[None]:
    """Subscribe to a key expression: `heard(key, payload, attachment, stamp_ns, t_ns)`.

    `stamp_ns`: Zenoh's own time stamp, ns since 1970, None without one; `t_ns`: monotonic. Raises
    ScenarioError for what is no key expression.
    """

    def came(sample: zenoh.Sample) -> None:
        t_ns = monotonic_ns()
        attached, stamp = sample.attachment, sample.timestamp
        heard(
            str(sample.key_expr),
            sample.payload.to_bytes(),
            None if attached is None else attached.to_bytes(),
            None if stamp is None else round(stamp.get_time().timestamp() * 1e9),
            t_ns,
        )

    try:
        subscriber = session.declare_subscriber(key, zenoh.handlers.Callback(came, indirect=False))
    except zenoh.ZError as error:
        raise ScenarioError(f"found key {key!r}; expected a key expression: {error}") from None
    try:
        yield
    finally:
        subscriber.undeclare()  # type: ignore[no-untyped-call]
