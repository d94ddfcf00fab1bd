"""Parts of a study: its runs divided among independent calls, and put together.

A row is a function of the study, the number of its run and the seed, so it does not matter which
call makes it. Part k of n has every n-th run from the k-th on, in the order of the study, in a
folder of its own; a part may be made again, and its rows may be in several folders.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from cosim.base.errors import RunError, ScenarioError
from cosim.record.folder import held_folder, reason
from cosim.study import store as stores
from cosim.study.store import Store

STUDY = "study.toml"


@dataclass(frozen=True, slots=True)
class StudyPart:
    """Part `number`, from 1, `of` as many."""

    number: int
    of: int

    @classmethod
    def read(cls, text: str) -> Self:
        """The part that a text such as ``3/40`` names. Raises ScenarioError."""
        match = re.fullmatch(r"(\d+)/(\d+)", text)
        if match is None or not 1 <= int(match[1]) <= int(match[2]):
            raise ScenarioError(f"found {text!r}, expected K/N with 1 <= K <= N, as 3/40", "--part")
        return cls(int(match[1]), int(match[2]))

    def __str__(self) -> str:
        return f"part {self.number} of {self.of}"

    @property
    def name(self) -> str:
        """The name of its folder: of all parts in their order."""
        width = len(str(self.of))
        return f"{self.number:0{width}d}-of-{self.of}"

    def of_runs(self, runs: Sequence[str]) -> set[str]:
        """Its runs, of all in the order of the study."""
        return set(runs[self.number - 1 :: self.of])


def refuse_other_part(folder: Path, state: stores.Record, part: StudyPart | None) -> None:
    """Raise ScenarioError if the folder has another part of the study than the one asked for."""
    found = state.get("part")
    wanted = None if part is None else [part.number, part.of]
    if state and found != wanted:
        had = "a whole study" if found is None else f"part {found[0]} of {found[1]}"
        raise ScenarioError(
            f"the folder contains {had}, expected {part or 'a whole study'}; choose another folder",
            str(folder),
        )


def take(folders: Sequence[Path], into: Path, text: str, fingerprint: str) -> set[tuple[int, int]]:
    """Copy the rows of all folders to those of `into`; return (number, of) of the parts they are.

    `text`: of the study; `fingerprint`: of its scenario. A run that failed in one folder and not in
    another has not failed. Raises ScenarioError for a folder with another study or scenario, and
    while a part is being made; RunError if a file cannot be copied.
    """
    found: set[tuple[int, int]] = set()
    for folder in folders:
        state = stores.read_state(folder) if folder.is_dir() else {}
        if not state:
            raise ScenarioError("found no part of a study there", str(folder))
        if state.get("fingerprint") != fingerprint or _text(folder) != text:
            raise ScenarioError(
                "found rows of another study, or of another version of its scenario; expected "
                "those of this one",
                str(folder),
            )
        with held_folder(folder), Store(folder, {}):
            pass  # what the journal of a killed call has becomes a file
        _copy(folder, into)
        if part := state.get("part"):
            found.add((int(part[0]), int(part[1])))
    _prefer_well(into)
    return found


def _prefer_well(folder: Path) -> None:
    """Write rows that did not fail once more, behind those of the same runs that did."""
    why: dict[str, str] = {}
    well: dict[str, Path] = {}
    for part in stores.parts(folder):
        for run, (reason_, _) in stores.ends_of(part):
            why[run] = reason_
            if not reason_:
                well[run] = part
    again = {run: well[run] for run, text in why.items() if text and run in well}
    if again:
        rows = [
            r for p in set(again.values()) for r in stores.rows_of(p) if again.get(r["run"]) == p
        ]
        target = folder / stores.RESULTS / stores.part_name(stores.next_part(folder))
        stores.write_table(target, [r for r in rows if not r["reason"]], {})


def missing(parts: set[tuple[int, int]]) -> str:
    """The parts that are not among these, as text; "" if they are of different divisions."""
    divisions = {of for _, of in parts}
    if len(divisions) != 1:
        return ""
    (of,) = divisions
    there = {number for number, _ in parts}
    return ", ".join(f"{k}/{of}" for k in range(1, of + 1) if k not in there)


def _copy(folder: Path, into: Path) -> None:
    """Copy the files of results behind those that are there. Raises RunError."""
    target = into / stores.RESULTS
    try:
        target.mkdir(parents=True, exist_ok=True)
        first = stores.next_part(into)
        for i, part in enumerate(stores.parts(folder)):
            scratch = target / f".{part.name}"
            shutil.copyfile(part, scratch)
            scratch.replace(target / stores.part_name(first + i))
    except OSError as error:
        raise RunError(f"cannot copy the rows of {folder}: {reason(error)}") from error


def _text(folder: Path) -> str:
    try:
        return (folder / STUDY).read_text(encoding="utf-8")
    except OSError:
        return ""
