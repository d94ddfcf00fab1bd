"""A run folder of nodes that may still be running, read without disturbing them.

All data comes from files: ``rehearsal.json`` (the deployment, its processes and the start), the
journals and bus logs of the nodes, and their reports at the end.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, final

import numpy as np
from numpy.typing import NDArray

from bridge.deployment.system import System, load_system
from bridge.native.journal import JournalError
from bridge.recording.journal_tail import JournalTail
from bridge.records.node_lives import Life, files, lives_of
from bridge.records.records import Statement
from bridge.rehearsal.supervisor import STARTED
from cosim.base.errors import ScenarioError
from cosim.record.folder import METADATA, NODES, RUNNING, read_metadata

Rows = NDArray[np.void]


@dataclass(frozen=True, slots=True)
class Facts:
    """The facts of a run. `pid`: its supervisor, 0: none known.

    `start_ns`: t = 0, monotonic; `wall_ns`: the same, since 1970; 0: not known.
    """

    scenario: Path
    deployment: str
    settings: tuple[str, ...]
    pid: int = 0
    start_ns: int = 0
    wall_ns: int = 0


def read_facts(folder: Path) -> Facts:
    """The facts of a rehearsal, running or finished. Raises ScenarioError for neither."""
    started = folder / STARTED
    try:
        if started.is_file():
            said = json.loads(started.read_text(encoding="utf-8"))
        else:
            said = read_metadata(folder).get("deployment") or {}
            said = {**said, "deployment": said["path"]}
        return Facts(
            scenario=Path(said["scenario"]),
            deployment=str(said["deployment"]),
            settings=tuple(said["settings"]),
            pid=int(said.get("pid", 0)),
            start_ns=int(said.get("start_ns", 0)),
            wall_ns=int(said.get("wall_ns", 0)),
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ScenarioError(
            f"has no data of a rehearsal ({error}); expected {STARTED}, or {METADATA} with a "
            "deployment; or use --scenario and --deploy",
            str(folder),
        ) from error


def find_run(runs: Path) -> Path:
    """The newest active run in `runs`; otherwise the newest with journals.

    Raises ScenarioError if there is none.
    """
    found = [f for f in runs.iterdir() if journals(f)] if runs.is_dir() else []
    if not found:
        raise ScenarioError("no run with journals of nodes in this folder", str(runs))
    newest = sorted(found, key=lambda f: f.stat().st_mtime, reverse=True)
    return next((f for f in newest if is_live(f)), newest[0])


def journals(folder: Path) -> dict[Life, Path]:
    """Journals of the nodes of a run by life, sorted."""
    nodes = folder / NODES if (folder / NODES).is_dir() else folder
    return files(nodes, "journal")


def is_live(folder: Path) -> bool:
    """True if a run's supervisor is running and has not finished the folder."""
    started = folder / STARTED
    try:
        if not started.is_file() or read_metadata(folder).get("status", RUNNING) != RUNNING:
            return False
        return alive(int(json.loads(started.read_text(encoding="utf-8"))["pid"]))
    except (OSError, ValueError, KeyError):
        return False


def alive(pid: int) -> bool:
    """True if a process of this machine runs; where that cannot be asked, it does."""
    if pid <= 0 or sys.platform == "win32":
        return pid > 0
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


@final
class LiveRun:
    """A run's system and its open files. Files that come later are found by :meth:`look`."""

    def __init__(self, folder: Path, system: System, facts: Facts) -> None:
        self.folder, self.system, self.facts = folder, system, facts
        self.lives: dict[Life, JournalTail] = {}
        self.frames: dict[tuple[Life, str], JournalTail] = {}  # by (life, bus)
        self.injected: dict[Life, JournalTail] = {}
        self.unreadable: dict[str, str] = {}
        self.look()

    @classmethod
    def open(
        cls, folder: Path, scenario: Path | None = None, deployment: str | None = None
    ) -> Self:
        """A run folder. Raises ScenarioError for one without journals, or of another system."""
        if not folder.is_dir():
            raise ScenarioError("there is no such run folder", str(folder))
        if not journals(folder) and not is_live(folder):
            raise ScenarioError(
                "no journals of nodes in this folder; expected that of a rehearsal", str(folder)
            )
        if scenario is not None and deployment is not None:
            facts = Facts(scenario, deployment, ())
        else:
            facts = read_facts(folder)
        system = load_system(facts.scenario, facts.deployment, facts.settings)
        return cls(folder, system, facts)

    def look(self) -> None:
        """Open what is new. A file that is no journal (yet) is in `unreadable`, with why."""
        self.unreadable.clear()
        for life, path in journals(self.folder).items():
            if life.node not in self.system.nodes:
                continue
            self._open(self.lives, life, path)
            for bus in self.system.deployment.buses:
                frames = path.with_name(life.frames(bus))
                if frames.is_file():
                    self._open(self.frames, (life, bus), frames)
            faults = path.with_name(life.file("faults"))
            if faults.is_file():
                self._open(self.injected, life, faults)

    def _open(self, tails: dict[Any, JournalTail], key: object, path: Path) -> None:
        if key in tails:
            return
        try:
            tail = JournalTail(path)
            self._fits(path, tail, key)
            tails[key] = tail
        except JournalError as error:
            self.unreadable[path.name] = str(error)

    def _fits(self, path: Path, tail: JournalTail, life: object) -> None:
        if path.suffix != ".journal" or not isinstance(life, Life):
            return
        node = self.system.nodes[life.node]
        shape = tail.row["signals"].shape if "signals" in (tail.row.names or ()) else None
        if shape != (node.plan.n_signals,):
            tail.close()
            raise ScenarioError(
                f"rows with signals of shape {shape}; {life} has {node.plan.n_signals}", str(path)
            )

    def lives_of(self, node: str) -> list[Life]:
        """The observed lives of a node, in their order."""
        return lives_of(self.lives, node)

    def recent(self, seconds: float) -> dict[str, Rows]:
        """Return the rows (n,) of the last `seconds` (s), by node, of its newest life with rows."""
        found: dict[str, Rows] = {}
        for life in sorted(self.lives):  # a node's newest life comes last
            tail, node = self.lives[life], life.node
            if len(tail):
                found[node] = tail.newest(round(seconds / self.system.nodes[node].h))
        return found

    def everything(self) -> dict[str, Rows]:
        """Return all rows (n,) by node, with the rows of all lives in sequence."""
        parts = {
            node: [self.lives[life].rows(0, len(self.lives[life])) for life in self.lives_of(node)]
            for node in self.system.nodes
        }
        return {node: np.concatenate(found) for node, found in parts.items() if found}

    def reports(self) -> Iterator[tuple[Life, Statement]]:
        """(life, its report at the end), for lives that have one."""
        for life, tail in self.lives.items():
            try:
                said = Statement.read(tail.path.parent, life)
            except (OSError, ValueError):
                continue  # not whole yet
            if said is not None:
                yield life, said

    @property
    def running(self) -> bool:
        """True if anything may still come."""
        if not is_live(self.folder):
            return False
        return not self.lives or not all(tail.closed for tail in self.lives.values())

    def close(self) -> None:
        """Let go of all files."""
        for tails in (self.lives, self.frames, self.injected):
            for tail in tails.values():
                tail.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
