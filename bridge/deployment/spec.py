"""A deployment: the node of each component, and the message of each signal that crosses a cut.

TOML is read into frozen structs, as for scenarios (:mod:`cosim.scenario.spec`): numbers are SI or
texts with a unit, an unknown key is an error, and every error names file and place.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

import msgspec

from bridge.deployment.counted import MOST, MOST_ON_CAN, expand_counted
from bridge.deployment.motors import expand
from bridge.deployment.signal_spec import SignalSpec
from bridge.drives.model import DriveSpec
from bridge.safety.limits import GuardSpec
from cosim.base import toml
from cosim.base.convert import Number, convert, convert_each, number
from cosim.base.errors import ScenarioError
from cosim.base.names import unknown
from cosim.base.toml import as_toml, change
from cosim.bus.settings import QueueKind
from cosim.bus.timing import BusTiming

#: Where a deployment that is named, not given as a file, is looked for: beside the scenario.
FOLDER = "deploy"
#: The deployment of a scenario that has none of its own name.
USUAL = "can"
#: What nodes say besides the deployment's messages: commands, SYNC, stop, which run, who is there.
ServiceName = Literal["nmt", "sync", "estop", "epoch", "heartbeat"]
SERVICES: tuple[ServiceName, ...] = get_args(ServiceName)
T = TypeVar("T")


class BusSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One network. `interface`, `channel`, `bitrate` (bit/s) ... have the meaning of python-can.

    `dbc`: file with its messages, relative to the deployment. `services`: the services of this CAN
    bus, messages of that file (:mod:`bridge.deployment.services`). `options`: further arguments of
    the interface. `local`: keep ``udp_multicast`` on this machine. `zenoh`: a Zenoh configuration
    file (JSON5), relative to the deployment; `prefix`: of its keys.
    """

    kind: Literal["can", "zenoh"] = "can"
    interface: str = "socketcan"
    channel: str = ""
    bitrate: Annotated[int, msgspec.Meta(gt=0)] = 1_000_000
    data_bitrate: Annotated[int, msgspec.Meta(gt=0)] = 5_000_000
    fd: bool = True
    dbc: str = ""
    services: tuple[ServiceName, ...] | None = None
    local: bool = True
    zenoh: str = ""
    prefix: str = ""
    options: dict[str, Any] = {}
    queue: Literal["fifo", "sorted", "mailboxes"] = "fifo"
    queue_length: Annotated[int, msgspec.Meta(gt=0, le=65535)] = 1000

    @property
    def queue_kind(self) -> QueueKind:
        """`queue` as a simulated bus has it."""
        return QueueKind[self.queue.upper()]

    @property
    def timing(self) -> BusTiming:
        """Bit rates of a CAN bus."""
        return BusTiming(self.bitrate, self.data_bitrate if self.fd else None, self.fd)


class StaleSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Reaction to missing messages of an input.

    `age`: an input of the component that receives the time since the last message, s. `stop`: time
    without a message after which the node stops, s; 0: never; default: `silence` of the file.
    """

    age: str = ""
    stop: Number | None = None


class ApartSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Outputs of two arms, ``component.port``, that must not differ by more at the start."""

    of: str
    other: str
    within: Number


class NodeSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One process: its components, its number on every bus, and its safety functions.

    A node without components is a gateway: messages name it in `by`, and its slots have the length
    `step` (default: the base step). `phase`: of its deadlines; `heartbeat`: period of its
    heartbeats; `requires`: nodes whose absence for `within` stops it; `apart`: condition that
    refuses the start; `stale`: by ``component.port``; `ramp`: time in which the torque decreases to
    0 at a stop; `priority`, `cpu`: see :mod:`bridge.realtime.requests`. All times are in s.
    """

    number: Annotated[int, msgspec.Meta(ge=1, le=MOST)]
    components: tuple[str, ...] = ()
    step: Number | None = None
    phase: Number = 0.0
    heartbeat: Number = 0.05
    requires: tuple[str, ...] = ()
    within: Number = 0.15
    guard: GuardSpec | None = None
    drive: DriveSpec | None = None
    apart: ApartSpec | None = None
    stale: dict[str, StaleSpec] = {}
    ramp: Number = 0.1
    overrun: Number = 0.1
    priority: Annotated[int, msgspec.Meta(ge=0, le=98)] = 50
    cpu: int | None = None


class MessageSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One message: outputs of one component, on one bus, every `period` (default: every step).

    `carries`: ``component.port``; the signals in the DBC file are named by the port and a number
    from 1, or by `signals`. `name`: of the message in the DBC file, if it differs from the key.
    `max_age`: older samples, by their time stamps, are dropped; 0: none. `forwards`: another
    message, which the node `by` sends again as this one on another bus
    (:mod:`bridge.deployment.gateways`).

    `profile`: of a drive (``configs/drives``), relative to the deployment: message, signals and
    units are then those of the profile, for the drive's own node number `drive`; the ports are tau,
    q, dq. `gear`, `direction`, `zero`: between drive and joint
    (:class:`bridge.drives.profiles.Joint`). `fd`: whether all frames to and from this drive are CAN
    FD with bit rate switch; default: as its DBC file has them. `joint`: set by ``[motors.NAME]``,
    from 0: `carries` has the entry of each port at this position, whatever its number.
    """

    bus: str
    carries: tuple[str, ...] = ()
    forwards: str = ""
    by: str = ""
    name: str = ""
    signals: tuple[str, ...] = ()
    period: Number | None = None
    max_age: Number = 0.0
    profile: str = ""
    drive: Annotated[int, msgspec.Meta(ge=0, le=127)] = 0
    gear: Annotated[float, msgspec.Meta(gt=0)] = 1.0
    direction: Literal[1, -1] = 1
    zero: Number = 0.0
    fd: bool | None = None
    joint: Annotated[int, msgspec.Meta(ge=0)] | None = None


class Deployment(msgspec.Struct, frozen=True):
    """A whole deployment, from :func:`load`. `set`: changes of the scenario that it requires.

    `latency`: whether the configured delays of links are added to those of the network. `sync`: the
    node that sends SYNC, if any. `enforce`: refuse to start without real-time permissions.
    `patience`: time in which all nodes must be ready, s. `silence`: a node that receives nothing of
    a message for this time stops, and the run with it, s; 0: never. `signals`: by
    ``component.port``, or by port for all components with this port.
    """

    path: Path
    title: str
    clock: Literal["wall", "simulated"]
    latency: bool
    enforce: bool
    sync: str
    patience: float
    silence: float
    set: dict[str, Any]
    buses: dict[str, BusSpec]
    nodes: dict[str, NodeSpec]
    messages: dict[str, MessageSpec]
    signals: dict[str, SignalSpec] = {}

    @property
    def name(self) -> str:
        """The file's stem."""
        return self.path.stem

    def place(self, *path: str | int) -> str:
        """The place of a value in the file: ``FILE at nodes.master.phase``."""
        return f"{self.path} at {'.'.join(map(str, path))}"

    def seconds(self, value: Number, *path: str | int) -> float:
        """A duration, s. Raises ScenarioError with its place."""
        return number(value, "s", self.place(*path))

    def file(self, name: str) -> Path:
        """The path of a file named in the deployment, relative to it."""
        return self.path.parent / name

    def settings(self) -> list[str]:
        """The changes to the scenario, as ``--set`` takes them."""
        return [f"{path}={as_toml(value)}" for path, value in self.set.items()]


_TABLES = Deployment.__struct_fields__[1:]


def find(scenario: str | Path, given: str) -> Path:
    """The deployment `given` as a file, or by its name in ``deploy/`` next to the scenario.

    "": the one with the name of the scenario, or else ``can``. Raises ScenarioError if there is
    none of this name.
    """
    folder, stem = Path(scenario).parent / FOLDER, Path(scenario).stem
    given = given or (stem if (folder / f"{stem}.toml").is_file() else USUAL)
    path = Path(given)
    if path.suffix == ".toml" or path.is_file():
        return path
    found = folder / f"{given}.toml"
    if not found.is_file():
        if not Path(scenario).exists():
            raise ScenarioError("no such file; expected a scenario", str(scenario))
        known = [p.stem for p in folder.glob("*.toml")]
        cure = "" if known else "; --deploy takes the path of a file, and `cosim new` writes one"
        raise ScenarioError(unknown(given, known, "deployment") + cure, str(folder))
    return found


