"""Checkpoints of a node in lock-step: its state at the times that its supervisor chooses.

The state is a file beside the journals (:mod:`cosim.checkpoint.archive`), which keeps the one
before it. Journals are not copied: the state has the numbers of their rows. A node that is resumed
writes new ones that begin with these rows.
"""

from __future__ import annotations

import queue
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import final

from bridge.native import lockstep as native
from bridge.native.journal import HEADER, Journal, JournalStruct
from bridge.node import saved_state
from bridge.node.control import Control, Say
from bridge.node.lockstep import Lockstep
from bridge.records.node_lives import Life
from cosim.base.errors import RunError, ScenarioError
from cosim.base.queues import take
from cosim.checkpoint import archive
from cosim.checkpoint.archive import LATEST, PREVIOUS, Checkpoint
from cosim.record.folder import CHECKPOINTS, reason

#: Added to the name of a journal whose first rows a resumed node takes over.
EARLIER = ".earlier"
#: Bytes of a part of a file that is sent.
PART = 1 << 20
#: s between two looks for commands that come over the network while a node stands.
LOOK = 0.05


def place(nodes: Path, life: Life) -> Path:
    """The folder of a life's states; `nodes`: that of its journals."""
    return nodes.parent / CHECKPOINTS / nodes.name / str(life)


def numbers(folder: Path) -> dict[int, str]:
    """The valid states in a folder: the file of each number."""
    found: dict[int, str] = {}
    for name in (LATEST, PREVIOUS):
        if (folder / name).exists():
            try:
                found.setdefault(int(archive.read(folder / name).facts["number"]), name)
            except ScenarioError:  # damaged: the one before it is used
                continue
    return found


def journal_parts(path: Path, first: int, rows: int) -> Iterator[tuple[int, bytes]]:
    """The journal of the first `rows` rows in a file, in parts with their places, without the rows
    before `first`. Raises OSError.
    """
    with path.open("rb") as file:
        start = file.read(HEADER)
        header = JournalStruct.from_buffer_copy(start)
        size, end = header.row_size, HEADER + header.capacity * header.row_size
        yield 0, start
        file.seek(end)
        yield end, file.read(header.description)
        for at in range(HEADER + first * size, HEADER + rows * size, PART):
            file.seek(at)
            yield at, file.read(min(PART, HEADER + rows * size - at))


def set_aside(nodes: Path, life: Life, buses: Sequence[str]) -> None:
    """Rename the journals of an earlier process of a life, before new ones are made.

    May be repeated after a kill at any moment. Raises RunError.
    """
    try:
        for name in (life.file("journal"), life.file("heard"), *map(life.frames, buses)):
            path, earlier = nodes / name, nodes / f"{name}{EARLIER}"
            if path.exists() and not earlier.exists():
                path.replace(earlier)
    except OSError as error:
        raise RunError(f"cannot use {nodes}: {reason(error)}") from error


def put_back(nodes: Path) -> None:
    """Undo :func:`set_aside` for lives that ended before they had taken over all rows."""
    for earlier in nodes.glob(f"*{EARLIER}"):
        earlier.replace(earlier.with_name(earlier.name.removesuffix(EARLIER)))


@final
class NodeCheckpoints:
    """The checkpoints of one `node`; `folder`: of its states."""

    def __init__(self, node: Lockstep, folder: Path, control: Control, say: Say) -> None:
        self._node, self._folder, self._control, self._say = node, folder, control, say
        found = [node.wired.journal, node.wired.heard]
        found += [bus.log for bus in node.outside.values()]
        self._journals = {j.path.name: j for j in found if j is not None}

    def resume(self, number: int) -> None:
        """Bring the node to a state. Raises ScenarioError, RunError, FmuError."""
        known = numbers(self._folder)
        if number not in known:
            raise ScenarioError(f"has no valid state {number}", str(self._folder))
        try:
            if known[number] == PREVIOUS:
                (self._folder / PREVIOUS).replace(self._folder / LATEST)
            found = archive.read(self._folder / LATEST)
            for name, journal in self._journals.items():
                self._take_over(journal, int(found.facts["rows"][name]))
        except OSError as error:
            raise RunError(f"cannot use {self._folder}: {reason(error)}") from error
        saved_state.restore(self._node, found.blobs)
        self._node.struct.resumed = 1
        self._node.struct.until_ns = int(found.facts["t_ns"])

    def _take_over(self, journal: Journal, rows: int) -> None:
        earlier = journal.path.with_name(journal.path.name + EARLIER)
        found = Journal.open(earlier)
        if len(found) < rows:
            text = f"has {len(found)} rows; expected at least the {rows} of the checkpoint"
            raise ScenarioError(text, str(earlier))
        journal.extend(found[:rows])
        journal.sync()
        earlier.unlink()

    def run(self) -> int:
        """The slots of the node; what :func:`bridge.native.lockstep.run` returns."""
        struct, told = self._node.struct, -1
        while (result := self._node.run()) == native.UNTIL:
            if told != struct.until_ns:
                told = struct.until_ns
                self._say({"event": "reached", "t_ns": told})
            try:
                until, number = take(self._control.steps, LOOK)
            except queue.Empty:
                continue
            if number >= 0:
                rows = self._save(number, told)
                self._say({"event": "saved", "number": number, "rows": rows})
            struct.until_ns = until
        return result

    def _save(self, number: int, t_ns: int) -> dict[str, int]:
        """Save a state; the rows of each journal that belong to it. Raises CosimError."""
        try:
            for journal in self._journals.values():
                journal.sync()
        except OSError as error:
            raise RunError(f"cannot write {self._folder}: {reason(error)}") from error
        rows = {name: len(journal) for name, journal in self._journals.items()}
        facts = {"number": number, "t_ns": t_ns, "rows": rows}
        archive.write(self._folder, Checkpoint(facts, saved_state.save(self._node, t_ns)))
        return rows
