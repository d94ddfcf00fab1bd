"""Network namespaces wired by veth to one bridge, and sshd in one of them."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import count
from pathlib import Path

from bridge.relay import namespaces
from bridge.relay.namespaces import ip

_NUMBER = count()


@contextmanager
def wired(n: int) -> Iterator[list[tuple[str, str]]]:
    """`n` namespaces, each with its address; a bridge in one more connects them."""
    unique = f"{namespaces.PREFIX}{os.getpid()}-w{next(_NUMBER)}"
    with ExitStack() as stack:
        made = [f"{unique}-{i}" for i in range(n)]
        for name in (*made, middle := f"{unique}-m"):
            namespaces.add(name)
            stack.callback(namespaces.delete, name)
        ip("-n", middle, "link", "add", "br0", "type", "bridge")
        ip("-n", middle, "link", "set", "br0", "up")
        found = []
        for i, name in enumerate(made):
            address, port = f"10.78.0.{i + 1}", f"p{i}"
            ip("-n", middle, "link", "add", port, "type", "veth", "peer", "eth0", "netns", name)
            ip("-n", middle, "link", "set", port, "master", "br0", "up")
            ip("-n", name, "address", "add", f"{address}/24", "dev", "eth0")
            ip("-n", name, "link", "set", "eth0", "up")
            found.append((name, address))
        yield found


@contextmanager
def sshd(folder: Path, namespace: str, port: int = 2222) -> Iterator[Sequence[str]]:
    """An sshd in a namespace with keys of its own; the options with which ssh enters."""
    folder.mkdir()
    for name in ("host", "user"):
        words = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(folder / name)]
        subprocess.run(words, check=True)
    (folder / "authorized").write_text((folder / "user.pub").read_text())
    Path("/run/sshd").mkdir(exist_ok=True)
    options = {
        "Port": port, "HostKey": folder / "host", "AuthorizedKeysFile": folder / "authorized",
        "PidFile": "none", "StrictModes": "no", "UsePAM": "no", "PermitRootLogin": "yes",
        "PasswordAuthentication": "no",
    }  # fmt: skip
    (folder / "config").write_text("".join(f"{key} {value}\n" for key, value in options.items()))
    with namespaces.in_namespace(namespace):
        daemon = subprocess.Popen(
            ["/usr/sbin/sshd", "-D", "-e", "-f", str(folder / "config")],
            stderr=(folder / "log").open("wb"),
        )
    try:
        ending = time.monotonic() + 20.0
        while b"Server listening" not in (folder / "log").read_bytes():
            assert time.monotonic() < ending and daemon.poll() is None
            time.sleep(0.05)
        yield [
            "-p", str(port), "-i", str(folder / "user"), "-F", "none",
            "-o", "StrictHostKeyChecking=no", "-o", "UserKnownHostsFile=/dev/null",
            "-o", "LogLevel=ERROR",
        ]  # fmt: skip
    finally:
        daemon.terminate()
        daemon.wait()