def load(path: str | Path, settings: Sequence[str] = ()) -> Deployment:
    """Read a deployment and apply ``path=value`` settings. Raises ScenarioError."""
    path = Path(path)
    document = toml.read(Path(path))
    for setting in settings:
        change(document, setting)
    expand(document, path)
    expand_counted(document, path)
    for key in document:
        if key not in _TABLES:
            known = ", ".join((*_TABLES, "motors"))
            raise ScenarioError(f"unknown key {key!r}; expected one of {known}", f"{path}")
    for key in ("buses", "nodes", "messages"):
        if not isinstance(document.get(key), dict):
            raise ScenarioError(f"no [{key}.NAME] table", f"{path}")
    d = Deployment(
        path=path,
        title=convert(document.get("title", path.stem), str, path, "title"),
        clock=convert(document.get("clock", "wall"), Literal["wall", "simulated"], path, "clock"),  # type: ignore[arg-type]
        latency=convert(document.get("latency", True), bool, path, "latency"),
        enforce=convert(document.get("enforce", False), bool, path, "enforce"),
        sync=convert(document.get("sync", ""), str, path, "sync"),
        patience=_seconds(document, "patience", 60.0, path),
        silence=_seconds(document, "silence", 10.0, path),
        set=convert(document.get("set", {}), dict[str, Any], path, "set"),
        buses=convert_each(document["buses"], BusSpec, path, "buses"),
        nodes=convert_each(document["nodes"], NodeSpec, path, "nodes"),
        messages=convert_each(document["messages"], MessageSpec, path, "messages"),
        signals=convert(document.get("signals", {}), dict[str, SignalSpec], path, "signals"),
    )
    _check(d)
    return d


def _seconds(document: dict[str, Any], key: str, usual: float, path: Path) -> float:
    found: Number = convert(document.get(key, usual), Number, path, key)  # type: ignore[arg-type]
    return number(found, "s", f"{path} at {key}")


def _check(d: Deployment) -> None:
    """Check that names exist and that numbers differ. Raises ScenarioError."""
    numbers: dict[int, str] = {}
    homes: dict[str, str] = {}
    can = [name for name, bus in d.buses.items() if bus.kind == "can"]
    for name, node in d.nodes.items():
        if can and node.number > MOST_ON_CAN:
            text = f"found {node.number}; expected 1 to {MOST_ON_CAN}, because {can[0]} is CAN"
            raise ScenarioError(text, d.place("nodes", name, "number"))
        if node.number in numbers:
            text = f"number {node.number} is {numbers[node.number]}'s already"
            raise ScenarioError(text, d.place("nodes", name, "number"))
        numbers[node.number] = name
        for component in node.components:
            if component in homes:
                text = f"{component} lives in {homes[component]} already"
                raise ScenarioError(text, d.place("nodes", name, "components"))
            homes[component] = name
        for peer in node.requires:
            _known(peer, d.nodes, "node", d.place("nodes", name, "requires"))
    for name, message in d.messages.items():
        _known(message.bus, d.buses, "bus", d.place("messages", name, "bus"))
    for name, bus in d.buses.items():
        for option in ("bitrate", "data_bitrate", "fd", "queue", "tx_queue_size"):
            if bus.interface == "cosim" and option in bus.options:
                key = {"tx_queue_size": "queue_length"}.get(option, option)
                text = f"found {option} among the options; expected {key} of the bus itself"
                raise ScenarioError(text, d.place("buses", name, "options"))
    if d.sync:
        _known(d.sync, d.nodes, "node", d.place("sync"))


def _known(name: str, table: dict[str, Any], what: str, place: str) -> None:
    if name not in table:
        raise ScenarioError(f"no {what} {name!r}; there are: {', '.join(sorted(table))}", place)
