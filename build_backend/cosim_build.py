"""The build backend (PEP 517, PEP 660): setuptools, after the compiled parts are made.

* ``ziglang`` is asked for only where no C compiler works, or where the committed WebAssembly is not
  that of the sources; ``uplot-python`` only without pip.
* The wheel is for one platform and any Python 3: the engine is a plain shared library.
* Nothing is built in ``build/``: what an earlier version left there cannot get into a wheel.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import compiled
import plots
from setuptools import build_meta
from setuptools.command.bdist_wheel import bdist_wheel

Settings = dict[str, Any] | None

#: The tag of a wheel for each of fmus.build.toolchain.PLATFORMS; systems as old as zig's targets.
TAGS = {
    "x86_64-linux": "manylinux_2_17_x86_64",
    "aarch64-linux": "manylinux_2_17_aarch64",
    "x86_64-windows": "win_amd64",
    "x86_64-darwin": "macosx_11_0_x86_64",
    "aarch64-darwin": "macosx_11_0_arm64",
}

sys.path.insert(0, str(compiled.ROOT))


class PlatformWheel(bdist_wheel):
    """A wheel tagged ``py3-none-PLATFORM``."""

    def finalize_options(self) -> None:
        """Count as a distribution with compiled parts, which are not extension modules."""
        self.distribution.has_ext_modules = lambda: True  # type: ignore[method-assign]
        super().finalize_options()

    def get_tag(self) -> tuple[str, str, str]:
        """No Python version and no ABI: nothing here is compiled against either."""
        return "py3", "none", super().get_tag()[2]


def get_requires_for_build_wheel(config_settings: Settings = None) -> list[str]:
    """The requirements of `build_wheel` besides ``build-system.requires``."""
    with _outside_the_sources():
        return build_meta.get_requires_for_build_wheel(config_settings) + _others()


def get_requires_for_build_editable(config_settings: Settings = None) -> list[str]:
    """The requirements of `build_editable` besides ``build-system.requires``."""
    with _outside_the_sources():
        return build_meta.get_requires_for_build_editable(config_settings) + _others()


def get_requires_for_build_sdist(config_settings: Settings = None) -> list[str]:
    """The requirements of `build_sdist` besides ``build-system.requires``: no compiler."""
    with _outside_the_sources():
        return build_meta.get_requires_for_build_sdist(config_settings)


def prepare_metadata_for_build_wheel(directory: str, config_settings: Settings = None) -> str:
    """Metadata of the wheel; compiles nothing."""
    with _outside_the_sources():
        return build_meta.prepare_metadata_for_build_wheel(directory, config_settings)


def prepare_metadata_for_build_editable(directory: str, config_settings: Settings = None) -> str:
    """Metadata of the editable wheel; compiles nothing."""
    with _outside_the_sources():
        return build_meta.prepare_metadata_for_build_editable(directory, config_settings)


def build_sdist(sdist_directory: str, config_settings: Settings = None) -> str:
    """A source distribution: nothing compiled in it."""
    with _outside_the_sources():
        return build_meta.build_sdist(sdist_directory, config_settings)


def build_wheel(
    wheel_directory: str, config_settings: Settings = None, metadata_directory: str | None = None
) -> str:
    """A wheel with engine and FMUs, for this platform or the one that the setting `platform` names.

    For another platform it is built in a copy of the sources, by ``wheels.py``.
    """
    settings = dict(config_settings or {})
    platform = settings.pop("platform", None)
    compiled.build(platform)
    if platform is not None:
        settings["--build-option"] = [f"--plat-name={TAGS[platform]}"]
    with _outside_the_sources():
        return build_meta.build_wheel(wheel_directory, settings, metadata_directory)


def build_editable(
    wheel_directory: str, config_settings: Settings = None, metadata_directory: str | None = None
) -> str:
    """An editable wheel; engine and FMUs are built in place."""
    compiled.build()
    with _outside_the_sources():
        return build_meta.build_editable(wheel_directory, config_settings, metadata_directory)


def _others() -> list[str]:
    from fmus.build.toolchain import host_compiler

    zig = [] if host_compiler() and compiled.pages_are_current() else ["ziglang>=0.13"]
    return [*zig, *plots.requirements()]


@contextmanager
def _outside_the_sources() -> Iterator[None]:
    """Let setuptools keep its build and egg-info folders in a place of their own."""
    with tempfile.TemporaryDirectory(prefix="cosim-build-") as scratch:
        settings = Path(scratch, "setup.cfg")
        settings.write_text(
            f"[build]\nbuild_base = {scratch}/build\n[egg_info]\negg_base = {scratch}\n"
        )
        before = os.environ.get("DIST_EXTRA_CONFIG")
        os.environ["DIST_EXTRA_CONFIG"] = str(settings)
        try:
            yield
        finally:
            del os.environ["DIST_EXTRA_CONFIG"]
            if before is not None:
                os.environ["DIST_EXTRA_CONFIG"] = before
