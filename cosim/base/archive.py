"""ZIP archives (FMUs and SSPs), unpacked once per content after a check of their entries.

The only place that opens one. Whatever is wrong with an archive becomes an :class:`ArchiveError`.
A folder holds the sums of its files (:data:`SUMS`); one that does not fit them, since a disk was
full, a machine went down or somebody changed a file, is unpacked again.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import struct
import sys
import zlib
from collections import Counter
from contextlib import suppress
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from cosim.base.files import regular

if TYPE_CHECKING:  # imported when an archive is unpacked
    import zipfile

#: Bytes an archive may unpack to, and its description may have; entries it may have.
LARGEST, LARGEST_DESCRIPTION, MOST_ENTRIES = 8 << 30, 256 << 20, 100_000
#: The file with the SHA-256 of each file of an unpacked archive, as ``sha256sum`` writes it.
SUMS = ".sums"
#: What the standard library raises besides zipfile.BadZipFile for archives that are damaged, on
#: purpose or not.
_BROKEN = (
    zlib.error, struct.error, EOFError, OSError, ValueError, LookupError,
    RuntimeError, OverflowError, MemoryError, AssertionError,
)  # fmt: skip


class ArchiveError(Exception):
    """An invalid archive; the message is a sentence without its name."""


def cache_folder() -> Path:
    """The folder for unpacked archives: ``$XDG_CACHE_HOME/cosim`` or ``~/.cache/cosim``."""
    return _folder_in(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))


@lru_cache(maxsize=16)
def _folder_in(root: str) -> Path:
    return Path(root) / "cosim"


def unpack(path: Path, what: str, description: str, place: str) -> tuple[Path, str]:
    """Unpack `path` below `place` in the cache unless it is there already: (folder, SHA-256).

    `what`: "FMU" or "SSP", for messages; `description`: the required entry. Raises ArchiveError for
    a missing file, a file that is not a ZIP archive or is damaged, one without its description, and
    for unsafe content: too much data, encrypted entries, different entries with one name,
    compression other than deflate, and entries outside the folder.
    """
    try:
        found = _state(path)
        if not stat.S_ISREG(found.st_mode):
            raise ArchiveError(f"is not a file; expected an .{what.lower()} file")
        sha256 = _sum(path, (found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns))
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL
        raise ArchiveError(f"cannot be read: {error}") from error
    folder = _place(cache_folder(), place, sha256[:32])
    if not is_whole(folder):
        _extract(path, what, description, folder)
    return folder, sha256


def is_whole(folder: Path) -> bool:
    """True if an unpacked archive is there, with each file as it was unpacked, or built later."""
    try:
        said = (folder / SUMS).read_text(encoding="utf-8")
        names = [line[66:] for line in said.splitlines()]
        states = tuple(_file_state(f"{folder}/{name}") for name in names)
    except (OSError, ValueError):
        return False
    return _fits(folder, said, states)


def add_sum(folder: Path, path: Path) -> None:
    """Take note of a file that was made in the folder of an unpacked archive. Raises OSError."""
    said = (folder / SUMS).read_text(encoding="utf-8")
    name = path.relative_to(folder).as_posix()
    kept = [line for line in said.splitlines() if line[66:] != name]
    scratch = folder / f"{SUMS}{os.getpid()}"
    scratch.write_text("\n".join([*kept, _line(folder, path)]) + "\n", encoding="utf-8")
    scratch.replace(folder / SUMS)


def _file_state(path: str) -> tuple[int, ...]:
    found = os.stat(path)
    return found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


@lru_cache(maxsize=64)
def _fits(folder: Path, said: str, states: tuple[tuple[int, ...], ...]) -> bool:
    """True if the files have these sums, computed once for files that stay as they are."""
    del states
    try:
        return all(_line(folder, folder / line[66:]) == line for line in said.splitlines())
    except OSError:
        return False


def _line(folder: Path, path: Path) -> str:
    with path.open("rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    return f"{found}  {path.relative_to(folder).as_posix()}"


def _state(path: Path) -> os.stat_result:
    try:
        return regular(path).stat()
    except (OSError, ValueError):
        if not path.exists():
            raise ArchiveError("no such file") from None
        raise


@lru_cache(maxsize=64)
def _sum(path: Path, state: tuple[int, ...]) -> str:
    """The sum of a file, computed once for a file that many components are made of."""
    del state  # when it differs, the file is another one
    return hashlib.sha256(path.read_bytes()).hexdigest()


@lru_cache(maxsize=64)
def _place(cache: Path, place: str, name: str) -> Path:
    return _writable(cache / place, place) / name


def _writable(usual: Path, place: str) -> Path:
    """`place` in the cache or, where that cannot be written, in a folder of this user's in /tmp."""
    with suppress(OSError):
        usual.mkdir(parents=True, exist_ok=True)
        if os.access(usual, os.W_OK | os.X_OK):
            return usual
    import tempfile
    from getpass import getuser

    user = getuser() if sys.platform == "win32" else os.getuid()
    own = Path(tempfile.gettempdir()) / f"cosim-{user}"
    with suppress(OSError):
        own.mkdir(mode=0o700, exist_ok=True)
        if sys.platform == "win32" or own.stat().st_uid == os.getuid():
            return own / place
    return usual  # unpacking there says why it cannot be


