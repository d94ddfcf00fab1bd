"""The C compiler: C99 sources in, one shared library out, the same numbers from every compiler.

The host's own compiler builds for the host (``$CC``, ``cc``, ``gcc`` or ``clang``, the first that
builds a small library). If there is none, and for every other platform, the PyPI package `ziglang`
is used. This module does not depend on FMI or on models.

Equal numbers require C99, no fused multiply-add (``-ffp-contract=off``), no fast-math, and no
instruction set beyond the platform's baseline. The sources must bring their own sin and cos; sqrt,
which is correctly rounded on every platform, may come from libm.
"""

from __future__ import annotations

import atexit
import os
import platform as _host
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from cosim.base.errors import CosimError

#: Platforms anything can be built for from here, by FMI 3.0's platform names (3.0.2, 2.5.1.4.1),
#: and what zig calls them. Old on purpose: glibc 2.17 is of 2012, macOS 11 of 2020.
_TARGETS = {
    "x86_64-linux": "x86_64-linux-gnu.2.17",
    "aarch64-linux": "aarch64-linux-gnu.2.17",
    "x86_64-windows": "x86_64-windows-gnu",
    "x86_64-darwin": "x86_64-macos.11.0",
    "aarch64-darwin": "aarch64-macos.11.0",
}
PLATFORMS = tuple(_TARGETS)
#: WebAssembly with the C library of WASI, for pages; FMUs are not built for it. Its features are
#: those of every browser since 2021.
WEB = "wasm32-wasi"

#: Compiler options that every library is built with.
FLAGS = (
    "-std=c99",
    "-O2",
    "-g0",
    "-ffp-contract=off",
    "-fno-fast-math",
    "-fvisibility=hidden",
)
_CPU = {WEB: "generic-extended_const"}
_SUFFIX = {"linux": ".so", "windows": ".dll", "darwin": ".dylib", "wasi": ".wasm"}
_SYSTEMS = ("darwin", "linux", "windows")
_MACHINE = {"amd64": "x86_64", "arm64": "aarch64"}
_ZIG = (sys.executable, "-m", "ziglang")
_PROBE = "#include <math.h>\n#include <stdlib.h>\n#include <string.h>\nint probe(void){return 0;}\n"


class ToolchainError(CosimError, RuntimeError):
    """There is no compiler for a platform, or it refused the sources."""


def host_platform() -> str:
    """The platform this runs on, as ``"x86_64-linux"``; need not be one of :data:`PLATFORMS`.

    Raises ToolchainError on an operating system that is not Linux, Windows or macOS.
    """
    machine, system = _host.machine().lower(), _host.system().lower()
    if system not in _SYSTEMS:
        raise ToolchainError(
            f"cannot build for operating system {_host.system()!r}; expected one of "
            f"{', '.join(_SYSTEMS)}"
        )
    return f"{_MACHINE.get(machine, machine)}-{system}"


def shared_suffix(platform: str | None = None) -> str:
    """``".so"``, ``".dll"`` or ``".dylib"``. `platform`: default the host's.

    Raises ToolchainError for a platform of an unknown operating system.
    """
    name = platform or host_platform()
    try:
        return _SUFFIX[name.rpartition("-")[2]]
    except KeyError:
        raise ToolchainError(_unknown(name)) from None


@lru_cache(maxsize=1)
def host_compiler() -> tuple[str, ...] | None:
    """The command of the host's own C compiler, or None where there is none that works.

    ``$CC`` is taken at its word: if it is set, nothing else is tried. What is only found under
    a usual name must build a small library first (a `cc` may come without a C library).
    """
    if os.environ.get("CC", "").strip():
        return tuple(shlex.split(os.environ["CC"]))
    names = ("gcc",) if host_platform().endswith("windows") else ("cc", "gcc", "clang")
    for name in names:
        path = shutil.which(name)
        if path is not None and _works(path):
            return (path,)
    return None


