"""The hosts of a rehearsal in a file: how nodes are started on each, and which are there.

::

    [hosts.a]
    start = "namespace"     # local, namespace, ssh or srun
    [hosts.b]
    start = "ssh"
    to = "robot@192.0.2.2"  # for ssh; of srun, the node; a network namespace that exists
    address = "192.0.2.2"   # where the other hosts reach its Zenoh router
    nodes = ["node1"]       # the others are placed by the delays of their links
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Self, final

import msgspec

from bridge.deployment.system import System
from bridge.rehearsal.host_task import HostTask
from bridge.rehearsal.hosts import Hosts
from bridge.relay import namespaces
from bridge.zenoh.options import is_loopback
from cosim.base import toml
from cosim.base.convert import Number, convert, convert_each, number
from cosim.base.errors import ScenarioError
from cosim.base.python import python_call

AGENT = "bridge.rehearsal.agent"
#: One-way time between two hosts where the file has none, s.
LATENCY = 0.0005
#: After how long without a sign of life a host is given up where the file does not say, s.
SILENCE = 10.0
#: The least such time, s: of some signs of life.
LEAST_SILENCE = 2.0
LOOPBACK = "127.0.0.1"


class HostSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One host. `start`: how a program is started there; `to`: where, for ssh, srun and namespace.

    `address`, `port`: of its Zenoh router; `options`: further arguments of ssh or srun. `python`:
    the interpreter there; `folder`: its working directory, in which the paths of the command are
    found. `nodes`: those that are there in any case; `cores`: its share of the others.
    """

    start: Literal["local", "namespace", "ssh", "srun"] = "local"
    to: str = ""
    address: str = ""
    port: Annotated[int, msgspec.Meta(ge=1, le=65535)] = 7447
    options: tuple[str, ...] = ()
    python: str = "python3"
    folder: str = ""
    nodes: tuple[str, ...] = ()
    cores: Annotated[int, msgspec.Meta(ge=1)] = 1


@dataclass(frozen=True, slots=True)
class HostFile:
    """A whole file. `latency`: one-way time between hosts, s; namespaces made for the run have it.

    `insecure`: routers may speak without encryption beyond this machine; `router`: a Zenoh
    configuration for them, relative to the file, "": the usual one; `keys`: a folder of their
    certificates, relative to the file, with which they speak TLS; "": none. `silence`: a host
    without a sign of life for so long is given up, s.
    """

    path: Path
    hosts: Mapping[str, HostSpec]
    latency: float = LATENCY
    insecure: bool = False
    router: str = ""
    silence: float = SILENCE
    keys: str = ""

    def place(self, host: str, key: str = "") -> str:
        """The place of a host in the file."""
        return f"{self.path} at hosts.{host}{f'.{key}' if key else ''}"

    @property
    def made(self) -> bool:
        """True if the hosts are network namespaces that are made for the run."""
        return any(h.start == "namespace" and not h.to for h in self.hosts.values())


_KEYS = ("hosts", "latency", "silence", "insecure", "router", "keys")


def load(path: Path) -> HostFile:
    """Read a file. Raises ScenarioError with the place of what is wrong."""
    document = toml.read(path)
    for key in document:
        if key not in _KEYS:
            raise ScenarioError(
                f"unknown key {key!r}; expected one of {', '.join(_KEYS)}", str(path)
            )
    if not isinstance(document.get("hosts"), dict) or not document["hosts"]:
        raise ScenarioError("no [hosts.NAME] table; expected one for each host", str(path))
    found = HostFile(
        path,
        convert_each(document["hosts"], HostSpec, path, "hosts"),
        _seconds(document, "latency", LATENCY, path),
        convert(document.get("insecure", False), bool, path, "insecure"),
        convert(document.get("router", ""), str, path, "router"),
        _seconds(document, "silence", SILENCE, path),
        convert(document.get("keys", ""), str, path, "keys"),
    )
    if found.silence < LEAST_SILENCE:
        text = f"found {found.silence:g} s, expected at least {LEAST_SILENCE:g} s"
        raise ScenarioError(text, f"{path} at silence")
    _check(found)
    return found


def _seconds(document: Mapping[str, Any], key: str, default: float, path: Path) -> float:
    value: Number = convert(document.get(key, default), Number, path, key)  # type: ignore[arg-type]
    return number(value, "s", f"{path} at {key}")


def _check(file: HostFile) -> None:
    for name, host in file.hosts.items():
        if host.start in ("ssh", "srun") and not host.to:
            text = f"{host.start} without `to`; expected the host that it is given"
            raise ScenarioError(text, file.place(name))
        if file.made and (host.start != "namespace" or host.to):
            text = "a namespace that is made for the run (without `to`) reaches only others of them"
            raise ScenarioError(f"found {host.start} {host.to}: {text}", file.place(name))
        if host.start == "namespace" and host.to and not namespaces.exists(host.to):
            text = f"no network namespace {host.to!r}; expected one that `ip netns add` has made"
            raise ScenarioError(text, file.place(name, "to"))
        if host.folder and host.start in ("local", "namespace"):
            text = f"found folder with {host.start}, expected it with ssh and srun only"
            raise ScenarioError(text, file.place(name, "folder"))
    if file.keys and (file.insecure or file.made):
        text = "certificates, and routers without encryption"
        raise ScenarioError(
            f"found {text}; expected insecure = false and no namespaces that are made for the run",
            f"{file.path} at keys",
        )
    if file.made or len(file.hosts) == 1:
        return
    addresses = {name: _address(host) for name, host in file.hosts.items()}
    alone = [name for name, address in addresses.items() if is_loopback(address)]
    if alone and len(alone) < len(addresses):
        other = next(name for name in addresses if name not in alone)
        text = f"{addresses[alone[0]]} is not reached from {other}; expected an address that is"
        raise ScenarioError(text, file.place(alone[0], "address"))
    ends: dict[tuple[str, int], str] = {}
    for name, host in file.hosts.items():
        first = ends.setdefault((addresses[name], host.port), name)
        if first != name:
            text = f"found the address and the port of {first}; expected another port"
            raise ScenarioError(text, file.place(name, "port"))
    if not (file.insecure or file.router or file.keys or alone):
        raise ScenarioError(
            "the routers of the hosts would speak without encryption; expected certificates "
            "(keys = FOLDER), a configuration with TLS (router = FILE), or insecure = true",
            str(file.path),
        )


