"""One life of a node as its supervisor handles it: start, commands and observation."""

from __future__ import annotations

import json
import signal
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from bridge.records.node_lives import Life
from cosim.base.copies import asdict
from cosim.base.errors import RunError


class LostError(RunError):
    """A node, or `hosts`, ended without a report of its own, or did not start."""

    def __init__(self, text: str, hosts: tuple[str, ...] = ()) -> None:
        super().__init__(text)
        self.hosts = hosts


@dataclass(frozen=True, slots=True)
class SlotImage:
    """The image that computes the slots of a node; `token`: of its tables, hexadecimal."""

    path: str
    token: str = ""


@dataclass(frozen=True, slots=True)
class NodeStart:
    """All settings of a node's process, as on its command line."""

    scenario: Path
    deployment: Path
    settings: tuple[str, ...]
    life: Life
    folder: Path
    warm_up: float = 0.2
    realtime: bool = True
    real: bool = False
    script: str = ""
    image: SlotImage | None = None  # None: its process computes its slots
    resumes: int | None = None  # lock-step with checkpoints: the number of its state; -1: its start

    def text(self) -> str:
        """The report as JSON."""
        return json.dumps(asdict(self), default=str)

    @classmethod
    def parse(cls, text: str) -> Self:
        """The report that :meth:`text` wrote."""
        said = json.loads(text)
        paths: dict[str, Any] = {
            key: Path(said[key]) for key in ("scenario", "deployment", "folder")
        }
        paths["life"] = Life(**said["life"])
        paths["image"] = SlotImage(**said["image"]) if said["image"] else None
        return cls(**{**said, **paths, "settings": tuple(said["settings"])})


def missing_text(waiting: Sequence[str]) -> str:
    """The inputs that a node that is not ready waits for, according to its last report."""
    if waiting:
        return f"has not received from {', '.join(waiting)}"
    return "opens its buses and loads its components"


class NodeHandle(ABC):
    """One life of a node, in a process (:class:`bridge.node.process.Process`) or in a thread
    (:class:`bridge.node.thread.Thread`).

    The attributes hold what the node has said so far; :meth:`poll` brings them up to date.
    """

    def __init__(self, start: NodeStart) -> None:
        self.start = start
        self.ready: Mapping[str, Any] | None = None
        self.done: Mapping[str, Any] | None = None
        self.failed: Mapping[str, Any] | None = None
        self.refused: list[Mapping[str, Any]] = []  # START or ARM
        self.waiting: tuple[str, ...] = ()  # messages that it must receive before it is ready
        self.deaf: tuple[str, ...] = ()  # messages that no longer arrive
        self.drives: tuple[str, ...] | None = None  # those that failed; (): all are ready
        self.faults: list[Mapping[str, Any]] = []  # of its emulator, that were carried out
        self.reached = -1  # lock-step with checkpoints: the time at which it stands, ns
        self.saved = -1  # and the number of the state that it has saved last

    def keep_event(self, event: Mapping[str, Any]) -> None:
        """Keep the content of an event. Events of unknown kinds are discarded."""
        match event.get("event"):
            case "ready":
                self.ready = event
            case "done":
                self.done = event
            case "failed":
                self.failed = event
            case "refused":
                self.refused.append(event)
            case "waiting":
                self.waiting = tuple(event["for"])
            case "drives":
                self.drives = tuple(event["failed"])
            case "deaf":
                self.deaf = tuple(event["to"])
            case "fault":
                self.faults.append(event)
            case "reached":
                self.reached = event["t_ns"]
            case "saved":
                self.saved = event["number"]

    def check(self) -> None:
        """Raise RunError if the node has ended unexpectedly; LostError if it told no reason."""
        self.poll()
        if self.failed or (self.code is not None and not self.done):
            kind = RunError if self.failed else LostError
            raise kind(f"node {self.start.life}: {self.reason()}")

    @abstractmethod
    def poll(self) -> None:
        """Read the events that have arrived."""

    @abstractmethod
    def send_command(self, command: str, **values: int) -> None:
        """Send a command to the node; a node that has ended ignores it."""

    @abstractmethod
    def send_signal(self, number: signal.Signals) -> None:
        """Send a signal to this life only. Raises RunError if it is not a process."""

    @property
    @abstractmethod
    def pid(self) -> int:
        """Number of the process or thread."""

    @property
    @abstractmethod
    def code(self) -> int | None:
        """Its exit code; None while it runs."""

    @abstractmethod
    def wait(self, seconds: float) -> int | None:
        """Wait up to `seconds` (s) for its end. Its exit code, or None if it still runs."""

    @abstractmethod
    def end(self, seconds: float = 3.0) -> None:
        """Make it end, and wait up to `seconds` (s) for it."""

    @abstractmethod
    def reason(self) -> str:
        """The reason why it ended too early, if it reported that."""
