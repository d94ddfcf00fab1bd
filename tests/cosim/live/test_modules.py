"""Models as WebAssembly: of the installation, from the cache, or compiled if that is asked for."""

from __future__ import annotations

import zlib
from importlib import import_module
from pathlib import Path

import pytest

from cosim.live import LiveError, bundle
from cosim.loading.files import load

CONFIG = Path(__file__).parents[3] / "configs" / "teleoperation.toml"
SHORT = ("run.stop=0.1",)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of kept models."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "cosim" / "wasm"


def test_what_is_kept_is_not_looked_up_again(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = load(CONFIG, SHORT)
    first = bundle(scenario, SHORT, asked=False)["modules"]
    kept = sorted(cache.iterdir())
    assert len(kept) == len(first) == 2
    content = [path.read_bytes() for path in kept]
    assert all(zlib.decompress(x).startswith(b"\0asm") for x in content)
    kept[0].write_bytes(content[0][:-9])
    assert bundle(scenario, SHORT, asked=False)["modules"] == first
    assert kept[0].read_bytes() == content[0], "a damaged file is written again"
    monkeypatch.delattr(import_module("cosim.live.bundle"), "part")
    assert bundle(scenario, SHORT, asked=False)["modules"] == first


def test_nothing_is_compiled_unasked(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fmus.build.wasm.FOLDER", tmp_path / "elsewhere")
    with pytest.raises(LiveError, match=r"\w+: .*\.fmu is not compiled to WebAssembly yet"):
        bundle(load(CONFIG, SHORT), SHORT, asked=False)
    assert not cache.exists()
