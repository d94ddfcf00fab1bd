"""Foreign archives, damaged at random and systematically: one error message for each."""

from __future__ import annotations

import os
import shutil
import struct
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cosim.base import archive
from cosim.base.errors import CosimError, FmuError, ScenarioError
from cosim.fmi import FmuComponent
from cosim.ssp.archive import ROOT
from cosim.ssp.archive import unpack as unpack_ssp
from tests.cosim.fmi.exporter import passing3

DESCRIPTION = "modelDescription.xml"


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "cache"
    monkeypatch.setattr(archive, "cache_folder", lambda: folder)
    return folder


def packed(path: Path, entries: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    with warnings.catch_warnings(), zipfile.ZipFile(path, "w", method) as target:
        warnings.simplefilter("ignore")  # of two entries of one name
        for name, content in entries.items():
            target.writestr(name, content)
    return path.read_bytes()


def whole(path: Path, method: int = zipfile.ZIP_DEFLATED) -> bytes:
    content = {DESCRIPTION: passing3().encode(), "resources/a.txt": b"some text " * 100}
    return packed(path, content, method)


def refused(path: Path) -> str:
    """The sentence an FMU and an SSP of these bytes are refused with; nothing is left behind."""
    with pytest.raises(FmuError) as caught:
        FmuComponent(path)
    said = str(caught.value)
    assert said.startswith(f"{path}: ")
    assert "\n" not in said
    return said.removeprefix(f"{path}: ")


def test_every_cut_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.fmu"
    good = whole(path)
    for length in [*range(0, 60), *range(60, len(good) - 1, 37)]:
        path.write_bytes(good[:length])
        assert "ZIP archive" in refused(path)


def test_any_damage_is_read_or_refused(tmp_path: Path, cache: Path) -> None:
    """Bytes flipped, runs of zeros, pieces twice and gone: never another exception."""
    random = np.random.default_rng(15)
    path = tmp_path / "x.fmu"
    good = whole(path)
    for _ in range(400):
        bad = bytearray(good)
        at = int(random.integers(0, len(bad)))
        length = int(random.integers(1, 30))
        how = random.integers(0, 4)
        if how == 0:
            for k in random.integers(0, len(bad), int(random.integers(1, 4))):
                bad[k] ^= 1 << int(random.integers(0, 8))
        elif how == 1:
            bad[at : at + length] = bytes(min(length, len(bad) - at))
        elif how == 2:
            bad[at:at] = bad[at : at + length]
        else:
            del bad[at : at + length]
        path.write_bytes(bad)
        try:
            FmuComponent(path)
        except FmuError as error:
            assert str(error).startswith(f"{path}: ")
            assert "\n" not in str(error)
    assert not [p for p in (cache / "unpacked").iterdir() if p.name.startswith("tmp")]


def directory(change: Callable[[bytearray, int], None]) -> Callable[[Path], None]:
    """A damage of the first entry of the central directory, in place."""

    def damage(path: Path) -> None:
        data = bytearray(whole(path))
        change(data, data.index(b"PK\x01\x02"))
        path.write_bytes(data)

    return damage


def put(kind: str, offset: int, value: int) -> Callable[[bytearray, int], None]:
    return lambda data, at: struct.pack_into(kind, data, at + offset, value)


def body(path: Path) -> None:
    """Compressed bytes that are no deflate."""
    data = bytearray(whole(path))
    start = 30 + len(DESCRIPTION)
    data[start : start + 20] = b"\xff" * 20
    path.write_bytes(data)


CASES: dict[str, tuple[Callable[[Path], object], str]] = {
    "wrong CRC": (directory(put("<I", 16, 1)), "ZIP archive"),
    "bad compression": (body, "not a readable FMU"),
    "encrypted": (directory(put("<H", 8, 1)), "is encrypted"),
    "method": (directory(put("<H", 10, 12)), "is compressed by method 12; expected deflate"),
    "says to be huge": (directory(put("<I", 24, 0xFFFFFFF0)), "xml has 4294967280 bytes"),
    "offset": (directory(put("<I", 42, 0x7FFFFFFF)), "ZIP archive"),
    "lzma": (lambda p: whole(p, zipfile.ZIP_LZMA), "compressed by method 14"),
    "twice": (
        lambda p: _twice(p, passing3() + "\n"),
        f"has 2 different entries with the name '{DESCRIPTION}'",
    ),
    "absolute": (lambda p: packed(p, {DESCRIPTION: b"", "/etc/x": b""}), "outside the folder"),
    "drive": (lambda p: packed(p, {DESCRIPTION: b"", "C:\\x": b""}), "outside the folder"),
    "up": (lambda p: packed(p, {DESCRIPTION: b"", "a/../../x": b""}), "outside the folder"),
    "file and folder": (lambda p: packed(p, {DESCRIPTION: b"", "a": b"", "a/b": b""}), "ZIP arch"),
    "long name": (lambda p: packed(p, {DESCRIPTION: b"", "x" * 5000: b""}), "ZIP archive"),
    "no description": (lambda p: packed(p, {"x": b""}), "contains no modelDescription.xml"),
    "a folder in its place": (lambda p: packed(p, {f"{DESCRIPTION}/": b""}), "contains no model"),
    "deep": (lambda p: packed(p, {DESCRIPTION: b"<a>" * 200_000}), "not well-formed"),
    "deep and closed": (
        lambda p: packed(p, {DESCRIPTION: b"<a>" * 20_000 + b"</a>" * 20_000}), "fmiVersion is ''",
    ),
    "empty": (lambda p: p.write_bytes(b""), "ZIP archive"),
}  # fmt: skip


def _twice(path: Path, second: str) -> None:
    with warnings.catch_warnings(), zipfile.ZipFile(path, "w") as target:
        warnings.simplefilter("ignore")
        for data in (passing3(), second):
            target.writestr("extra/", b"")
            target.writestr(DESCRIPTION, data)


def test_copies_of_an_entry_are_harmless(tmp_path: Path) -> None:
    """The Reference FMU Roberts, built with CMake, has the files of its extra folder twice."""
    path = tmp_path / "x.fmu"
    _twice(path, passing3())
    packed(tmp_path / "y.fmu", {DESCRIPTION: passing3().encode()})
    assert FmuComponent(path).description == FmuComponent(tmp_path / "y.fmu").description


@pytest.mark.parametrize("name", CASES)
def test_a_damage_on_purpose_is_named(tmp_path: Path, name: str) -> None:
    make, message = CASES[name]
    path = tmp_path / "x.fmu"
    make(path)
    said = refused(path)
    assert any(part in said for part in message.split("|")), said


def test_more_than_there_is_room_for_is_not_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "x.fmu"
    packed(path, {DESCRIPTION: b"", "zeros": bytes(1 << 20)})
    monkeypatch.setattr(archive, "MOST_ENTRIES", 1)
    assert refused(path) == "has 2 entries; expected at most 1"
    monkeypatch.undo()
    monkeypatch.setattr(archive, "cache_folder", lambda: tmp_path / "cache")
    usage = archive.shutil.disk_usage(tmp_path)
    monkeypatch.setattr(
        archive.shutil, "disk_usage", lambda _: type(usage)(usage.total, usage.used, 1000)
    )
    assert refused(path) == "would unpack to 1048576 bytes; expected at most 1000"


@pytest.mark.parametrize("seed", range(60))
def test_a_damaged_ssp_is_refused_in_the_same_way(tmp_path: Path, seed: int) -> None:
    random = np.random.default_rng(seed)
    path = tmp_path / "x.ssp"
    data = bytearray(packed(path, {ROOT: b"<a/>" * 200, "resources/x": b"text " * 300}))
    for at in random.integers(0, len(data), 3):
        data[at] ^= 1 << int(random.integers(0, 8))
    path.write_bytes(data)
    try:
        unpack_ssp(path)
    except ScenarioError as error:
        assert str(error).startswith(f"{path}: ")
        assert "\n" not in str(error)
    assert issubclass(ScenarioError, CosimError)


# ---- what was unpacked before --------------------------------------------------------------------


def damaged_empty(folder: Path) -> None:
    shutil.rmtree(folder)
    folder.mkdir()


def damaged_half(folder: Path) -> None:
    file = folder / "resources" / "a.txt"
    file.write_bytes(file.read_bytes()[:500])


def damaged_changed(folder: Path) -> None:
    file, times = folder / "resources" / "a.txt", (folder / "resources" / "a.txt").stat()
    file.write_bytes(file.read_bytes().replace(b"some", b"SOME"))
    os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))


