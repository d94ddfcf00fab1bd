"""Parts of a study: its runs divided among independent calls, and put together.

A row is a function of the study, the number of its run and the seed, so it does not matter which
call makes it. Part k of n has every n-th run from the k-th on, in the order of the study, in a
folder of its own; a part may be made again, and its rows may be in several folders. The runs of
comparisons and the candidates of searches, whose results are in journals, are divided as well.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

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

    def as_data(self) -> list[int]:
        """The two numbers, as they are in the state of a folder."""
        return [self.number, self.of]


def folder_of(part: StudyPart, whole: Path) -> Path:
    """The folder of a part, where `whole` is that of one call."""
    return whole.with_name(f"{whole.name}.parts") / part.name


def refuse_other_part(folder: Path, state: stores.Record, part: StudyPart | None) -> None:
    """Raise ScenarioError if the folder has another part of the study than the one asked for."""
    found = state.get("part")
    wanted = None if part is None else part.as_data()
    if state and found != wanted:
        had = "all runs" if found is None else f"part {found[0]} of {found[1]}"
        raise ScenarioError(
            f"the folder contains {had}, expected {part or 'all runs'}; choose another folder",
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


def take_journals(
    folders: Sequence[Path], facts: Mapping[str, Any]
) -> tuple[dict[str, stores.Record], set[tuple[int, int]]]:
    """The rows of the journals of all folders by their runs; (number, of) of the parts they are.

    `facts`: what the state of each folder says. A row without a reason of failure goes before one
    with it. Raises ScenarioError for a folder with other facts, and while a part is being made.
    """
    rows: dict[str, stores.Record] = {}
    found: set[tuple[int, int]] = set()
    for folder in folders:
        state = stores.read_state(folder) if folder.is_dir() else {}
        part = state.get("part")
        if not part:
            raise ScenarioError("found no part there", str(folder))
        for key, value in facts.items():
            if state.get(key) != value:
                raise ScenarioError(
                    f"found a part whose {key} is {state.get(key)}, expected {value}; give the "
                    "file and the options with which the parts were made",
                    str(folder),
                )
        with held_folder(folder):
            for run, row in stores.read_journal(folder / stores.JOURNAL).items():
                if run not in rows or rows[run].get("reason"):
                    rows[run] = row
        found.add((int(part[0]), int(part[1])))
    return rows, found


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


def missing_runs(count: int, names: str) -> str:
    """One sentence about runs that are missing; `names`: of their parts, as :func:`missing` has."""
    what = f": parts {names}" if "," in names else f": part {names} of them" if names else ""
    return f"{count} runs are missing{what}"


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