def _address(host: HostSpec) -> str:
    return host.address or (LOOPBACK if host.start in ("local", "namespace") else host.to)


def fixed(file: HostFile, nodes: Iterable[str]) -> dict[str, str]:
    """The hosts of the nodes that the file places. Raises ScenarioError."""
    known, found = tuple(nodes), dict[str, str]()
    for name, host in file.hosts.items():
        for node in host.nodes:
            if node not in known:
                text = f"no node {node!r}; there are: {', '.join(known)}"
                raise ScenarioError(text, file.place(name, "nodes"))
            if node in found:
                text = f"{node} is on {found[node]} already"
                raise ScenarioError(text, file.place(name, "nodes"))
            found[node] = name
    return found


@dataclass(frozen=True, slots=True)
class HostCall:
    """The command that starts the program of a host, and where it is called."""

    words: tuple[str, ...]
    where: Any = field(default=nullcontext)


@final
class Site:
    """The hosts of a file during a ``with`` block: their commands and addresses.

    `record`: a file for the packets between namespaces that are made. Raises NetworkError.
    """

    def __init__(self, file: HostFile, record: Path) -> None:
        self._file = file
        self._made: Hosts | None = None
        if file.made:
            self._made = Hosts({name: (name,) for name in file.hosts}, record)
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        if self._made is not None:
            self._stack.enter_context(self._made)
            if self._made.network is not None and self._file.latency > 0:
                delay = {"law": "constant", "delay": self._file.latency}
                self._made.network.set("*", delay=delay)
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def address(self, name: str) -> str:
        """The address at which other hosts reach the router of a host."""
        if self._made is not None:
            return self._made.addresses[name]
        return _address(self._file.hosts[name])

    def call(self, name: str) -> HostCall:
        """The command that starts the program of a host."""
        host = self._file.hosts[name]
        if host.start == "local":
            return HostCall(tuple(python_call(AGENT)))
        if host.start == "namespace":
            return HostCall(tuple(python_call(AGENT)), lambda: self._inside(name))
        words = [host.python, "-m", AGENT]
        if host.start == "srun":
            folder = [f"--chdir={host.folder}"] if host.folder else []
            own = ["--nodes=1", "--ntasks=1", f"--nodelist={host.to}", "--unbuffered"]
            return HostCall(("srun", *own, *folder, *host.options, *words))
        there = f"cd {shlex.quote(host.folder)} && " if host.folder else ""
        alive = f"ServerAliveCountMax={3 + int(self._file.silence / 5.0)}"  # longer than `silence`
        own = ["-T", "-o", "BatchMode=yes", "-o", "ServerAliveInterval=5", "-o", alive]
        return HostCall(("ssh", *own, *host.options, host.to, f"{there}exec {shlex.join(words)}"))

    def _inside(self, name: str) -> AbstractContextManager[None]:
        if self._made is not None:
            return self._made.on_host(name)
        return namespaces.in_namespace(self._file.hosts[name].to)

    def task(self, name: str, system: System, settings: Iterable[str], folder: Path) -> HostTask:
        """The task of a host; `folder`: of the journals, on hosts with this machine's files.

        `settings`: those of the run, with the scenario and the deployment of `system`.
        """
        file, host = self._file, self._file.hosts[name]
        here = host.start in ("local", "namespace")
        before = list(file.hosts)[: list(file.hosts).index(name)]
        address = self.address(name)
        own = f"tcp/{LOOPBACK}:{host.port}"
        listen = [own]
        if len(file.hosts) > 1 and not is_loopback(address):
            listen.append(f"{self._scheme}/{address}:{host.port}")
        d = system.deployment
        return HostTask(
            scenario=str(system.scenario.path if not here else system.scenario.path.resolve()),
            deployment=str(d.path if not here else d.path.resolve()),
            settings=tuple(settings),
            folder=str(folder.resolve()) if here else "",
            listen=tuple(listen),
            connect=tuple(self._endpoint(other) for other in before),
            client=own,
            buses=tuple(d.buses),
            silence=file.silence,
            name=name,
            others=len(file.hosts) - 1,
            router=str(file.path.parent / file.router) if file.router else "",
            keys=str(file.path.parent / file.keys) if file.keys else "",
            insecure=file.insecure or file.made,
        )

    @property
    def _scheme(self) -> str:
        file = self._file
        return "tls" if (file.router or file.keys) and not file.insecure else "tcp"

    def _endpoint(self, name: str) -> str:
        address, port = self.address(name), self._file.hosts[name].port
        return f"{'tcp' if is_loopback(address) else self._scheme}/{address}:{port}"
