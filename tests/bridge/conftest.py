"""What the tests of the bridge share: a shipped DBC file is read, its messages compared, once."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import bridge.deployment.system as deployed
from bridge.can import dbc
from bridge.can.codec import Codec
from bridge.can.layout import MessageLayout, Signal
from tests.bridge.deployments import CONFIGS


@pytest.fixture(autouse=True, scope="session")
def read_once() -> Iterator[None]:
    """Messages of configs/ are parsed, and compared with cantools, once a process."""
    load, verify = dbc.load, deployed.verify
    loaded = cache(load)
    compared = set[tuple[MessageLayout, tuple[Signal, ...]]]()

    def load_once(path: str | Path) -> tuple[MessageLayout, ...]:
        return loaded(path) if str(path).startswith(str(CONFIGS)) else load(path)

    def verify_once(codec: Codec) -> None:
        key = (codec.layout, codec.signals)
        if key not in compared:
            verify(codec)
            compared.add(key)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(deployed.dbc, "load", load_once)
        patch.setattr(deployed, "verify", verify_once)
        yield
