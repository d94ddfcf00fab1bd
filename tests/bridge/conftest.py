"""Fixtures of the bridge: a shipped DBC file is read, its messages compared, once."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import bridge.deployment.system as deployed
from bridge.can import dbc
from bridge.can.codec import Codec
from bridge.can.layout import MessageLayout, Signal
from bridge.realtime import os_grants
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


@pytest.fixture(autouse=True, scope="session")
def memory_is_not_locked() -> Iterator[None]:
    """A node of a test locks no memory: all pages of the process of tests would become real ones.

    These are 1.5 GB, mostly of stacks and pools that nothing uses, and they stay to its end.
    """
    call = os_grants._call

    def unlocked(name: str, *arguments: int) -> int:
        return 0 if name in ("mlockall", "munlockall") else call(name, *arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os_grants, "_call", unlocked)
        yield
