"""Names and life of a run folder; ``run.json``, its only text file."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

from cosim.base.errors import RunError, ScenarioError
from cosim.base.files import aside_for, write_file

TRAJECTORIES = "trajectories.parquet"
#: While a run goes on: row groups without a footer yet, and what is still in memory.
PART, LIVE = "trajectories.parquet.part", "trajectories.live"
METADATA = "run.json"
LAST = "last.parquet"
LINKS = "links"
#: The file with the tables of many links: when the run has ended, and while it is active.
TABLES, TABLE_ROWS = "links.parquet", "links.rows"
#: Of a rehearsal: the journals of its nodes, of which trajectories are made at its end.
NODES, JOURNAL = "nodes", ".journal"
SUMS = "SHA256SUMS"
#: What is made of a run: its report, a table; the log of an FMU, figures.
REPORT, CSV = "report.html", "trajectories.csv"
FMU_LOG, FIGURES = ".fmu.log", (".png", ".pdf")
#: Times of the events of FMUs.
EVENTS = "events.csv"
#: The checkpoints of a run that is not finished.
CHECKPOINTS = ".checkpoints"
#: Suffix of a link's table while a run goes on.
ROWS = ".rows"
#: What ``status`` of ``run.json`` may be. A folder that is "running" and whose run is not there any
#: more was cut short; `cosim report --recover` makes it "recovered".
RUNNING, FINISHED, STOPPED, RECOVERED = "running", "finished", "stopped", "recovered"
_SINGLE = (TRAJECTORIES, PART, LIVE, METADATA, LAST, SUMS, TABLES, TABLE_ROWS)
_MADE = (REPORT, CSV, EVENTS)


def claim_folder(folder: str | Path, *, force: bool = False, resumed: bool = False) -> Path:
    """Create `folder` for a run, or use an existing empty one.

    With `force`, the files of an earlier run in it are deleted, also what was made of it, but only
    those that this package writes; the checkpoints of a run that is `resumed` remain. Raises
    ScenarioError for a folder that is not empty without `force`, that contains other files than a
    run, or that cannot be created.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        present = sorted(path.name for path in folder.iterdir())
        if present and not force:
            raise ScenarioError(
                f"the folder is not empty (it contains {_some(present)}); "
                "choose another one, or replace an earlier run with --force",
                str(folder),
            )
        if present and not {*_SINGLE, LINKS, CHECKPOINTS} & set(present):
            raise ScenarioError(
                f"the folder contains {_some(present)} but no earlier run; nothing is overwritten",
                str(folder),
            )
        if not resumed:
            _unfinish(folder)
        for path in _own_files(folder):
            path.unlink()
    except OSError as error:
        raise ScenarioError(f"cannot use this folder: {reason(error)}", str(folder)) from error
    return folder


def _unfinish(folder: Path) -> None:
    """A run whose files are about to be deleted can no longer be resumed, and is not finished."""
    shutil.rmtree(folder / CHECKPOINTS, ignore_errors=True)
    with suppress(ScenarioError, RunError):  # unreadable: not finished; full disk: it gets space
        metadata = read_metadata(folder)
        if metadata.get("status") == FINISHED:
            write_metadata(folder, metadata | {"status": RUNNING})


def _own_files(folder: Path) -> list[Path]:
    """The files that this package writes; the last one is ``run.json``, which names others."""
    names = [name for name in (*_MADE, *_named(folder), *_SINGLE) if name != METADATA]
    tables = [p for kind in ("*.parquet", f"*{ROWS}") for p in sorted((folder / LINKS).glob(kind))]
    killed = [path.name for path in folder.iterdir() if aside_for(path.name) in (*names, METADATA)]
    single = [folder / name for name in (*names, *killed)]
    return [path for path in (*single, *tables, folder / METADATA) if path.is_file()]


def _named(folder: Path) -> Iterator[str]:
    """Names of the logs and figures that the run of a folder may have; of its scenario."""
    with suppress(ScenarioError):  # a file that cannot be read names none
        scenario = read_metadata(folder).get("scenario")
        found = scenario if isinstance(scenario, dict) else {}
        yield from (f"{name}{FMU_LOG}" for name in found.get("components") or ())
        yield from (f"{name}{kind}" for name in found.get("figures") or () for kind in FIGURES)


def _some(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def reason(error: BaseException) -> str:
    """The error in words: the system's text for an OSError, else the error's own."""
    if isinstance(error, OSError) and error.errno is not None:
        return os.strerror(error.errno)
    return str(error) or type(error).__name__


def link_file(folder: str | Path, name: str) -> Path:
    """File for the table of link `name` in `folder`; creates ``links/``.

    Names may hold any character: what a file name cannot hold is percent-encoded. Raises RunError
    if the folder cannot be created.
    """
    links = Path(folder) / LINKS
    try:
        links.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"cannot create {links}: {reason(error)}") from error
    return links / f"{quote(name, safe=' ')}.parquet"


