"""Raw bytes between two sessions under two keys: for measurements without a deployment."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import zenoh

from bridge.zenoh.channel import control_publisher
from bridge.zenoh.options import ZenohOptions
from bridge.zenoh.session import close_session, configure, open_session
from cosim.base.clock import monotonic_ns, sleep, stopwatch
from cosim.base.errors import RunError, ScenarioError

#: Where a responder listens and a client connects unless an endpoint is given.
ENDPOINT = "tcp/127.0.0.1:7462"
#: Keys are PREFIX/ask/NUMBER and PREFIX/answer/NUMBER.
PREFIX = "cosim/ping"


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
def asking(
    session: zenoh.Session, number: str, heard: Callable[[bytes, int], None],
    reliability: str = "best-effort", patience: float = 5.0,
) -> Iterator[Callable[[bytes], None]]:  # fmt: skip
    """A function that publishes questions under `number`; `heard(data, t_ns)` gets the answers.

    Raises RunError if no responder subscribes within `patience` (s).
    """
    key = f"{PREFIX}/ask/{number}"

    def came(sample: zenoh.Sample) -> None:
        t_ns = monotonic_ns()
        heard(sample.payload.to_bytes(), t_ns)

    subscriber = session.declare_subscriber(
        f"{PREFIX}/answer/{number}", zenoh.handlers.Callback(came, indirect=False)
    )
    publisher = control_publisher(session, key, reliability)
    elapsed = stopwatch()
    while not getattr(publisher.matching_status, "matching", False):
        if elapsed() > patience:
            raise RunError(
                f"zenoh: no responder on {key} after {patience:g} s; expected "
                "`cosim pong zenoh` on this network"
            )
        sleep(0.01)
    try:
        yield publisher.put
    finally:
        subscriber.undeclare()  # type: ignore[no-untyped-call]


@contextmanager
def answering(
    session: zenoh.Session, heard: Callable[[bytes, int, str], None],
    reliability: str = "best-effort",
) -> Iterator[Callable[[bytes, str], None]]:  # fmt: skip
    """A function that answers a sender; `heard(data, t_ns, sender)` gets its questions."""
    publishers: dict[str, zenoh.Publisher] = {}

    def came(sample: zenoh.Sample) -> None:
        t_ns = monotonic_ns()
        heard(sample.payload.to_bytes(), t_ns, str(sample.key_expr).rpartition("/")[2])

    def answer(data: bytes, sender: str) -> None:
        if sender not in publishers:
            for oldest in list(itertools.islice(publishers, max(0, len(publishers) - 63))):
                publishers.pop(oldest).undeclare()  # type: ignore[no-untyped-call]
            publishers[sender] = control_publisher(
                session, f"{PREFIX}/answer/{sender}", reliability
            )
        publishers[sender] = publishers.pop(sender)  # the oldest is the one that is quiet
        publishers[sender].put(data)

    subscriber = session.declare_subscriber(
        f"{PREFIX}/ask/*", zenoh.handlers.Callback(came, indirect=False)
    )
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
