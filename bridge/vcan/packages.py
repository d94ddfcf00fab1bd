"""The kernel and its tools: Debian packages, unpacked into a cache folder, not installed."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from bridge.vcan.errors import VcanError

#: Names another cache folder than ``$XDG_CACHE_HOME/cosim/vcan``.
VARIABLE = "COSIM_VCAN_CACHE"
#: The packages, and the file that each is needed for.
PACKAGES = {"user-mode-linux": "usr/bin/linux.uml", "busybox-static": "bin/busybox"}
#: Modules in the order in which they are loaded (with their parameters); only
#: those in `REQUIRED` must be there.
MODULES = (
    ("can", ""),
    ("can-raw", ""),
    ("can-dev", ""),
    ("vcan", "echo=1"),  # without it af_can loops frames back before the queueing discipline
    ("can-bcm", ""),
    ("can-gw", ""),
    ("can-isotp", ""),
    ("vxcan", ""),
    ("sch_netem", ""),
)
REQUIRED = ("can", "can-raw", "vcan")


@dataclass(frozen=True)
class GuestFiles:
    """Files of the packages: the kernel, a static busybox, and the modules in loading order."""

    linux: Path
    busybox: Path
    modules: tuple[tuple[Path, str], ...]  # file, parameters


def cache() -> Path:
    """The cache folder; it need not exist."""
    named = os.environ.get(VARIABLE)
    if named:
        return Path(named).absolute()
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "cosim" / "vcan"


def missing() -> list[str]:
    """Names of the packages that are not in the cache."""
    return [name for name, file in PACKAGES.items() if not (cache() / name / file).is_file()]


def obtain() -> GuestFiles:
    """The parts, after downloading what is missing (once, whoever asks at the same time).

    Raises VcanError when apt is missing or refuses.
    """
    if missing():
        with lock_cache():
            for name in missing():
                _download(name, cache() / name)
    linux, busybox = (cache() / name / file for name, file in PACKAGES.items())
    return GuestFiles(linux, busybox, tuple(_modules(cache() / "user-mode-linux")))


def _modules(package: Path) -> Iterator[tuple[Path, str]]:
    folder = package / "usr/lib/uml/modules"
    files = {file.stem.replace("_", "-"): file for file in folder.glob("**/*.ko")}
    for name, parameters in MODULES:
        file = files.get(name.replace("_", "-"))
        if file:
            yield file, parameters
        elif name in REQUIRED:
            raise VcanError(f"{folder} has no {name}.ko; expected a kernel with CAN modules")


@contextmanager
def lock_cache() -> Iterator[None]:
    """Only one launcher at a time is in here; the cache folder is made. Raises VcanError."""
    path = cache() / "lock"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("w")
    except OSError as error:
        raise VcanError(f"no cache folder ({error}); set {VARIABLE} to another folder") from error
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _download(name: str, place: Path) -> None:
    for tool in ("apt-get", "dpkg-deb"):
        if not shutil.which(tool):
            raise VcanError(
                f"{tool} was not found, so the Debian package {name} cannot be downloaded; "
                f"unpack it (ar x, tar x) as {place}, or use a machine with Debian or Ubuntu"
            )
    with tempfile.TemporaryDirectory(dir=place.parent, prefix="new-") as scratch:
        # apt's own user could not write here, and there is nothing to protect from it
        get = ["apt-get", "-q", "-o", "APT::Sandbox::User=root", "download", name]
        _run(get, scratch, f"cannot download the Debian package {name}")
        file = next(Path(scratch).glob("*.deb"))
        unpacked = Path(scratch) / "unpacked"
        _run(["dpkg-deb", "-x", str(file), str(unpacked)], scratch, f"cannot unpack {file.name}")
        shutil.rmtree(place, ignore_errors=True)
        unpacked.rename(place)


def _run(command: list[str], folder: str, failure: str) -> None:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, errors="replace")
    if done.returncode:
        said = " ".join((done.stderr or done.stdout).split())
        raise VcanError(f"{failure}: {said} (apt-get update renews the lists of packages)")