def compiler(platform: str | None = None) -> tuple[str, ...]:
    """The command that compiles for `platform` (default: the host), with its own options.

    Raises ToolchainError where there is none, saying what to install.
    """
    name = platform or host_platform()
    native = host_compiler() if name == host_platform() else None
    if native is not None:
        return native
    if name not in (*_TARGETS, WEB):
        raise ToolchainError(_unknown(name))
    if find_spec("ziglang") is None:
        missing = "no C compiler (CC, cc, gcc, clang)" if name == host_platform() else "no compiler"
        raise ToolchainError(
            f"{missing} for {name} on {host_platform()}: 'pip install ziglang' provides one"
        )
    return zig(name)


def zig(platform: str) -> tuple[str, ...]:
    """The command of zig that compiles for one of :data:`PLATFORMS`, for its oldest systems, or
    for :data:`WEB`.
    """
    target, cpu = _TARGETS.get(platform, platform), _CPU.get(platform, "baseline")
    flags = (f"-mcpu={cpu}", "-fno-sanitize=undefined")
    program = _zig_itself() if platform == WEB else _ZIG
    return (*program, "cc", "-target", target, *flags)


def _zig_itself() -> tuple[str, ...]:
    """The program of zig, without a process of Python around each of its many calls for pages."""
    found = find_spec("ziglang")
    if found is None or found.origin is None:
        return _ZIG
    program = Path(found.origin).with_name("zig.exe" if os.name == "nt" else "zig")
    return (str(program),) if program.is_file() else _ZIG


def compile_shared(
    sources: Sequence[Path | str],
    output: Path | str,
    *,
    include: Iterable[Path | str] = (),
    defines: Mapping[str, str | int | None] | None = None,
    platform: str | None = None,
    flags: Iterable[str] = (),
) -> Path:
    """Compile C99 `sources` into the shared library `output` and return its path.

    `include`: directories; `defines`: macros, None for one without value; `platform`: default
    the host's; `flags`: further options, after (and so stronger than) :data:`FLAGS`. Only what
    is marked for export is visible. The library appears at once and complete: a process that
    has an older one mapped keeps it, and two builds at a time do not meet.

    Each source is compiled by a process of its own, as many at a time as there are processors.
    Raises ToolchainError with the compiler's last lines.
    """
    options = [f"-D{k}" if v is None else f"-D{k}={v}" for k, v in (defines or {}).items()]
    options += flags
    with tempfile.TemporaryDirectory(prefix="cc-") as scratch, processes() as pool:
        jobs = [
            pool.submit(
                compile_object,
                source,
                Path(scratch, f"{n}.o"),
                include=tuple(include),
                platform=platform,
                flags=options,
            )
            for n, source in enumerate(sources)
        ]
        return link_shared([job.result() for job in jobs], output, platform=platform, flags=flags)


def processes() -> ThreadPoolExecutor:
    """Threads that each wait for a compiler: one for each processor."""
    return ThreadPoolExecutor(os.cpu_count())


def compile_object(
    source: Path | str,
    output: Path | str,
    *,
    include: Iterable[Path | str] = (),
    platform: str | None = None,
    flags: Iterable[str] = (),
) -> Path:
    """Compile one C99 `source` into the object file `output`, to be linked by `link_shared`.

    Arguments as of :func:`compile_shared`. Raises ToolchainError with the compiler's last lines.
    """
    name = platform or host_platform()
    command = [*compiler(name), *FLAGS, *_position_independent(name)]
    command += [f"-I{Path(folder).resolve()}" for folder in include]
    command += [*flags, "-c", "-o", str(output), str(Path(source).resolve())]
    _run(command, f"{Path(source).name} for {name}")
    return Path(output)


