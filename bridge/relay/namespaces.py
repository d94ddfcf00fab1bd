"""Network namespaces as hosts: made, entered by a thread, removed."""

from __future__ import annotations

import ctypes as c
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cosim.base.errors import CosimError

NEWNET = 0x40000000
_FOLDER = Path("/run/netns")
#: Names of ours: this, the process that made them, ``-``, and more.
PREFIX = "cosim-"


class NetworkError(CosimError, OSError):
    """A namespace or an interface cannot be created; the message names what is missing."""


def add(name: str) -> None:
    """A new namespace with its loopback interface up. Raises NetworkError."""
    ip("netns", "add", name)
    ip("-n", name, "link", "set", "lo", "up")


def delete(name: str) -> None:
    """Remove a namespace; processes in it keep it alive until they end."""
    ip("netns", "del", name)


def exists(name: str) -> bool:
    """True if there is a namespace with this name."""
    return (_FOLDER / name).exists()


def multicast(name: str) -> None:
    """Multicast in a namespace goes over its loopback interface. Raises NetworkError."""
    ip("-n", name, "link", "set", "lo", "multicast", "on")
    ip("-n", name, "route", "add", "224.0.0.0/4", "dev", "lo")


def sweep() -> None:
    """Remove namespaces of ours whose process is gone."""
    for name in abandoned():
        delete(name)


def abandoned() -> list[str]:
    """Namespaces of ours whose process is gone: it was killed."""
    found = []
    for path in _FOLDER.glob(f"{PREFIX}*") if _FOLDER.is_dir() else ():
        pid = path.name.removeprefix(PREFIX).partition("-")[0]
        if pid.isdigit() and not Path(f"/proc/{pid}").exists():
            found.append(path.name)
    return sorted(found)


def ip(*arguments: str) -> str:
    """Run iproute2. Raises NetworkError with its error message."""
    try:
        found = subprocess.run(
            ["ip", *arguments], capture_output=True, text=True, check=False,
            start_new_session=True,  # a signal to our process group does not cut it short
        )  # fmt: skip
    except OSError as error:
        raise NetworkError(f"ip {' '.join(arguments)}: {error}") from error
    if found.returncode:
        raise NetworkError(
            f"ip {' '.join(arguments)}: {found.stderr.strip()}; namespaces need root"
        )
    return found.stdout


@contextmanager
def in_namespace(name: str) -> Iterator[None]:
    """Move the calling thread to a namespace, with all that it opens and starts there.

    Raises NetworkError.
    """
    here = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
    try:
        there = os.open(_FOLDER / name, os.O_RDONLY)
        try:
            _enter(there)
        finally:
            os.close(there)
        try:
            yield
        finally:
            _enter(here)
    finally:
        os.close(here)


def _enter(descriptor: int) -> None:
    libc = c.CDLL(None, use_errno=True)
    if libc.setns(descriptor, NEWNET):
        number = c.get_errno()
        raise NetworkError(number, f"setns: {os.strerror(number)}; namespaces need root")
