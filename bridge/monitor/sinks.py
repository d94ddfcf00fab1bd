"""Receivers of the messages of :mod:`bridge.monitor.topics`: an MCAP file, Foxglove.

MCAP and the WebSocket are the Foxglove SDK's (``foxglove-sdk``), imported when one is wanted.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Self, final

from bridge.monitor.topics import TopicMessage
from cosim.base.errors import RunError, ScenarioError

#: Hz that live views get at most, of each node.
LIVE_RATE = 100.0


def _foxglove() -> Any:
    try:
        import foxglove
    except ImportError as error:
        raise ScenarioError(
            f"foxglove-sdk is not available ({error}); install cosim-bridge[foxglove]"
        ) from error
    return foxglove


def address(text: str) -> tuple[str, int]:
    """``HOST:PORT``. Raises ScenarioError."""
    host, colon, port = text.rpartition(":")
    if not colon or not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise ScenarioError(f"found {text!r}; expected HOST:PORT, like 127.0.0.1:8765")
    return host, int(port)


class _Channels:
    """Topics as channels of the SDK, in a separate context."""

    def __init__(self) -> None:
        self._sdk = _foxglove()
        self.context = self._sdk.Context()
        self._channels: dict[str, Any] = {}

    def put(self, sample: TopicMessage) -> None:
        """Log a message with its time."""
        topic = sample.topic
        if topic.name not in self._channels:
            data = json.dumps(topic.schema).encode()
            schema = self._sdk.Schema(name=topic.title, encoding="jsonschema", data=data)
            self._channels[topic.name] = self._sdk.Channel(
                topic.name, schema=schema, message_encoding="json", context=self.context
            )
        text = json.dumps(sample.content, allow_nan=False)
        self._channels[topic.name].log(text.encode(), log_time=sample.t_ns)


@final
class Mcap:
    """An MCAP file, every slot in it. Raises ScenarioError for a file that is there already."""

    rate = float("inf")

    def __init__(self, path: Path, *, replace: bool = False) -> None:
        if path.exists() and not replace:
            raise ScenarioError(
                "the file exists; choose another one or force overwriting", str(path)
            )
        self._channels = _Channels()
        try:
            self._file = _foxglove().open_mcap(
                path, allow_overwrite=replace, context=self._channels.context
            )
        except (OSError, RuntimeError, ValueError) as error:
            raise RunError(f"cannot write {path}: {error}") from error

    def put(self, sample: TopicMessage) -> None:
        """Write one."""
        self._channels.put(sample)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


@final
class Foxglove:
    """A WebSocket server for Foxglove at ``HOST:PORT``."""

    rate = LIVE_RATE

    def __init__(self, text: str) -> None:
        host, port = address(text)
        self._channels = _Channels()
        try:
            self._server = _foxglove().start_server(
                name="cosim", host=host, port=port, context=self._channels.context
            )
        except (OSError, RuntimeError, ValueError) as error:
            raise RunError(f"cannot serve at {text}: {error}") from error

    def put(self, sample: TopicMessage) -> None:
        """Send one to whoever subscribed."""
        self._channels.put(sample)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._server.stop()