def link_shared(
    objects: Iterable[Path],
    output: Path | str,
    *,
    platform: str | None = None,
    flags: Iterable[str] = (),
    libraries: Iterable[str] = (),
) -> Path:
    """Link `objects` and `libraries` (names) into the shared library `output`, which appears at
    once and complete.

    Raises ToolchainError with the linker's last lines.
    """
    target = Path(output).resolve()
    target.parent.mkdir(parents=True, exist_ok=True)
    name = platform or host_platform()
    command = [*compiler(name), *FLAGS, "-shared", *_platform_flags(name, target.name), *flags]
    if name == WEB:
        command = _web_linker(flags)
    with tempfile.TemporaryDirectory(prefix=".cc-", dir=target.parent) as scratch:
        built = Path(scratch, target.name)
        command += ["-o", str(built), *map(str, objects)]
        command += [f"-l{library}" for library in libraries]
        command += ["-lm"] if name.endswith("linux") else []
        _run(command, f"{target.name} for {name}")
        built.replace(target)
    return target


def _web_linker(flags: Iterable[str]) -> list[str]:
    """The command that links for a page: the engine, which has an execution model, or a library
    that is loaded into its memory.
    """
    if any(flag.startswith("-mexec-model") for flag in flags):
        return [*compiler(WEB), *flags]
    library = ["--experimental-pic", "-shared", "--import-memory", "--no-entry"]
    return [*_zig_itself(), "wasm-ld", *library, "--allow-undefined", "--strip-all"]


def _position_independent(platform: str) -> list[str]:
    return [] if platform.endswith("windows") else ["-fPIC"]


def _platform_flags(platform: str, name: str) -> list[str]:
    """The options of the linker for a shared library on each system.

    On Linux a library binds its own calls to itself (several FMUs in one process define the
    same names), and is not said to need libm unless it calls it. On Windows symbols are
    stripped: with them comes the time of the build, and no two builds would be the same.
    """
    system = platform.rpartition("-")[2]
    if system == "linux":
        return ["-fPIC", "-Wl,-Bsymbolic", "-Wl,--as-needed"]
    if system == "darwin":
        return ["-fPIC", f"-Wl,-install_name,@rpath/{name}"]
    return ["-s"]


def _run(command: list[str], what: str) -> None:
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
            env=_environment(),
        )
    except OSError as error:
        raise ToolchainError(
            f"cannot start the compiler {command[0]!r} for {what} ({error.strerror}): "
            "set CC to one that exists, or unset it and 'pip install ziglang'"
        ) from None
    if done.returncode:
        last = "\n  ".join((done.stderr + done.stdout).strip().splitlines()[-20:])
        raise ToolchainError(
            f"compiling {what} failed (exit code {done.returncode}):\n  {last}\n"
            f"command: {shlex.join(command)}"
        )


def _environment() -> dict[str, str]:
    """The environment of a compiler: plain messages, and a place for zig's cache."""
    environment = {**os.environ, "LC_ALL": "C"}
    usual = Path(os.path.expanduser("~"), ".cache")
    if not os.access(usual if usual.is_dir() else usual.parent, os.W_OK):
        environment.setdefault("ZIG_GLOBAL_CACHE_DIR", _own_cache())
    return environment


@lru_cache(maxsize=1)
def _own_cache() -> str:
    """A cache for this process alone, removed at its end, where there is no home to keep one in."""
    folder = tempfile.mkdtemp(prefix="zig-cache-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _works(command: str) -> bool:
    """True if a compiler found by name builds a library with the C library's headers."""
    with tempfile.TemporaryDirectory(prefix="cc-") as scratch:
        source = Path(scratch, "probe.c")
        source.write_text(_PROBE)
        flags = [*FLAGS, "-shared", *_platform_flags(host_platform(), "probe")]
        try:
            _run([command, *flags, "-o", str(Path(scratch, "probe")), str(source)], "a probe")
        except ToolchainError:
            return False
    return True


def _unknown(platform: str) -> str:
    return f"unknown platform {platform!r}; expected one of {', '.join(PLATFORMS)}"