def link_files(folder: Path) -> dict[str, Path]:
    """The link tables of a folder that are files of their own, by link name, sorted by name.

    Of a run that was cut short, the rows written until then.
    """
    unfinished = (folder / LINKS).glob(f"*{ROWS}")
    finished = (folder / LINKS).glob("*.parquet")
    return dict(
        sorted({unquote(p.stem): p for files in (unfinished, finished) for p in files}.items())
    )


def write_metadata(
    folder: str | Path, mapping: Mapping[str, Any], *, indented: bool = True
) -> Path:
    """Write ``run.json`` with sorted keys, replacing it in one step (it is never incomplete).

    Without indentation it is smaller, for files that will soon be replaced.

    Numbers that are not finite become ``null``, because JSON has no NaN. Accepts NumPy numbers and
    arrays and paths in addition to JSON's own types. Raises RunError naming the place of a value
    that JSON cannot represent, or the path if writing fails.
    """
    from msgspec import json

    path = Path(folder) / METADATA
    data = json_data(mapping)
    write_file(path, (json.format(data, indent=2) if indented else data) + b"\n")
    return path


def json_data(mapping: Mapping[str, Any]) -> bytes:
    """The content of ``run.json``, without indentation; see :func:`write_metadata`."""
    from msgspec import json, to_builtins

    if not _is_plain(mapping):  # msgspec also writes sets, bytes and more, which have another form
        _check_plain(mapping, METADATA)
    try:
        return json.encode(mapping, enc_hook=_plain, order="sorted")
    except (TypeError, ValueError, RecursionError):  # keys that are numbers
        texts = to_builtins(mapping, enc_hook=_plain, str_keys=True)
        return json.encode(texts, enc_hook=_plain, order="sorted")


def read_metadata(folder: str | Path) -> dict[str, Any]:
    """The content of ``run.json`` of `folder`; empty if it does not exist (an interrupted run).

    Raises ScenarioError naming the file if it is not a JSON object, or the entry of another type.
    """
    from msgspec import DecodeError, json

    from cosim.record.facts import check_facts  # as slow to load

    path = Path(folder) / METADATA
    try:
        content = json.decode(path.read_bytes())
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, DecodeError, RecursionError) as error:
        raise ScenarioError(f"cannot be read: {reason(error)}", str(path)) from error
    if not isinstance(content, dict):
        raise ScenarioError(f"found a {type(content).__name__}, expected an object", str(path))
    check_facts(content, str(path))
    return content


def _plain(value: Any) -> Any:
    """A value that is not of JSON's own types, in these. Raises TypeError for what has none."""
    import numpy as np

    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(type(value).__name__)


def _is_plain(value: Any) -> bool:
    """True if a value has JSON's own types only, which is quick to see."""
    kind = type(value)
    if kind is dict:
        return all(map(_is_plain, value.values()))
    if kind is list or kind is tuple:
        return all(map(_is_plain, value))
    return value is None or kind in (str, int, float, bool)


def _check_plain(value: Any, place: str) -> None:
    """Raise RunError with the place of a value that cannot be written as JSON, if there is one."""
    if isinstance(value, Mapping):
        for key, entry in value.items():
            _check_plain(entry, f"{place}.{key}")
    elif isinstance(value, list | tuple):
        for i, entry in enumerate(value):
            _check_plain(entry, f"{place}[{i}]")
    elif value is not None and not isinstance(value, bool | int | float | str):
        try:
            _plain(value)
        except TypeError:
            name = type(value).__name__
            raise RunError(f"{place}: a {name} cannot be written as JSON") from None


def is_unfinished(folder: Path) -> bool:
    """True if the folder holds a recording that was not closed."""
    there = (folder / LIVE).exists() or bool(journals(folder))
    return there and not (folder / TRAJECTORIES).exists()


def journals(folder: Path) -> list[Path]:
    """The journals of nodes."""
    return list((folder / NODES).glob(f"*{JOURNAL}"))


@contextmanager
def held_folder(folder: str | Path) -> Iterator[None]:
    """Create the folder, and hold it: until the block or the process ends, whatever ends it.

    The lock is the system's, on the folder itself, and needs no file (not on Windows, which has
    none). Raises ScenarioError where another run holds it, or it cannot be created.
    """
    folder = Path(folder)
    with ExitStack() as stack:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if sys.platform != "win32":
                place = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
                stack.callback(os.close, place)
                _lock(place, folder)
        except OSError as error:
            text = f"cannot use this folder: {reason(error)}"
            raise ScenarioError(text, str(folder)) from error
        yield


def _lock(place: int, folder: Path) -> None:
    import fcntl

    try:
        fcntl.flock(place, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise ScenarioError(
            "another command records into this folder; choose another one, or wait for its end",
            str(folder),
        ) from None
    except OSError:  # a file system without locks of folders
        return
