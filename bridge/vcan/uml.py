"""One command under User-Mode Linux: the kernel as a process of this user."""

from __future__ import annotations

import fcntl
import os
import shutil
import signal
import subprocess
import tempfile
import threading
from contextlib import ExitStack, suppress
from pathlib import Path

from bridge.native import library_path
from bridge.vcan import cpus, guest, packages, supervise
from bridge.vcan.capabilities import bytes_of, memory_folder
from bridge.vcan.errors import VcanError
from bridge.vcan.guest import GuestCommand

_CHUNK = 1 << 16
_TOLD = 20  # lines of the console in a failure


def run(request: GuestCommand) -> int:
    """The command's exit status; in the watcher (`supervise`). Raises VcanError."""
    parts = packages.obtain()
    memory = memory_folder(bytes_of(request.memory))
    with ExitStack() as stack:
        folder = _folder(stack)
        guest.write(folder, request, parts)
        cause = _boot(folder, request, parts, memory)
        status = supervise.status_of(cause, _status(folder))
        if status is None:
            raise VcanError(f"the guest ended without a result; its output:\n{_console(folder)}")
        return status


def _folder(stack: ExitStack) -> Path:
    """A new folder in the cache, removed at the end; removes those whose launcher was killed."""
    with packages.lock_cache():
        for old in packages.cache().glob("run-*"):
            with suppress(OSError), (old / "lock").open("w") as file:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(old, ignore_errors=True)
        folder = Path(tempfile.mkdtemp(prefix="run-", dir=packages.cache()))
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        fcntl.flock(stack.enter_context((folder / "lock").open("w")), fcntl.LOCK_EX)
    return folder


def _boot(
    folder: Path, request: GuestCommand, parts: packages.GuestFiles, memory: Path
) -> signal.Signals | None:
    with ExitStack() as stack:
        cpu = _cpu(request.cpu, stack)
        console = os.open(folder / "console", os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        (out, out_end), (err, err_end), (control_end, control) = os.pipe(), os.pipe(), os.pipe()
        files = (console, out_end, err_end, control_end)
        process = supervise.start_command(
            guest.kernel_command(folder, request, parts, files),
            cpu=cpu,
            files=files,
            env=environment(memory, folder),
            stdin=subprocess.DEVNULL,
            stdout=console,
            stderr=console,
            start_new_session=True,
        )
        for end in files:
            os.close(end)
        pumps = [_pump(out, 1), _pump(err, 2)]

        def tell(number: signal.Signals) -> None:
            with suppress(OSError):
                os.write(control, number.name.removeprefix("SIG").encode() + b"\n")

        cause = supervise.wait_for_process(process, request.timeout, tell)
        supervise.end_descendants()
        for pump in pumps:
            pump.join()
        os.close(control)
    return cause


def environment(memory: Path, folder: Path) -> dict[str, str]:
    """The environment of the kernel as a process; ``bridge/c/xstate.c`` is loaded first."""
    found = {"TMPDIR": str(memory), "HOME": str(folder), "PATH": os.defpath}
    return {**found, "LD_PRELOAD": str(library_path())}


def _cpu(wanted: str, stack: ExitStack) -> int | None:
    if wanted == "free":
        return None
    if not wanted:
        cpu, taken = cpus.choose(packages.cache())
        if taken:
            stack.enter_context(taken)
        return cpu
    if not wanted.isdigit() or int(wanted) not in os.sched_getaffinity(0):
        here = ", ".join(map(str, sorted(os.sched_getaffinity(0))))
        raise VcanError(f"--cpu {wanted}: expected 'free' or one of the CPUs {here}")
    return int(wanted)


def _pump(source: int, target: int) -> threading.Thread:
    """Copies what comes until it ends. When nobody reads the target any more, the run stops."""

    def copy() -> None:
        listening = True
        while chunk := os.read(source, _CHUNK):
            while chunk and listening:
                try:
                    chunk = chunk[os.write(target, chunk) :]
                except OSError:
                    listening = False
                    os.kill(os.getpid(), supervise.READER_GONE)
        os.close(source)

    thread = threading.Thread(target=copy, daemon=True)
    thread.start()
    return thread


def _status(folder: Path) -> int | None:
    with suppress(OSError, ValueError):
        return int((folder / "status").read_text())
    return None


def _console(folder: Path) -> str:
    with suppress(OSError):
        lines = (folder / "console").read_text(errors="replace").splitlines()
        return "\n".join(lines[-_TOLD:])
    return "nothing"
