"""The files a guest starts from, and how its kernel is called."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bridge.vcan.errors import VcanError
from bridge.vcan.packages import GuestFiles

INIT = Path(__file__).with_name("init.sh")
#: Folders that are the guest's own: of the host's files there it sees nothing.
HIDDEN = ("/dev", "/proc", "/run", "/sys")


@dataclass(frozen=True)
class GuestCommand:
    """A command, and the machine it asks for."""

    command: tuple[str, ...]
    timeout: float = float("inf")  # s, start of the guest included
    memory: str = "1G"
    cpu: str = ""  # its number; "free": any at any time; "": the idlest at the start
    buses: int = 2  # vcan0, vcan1, ...


def write(folder: Path, request: GuestCommand, parts: GuestFiles) -> None:
    """Settings and command of one run; raises VcanError for what the guest could not do."""
    modules = "\n".join(f"{file} {parameters}".rstrip() for file, parameters in parts.modules)
    settings = f"busybox={shlex.quote(str(parts.busybox))}\nbuses={request.buses}\n"
    (folder / "settings").write_text(settings + f"modules={shlex.quote(modules)}\n")
    script = command_script(request.command, os.environ, Path.cwd())
    (folder / "command").write_bytes(os.fsencode(script))


def command_script(command: Sequence[str], environment: Mapping[str, str], cwd: Path) -> str:
    """A script that becomes the command, in this folder, with this environment and our umask.

    Raises VcanError if the command's name contains ``=``, or if the guest hides the folder.
    """
    if "=" in command[0]:
        raise VcanError(f"command {command[0]!r}: expected a name without '='")
    if any(cwd.is_relative_to(folder) for folder in HIDDEN):
        raise VcanError(f"working folder {cwd}: a guest has its own {', '.join(HIDDEN)}")
    umask = os.umask(0)
    os.umask(umask)
    pairs = (f"{name}={value}" for name, value in environment.items())
    words = ["/usr/bin/env", "-i", *pairs, *command]  # busybox would run its own applets
    lines = (f"umask {umask:04o}", f"cd {shlex.quote(str(cwd))} || exit 125")
    return "\n".join((*lines, "exec " + shlex.join(words), ""))


def kernel_command(
    folder: Path, request: GuestCommand, parts: GuestFiles, files: tuple[int, int, int, int]
) -> list[str]:
    """The call of the kernel; `files`: descriptors of console, output, errors, control line.

    Raises VcanError for a path with characters that the kernel's command line does not accept.
    """
    for path in (folder, INIT, parts.busybox):
        if not re.fullmatch(r"[\w./+~:@%-]+", str(path), re.ASCII):
            raise VcanError(f"{path}: the kernel's command line cannot contain these characters")
    console, out, err, control = files
    return [
        *(str(parts.linux), f"mem={request.memory}", "rootfstype=hostfs", "rootflags=/", "rw"),
        *("quiet", "root=98:0", f"init={parts.busybox}", f"uml_dir={folder}", "umid=guest"),
        *("con=null", f"con0=null,fd:{console}", "ssl=null", f"ssl0=null,fd:{out}"),
        *(f"ssl1=null,fd:{err}", f"ssl2=fd:{control},null", "--", "sh", str(INIT), str(folder)),
    ]