def damaged_removed(folder: Path) -> None:
    (folder / "modelDescription.xml").unlink()


def damaged_old(folder: Path) -> None:
    (folder / archive.SUMS).unlink()  # as versions without sums left it


@pytest.mark.parametrize(
    "damage",
    [damaged_empty, damaged_half, damaged_changed, damaged_removed, damaged_old],
)
def test_a_damaged_folder_is_unpacked_again(tmp_path: Path, damage: Callable[[Path], None]) -> None:
    path = tmp_path / "x.fmu"
    whole(path)
    folder = FmuComponent(path).archive.folder
    before = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    damage(folder)
    assert FmuComponent(path).archive.folder == folder
    assert {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()} == before
    assert [p.name for p in folder.parent.iterdir()] == [folder.name]


def test_a_whole_folder_is_not_unpacked_again(tmp_path: Path) -> None:
    path = tmp_path / "x.fmu"
    whole(path)
    folder = FmuComponent(path).archive.folder
    (folder / "resources" / "written by the FMU").touch()
    assert FmuComponent(path).archive.folder == folder
    assert (folder / "resources" / "written by the FMU").exists()


def test_a_damaged_folder_that_cannot_be_replaced_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "x.fmu"
    whole(path)
    folder = FmuComponent(path).archive.folder
    damaged_half(folder)
    monkeypatch.setattr(Path, "rename", _refusing)
    with pytest.raises(FmuError, match=f"{folder}, where it was unpacked before, is damaged"):
        FmuComponent(path)


def _refusing(self: Path, target: Path) -> None:
    raise PermissionError(13, "Permission denied", str(target))
