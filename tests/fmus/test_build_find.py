"""Where FMUs and kernels come from: the installation, the cache, or built now."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from zipfile import ZipFile

import pytest

from cosim.base.copies import replace
from cosim.base.errors import FmuError
from fmus.build import archive as building
from fmus.build import kernel as kernels
from fmus.build import shipped as shipping
from fmus.build.archive import VERSIONS, find, pack
from fmus.build.library import compile_model
from fmus.model import Model
from fmus.models import operator

pytestmark = pytest.mark.usefixtures("compiled_once")

HAND = operator.model()
STEPS = 200


@pytest.fixture(scope="module")
def hand() -> Mapping[str, bytes]:
    """The operator's library for the host: the quickest to compile."""
    return compile_model(HAND)


# --- find ------------------------------------------------------------------------------------


@pytest.fixture
def empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """No FMU is there yet: an empty cache and an installation without any."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(shipping, "FOLDER", tmp_path / "installed")
    return tmp_path


def install(model: Model, folder: Path, binaries: Mapping[str, bytes]) -> Path:
    """An installation with the FMU 2.0 of a model."""
    brought = pack(model, "2.0", folder / "installed", binaries)
    index = shipping.index([(model, "2.0")])
    (folder / "installed" / shipping.STAMP).write_text(json.dumps(index))
    return brought


def test_what_an_installation_brought_is_used(empty: Path, hand: Mapping[str, bytes]) -> None:
    brought = install(HAND, empty, hand)
    assert find(HAND, "2.0") == operator.fmu("2.0") == brought
    assert not (empty / "cache").exists()


def test_what_is_not_there_is_built_once(
    empty: Path, hand: Mapping[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def instead(model: Model, platforms: object = None) -> Mapping[str, bytes]:
        calls.append(model.identifier)
        return hand

    monkeypatch.setattr(building, "compile_model", instead)
    path = find(HAND, "3.0")
    assert path.is_relative_to(empty / "cache" / "cosim" / "fmus")
    assert find(HAND, "3.0") == path
    assert find(HAND, "2.0").parent == path.parent
    assert calls == ["operator"]


def test_an_fmu_of_an_older_declaration_is_not_used(empty: Path, hand: Mapping[str, bytes]) -> None:
    install(replace(HAND, version="0.9"), empty, hand)
    (empty / "installed" / "operator.fmi3.fmu").write_bytes(b"no archive")
    for version in VERSIONS:
        assert find(HAND, version).is_relative_to(empty / "cache")


def test_an_fmu_of_older_sources_is_not_used(
    empty: Path, hand: Mapping[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither if the generator or a C file changed since."""
    brought = install(HAND, empty, hand)
    changed = empty / "c" / "operator.c"
    changed.parent.mkdir()
    changed.write_text("/* another law */")
    files = [changed if path.name == "operator.c" else path for path in shipping.made_from()]
    assert changed in files
    monkeypatch.setattr(shipping, "made_from", lambda: files)
    assert find(HAND, "2.0").is_relative_to(empty / "cache")
    assert brought.is_file()


@pytest.mark.parametrize("stamp", [None, b"{", b"{}"])
def test_an_installation_without_an_index_is_not_used(
    empty: Path, hand: Mapping[str, bytes], stamp: bytes | None
) -> None:
    install(HAND, empty, hand)
    file = empty / "installed" / shipping.STAMP
    file.unlink() if stamp is None else file.write_bytes(stamp)
    assert find(HAND, "2.0").is_relative_to(empty / "cache")


def test_a_kernel_is_the_library_of_the_fmu(empty: Path) -> None:
    path = kernels.library(HAND)
    for version in VERSIONS:
        with ZipFile(find(HAND, version)) as archive:
            inside = [n for n in archive.namelist() if n.startswith("binaries/")]
            assert [archive.read(name) for name in inside] == [path.read_bytes()]


def test_a_cache_that_cannot_be_written_is_named(empty: Path) -> None:
    (empty / "cache").write_text("a file, not a folder")
    with pytest.raises(FmuError, match=r"cannot be created.*XDG_CACHE_HOME"):
        find(HAND, "2.0")