def _extract(path: Path, what: str, description: str, folder: Path) -> None:
    import tempfile

    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(dir=folder.parent))
    except OSError as error:
        raise ArchiveError(f"cannot unpack into {folder.parent}: {error}") from error
    try:
        _fill(path, what, description, scratch)
        _replace(scratch, folder)
    except OSError as error:
        raise ArchiveError(
            f"{folder}, where it was unpacked before, is damaged and cannot be replaced: {error}"
        ) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _fill(path: Path, what: str, description: str, folder: Path) -> None:
    """Unpack an archive into a new folder. Raises ArchiveError."""
    import zipfile

    try:
        with zipfile.ZipFile(path) as archive:
            _check(archive, what, description, shutil.disk_usage(folder).free)
            archive.extractall(folder)
        _seal(folder)
    except (zipfile.BadZipFile, *_BROKEN) as error:
        said = " ".join(str(error).split()) or type(error).__name__
        raise ArchiveError(f"not a readable {what} (ZIP archive): {said}") from error


def _seal(folder: Path) -> None:
    """Write the sums of all files, which are then on the disk. Raises OSError."""
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    lines = [_line(folder, path) for path in files]
    (folder / SUMS).write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    for path in (*files, folder / SUMS):
        with path.open("rb+") as file:
            os.fsync(file.fileno())


def _replace(scratch: Path, folder: Path) -> None:
    """Give a folder its name, also if one that is not whole has it. Raises OSError."""
    with suppress(OSError):
        scratch.rename(folder)
        return
    if is_whole(folder):
        return  # another process was faster
    from tempfile import mkdtemp

    aside = Path(mkdtemp(dir=folder.parent))
    try:
        folder.rename(aside / "damaged")
        scratch.rename(folder)
    except OSError:
        if not is_whole(folder):
            raise
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _check(archive: zipfile.ZipFile, what: str, description: str, free: int) -> None:
    entries = archive.infolist()
    if len(entries) > MOST_ENTRIES:
        raise ArchiveError(f"has {len(entries)} entries; expected at most {MOST_ENTRIES}")
    size, most = sum(e.file_size for e in entries), min(LARGEST, free)
    if size > most:
        raise ArchiveError(f"would unpack to {size} bytes; expected at most {most}")
    # Tools write an entry twice (CMake's tar of two lists that overlap); a copy is harmless.
    counts = Counter(name for name, _, _ in {(e.filename, e.CRC, e.file_size) for e in entries})
    if description not in counts:
        article = "an" if what[0] in "FS" else "a"
        raise ArchiveError(f"the archive contains no {description}; expected {article} {what}")
    for entry in entries:
        _check_entry(entry, counts[entry.filename])
        if entry.filename == description and entry.file_size > LARGEST_DESCRIPTION:
            raise ArchiveError(
                f"{description} has {entry.file_size} bytes; expected at most {LARGEST_DESCRIPTION}"
            )


def _check_entry(entry: zipfile.ZipInfo, count: int) -> None:
    from zipfile import ZIP_DEFLATED, ZIP_STORED

    name = entry.filename
    inside = PurePosixPath(name.replace("\\", "/"))
    if inside.is_absolute() or ".." in inside.parts or ":" in (inside.parts or ("",))[0]:
        raise ArchiveError(f"entry {name!r} would be written outside the folder")
    if count > 1:
        raise ArchiveError(f"has {count} different entries with the name {name!r}; expected one")
    if entry.flag_bits & 1:
        raise ArchiveError(f"entry {name!r} is encrypted; expected entries without encryption")
    if entry.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
        raise ArchiveError(
            f"entry {name!r} is compressed by method {entry.compress_type}; expected deflate (8)"
        )
