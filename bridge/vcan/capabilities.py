"""Abilities of this host, found out by trying them."""

from __future__ import annotations

import ctypes
import mmap
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from bridge.vcan import packages
from bridge.vcan.errors import VcanError

_PTRACE_TRACEME = 0
_UNITS = {"K": 2**10, "M": 2**20, "G": 2**30}


@dataclass(frozen=True)
class Ability:
    """True if a backend would work here, and why or why not."""

    backend: str
    possible: bool
    why: str


def bytes_of(size: str) -> int:
    """Bytes of a text like ``512M`` or ``1G``; raises VcanError."""
    match = re.fullmatch(r"(\d+)([KMG])", size)
    if not match:
        raise VcanError(f"--mem {size}: expected a number with K, M or G, such as 1G")
    return int(match[1]) * _UNITS[match[2]]


def namespace_command() -> list[str]:
    """The command that runs another in a network of its own, in which it is root."""
    return ["unshare", "--net", *([] if os.geteuid() == 0 else ["--map-root-user"]), "--"]


def host() -> Ability:
    """True if the host's own kernel has vcan, and lets us make interfaces."""
    for tool in ("unshare", "ip"):
        if not shutil.which(tool):
            return Ability("host", False, f"{tool} was not found (util-linux, iproute2)")
    command = [*namespace_command(), "ip", "link", "add", "dev", "vcan0", "type", "vcan"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        return Ability("host", False, " ".join(done.stderr.split()))
    echo = Path("/sys/module/vcan/parameters/echo")
    works = echo.is_file() and echo.read_text().strip() in ("1", "Y")
    return Ability("host", True, "vcan can be made" + ("" if works else "; netem has no effect"))


def uml(memory: str = "1G") -> Ability:
    """True if User-Mode Linux can run here with so much memory."""
    try:
        _check_platform()
        _check_ptrace()
        folder = memory_folder(bytes_of(memory))
        lacking = packages.missing()
        if lacking and not shutil.which("apt-get"):
            raise VcanError(
                f"{' and '.join(lacking)} are not in {packages.cache()}, and apt-get is missing"
            )
    except VcanError as error:
        return Ability("uml", False, str(error))
    state = f"to be downloaded: {', '.join(lacking)}" if lacking else f"in {packages.cache()}"
    return Ability("uml", True, f"ptrace works, memory in {folder}, packages {state}")


def memory_folder(size: int) -> Path:
    """A folder for the guest's memory: `size` bytes free, and files in it may be executed.

    Memory file systems first; containers often give them 64 MB, or forbid execution in them.
    Raises VcanError if there is none.
    """
    found = []
    for folder in dict.fromkeys(("/dev/shm", tempfile.gettempdir(), "/tmp", "/var/tmp")):
        problem = _problem_of(Path(folder), size)
        if not problem:
            return Path(folder)
        found.append(f"{folder}: {problem}")
    raise VcanError(
        f"no folder for the guest's memory; expected {size / 2**20:.0f} MB of free space and "
        f"permission to execute; found {'; '.join(found)} (set --mem or TMPDIR)"
    )


def _problem_of(folder: Path, size: int) -> str:
    try:
        if shutil.disk_usage(folder).free < size:
            return "too little space"
        with tempfile.TemporaryFile(dir=folder) as file:
            file.truncate(mmap.PAGESIZE)
            protection = mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC
            mmap.mmap(file.fileno(), mmap.PAGESIZE, mmap.MAP_SHARED, protection).close()
    except OSError as error:
        return error.strerror or str(error)
    return ""


def _check_platform() -> None:
    here = f"{sys.platform} {platform.machine()}"
    if here != "linux x86_64":
        raise VcanError(f"User-Mode Linux runs on linux x86_64; this is {here}")


def _check_ptrace() -> None:
    child = os.fork()
    if child == 0:
        ctypes.CDLL(None).ptrace(_PTRACE_TRACEME, 0, None, None)
        os.kill(os.getpid(), signal.SIGSTOP)
        os._exit(0)
    _, status = os.waitpid(child, os.WUNTRACED)
    if os.WIFSTOPPED(status):
        traced = Path(f"/proc/{child}/status").read_text()
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        if f"TracerPid:\t{os.getpid()}\n" in traced:
            return
    raise VcanError(
        "ptrace is forbidden here, and User-Mode Linux needs it (docker run "
        "--cap-add=SYS_PTRACE or --security-opt seccomp=unconfined; kernel.yama.ptrace_scope < 3)"
    )
