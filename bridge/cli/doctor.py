"""``cosim doctor``: whether this machine can do what the commands need, and what cures it."""

from __future__ import annotations

import os
import platform
import shutil
import socket
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from cosim.base.copies import asdict
from cosim.base.errors import CosimError
from cosim.cli.options import Json, write_json

State = Literal["good", "limited", "missing"]
_MARKS = {"good": "✓", "limited": "!", "missing": "✗"}
#: Optional packages: what needs them.
EXTRAS = {
    "matplotlib": ("figures", "figures as PNG, PDF and GIF, and cosim reproduce"),
    "scipy": ("fit", "cosim fit and files for MATLAB"),
    "mujoco-core": ("mujoco", "scenes of MuJoCo"),
    "wasmtime": ("wasm", 'FMUs in WebAssembly, and isolate = "wasm"'),
    "canopen": ("canopen", "drives with CANopen (CiA 402)"),
    "asammdf": ("mf4", "bus logs as MF4"),
    "foxglove-sdk": ("foxglove", "MCAP files and cosim monitor for Foxglove"),
    "distributed": ("cluster", "sweeps on a Dask cluster"),
}
#: Free space that a long run may need, bytes.
SPACE = 2**30
#: Port of a Zenoh router.
ZENOH = 7447


@dataclass(frozen=True, slots=True)
class MachineCheck:
    """One thing that was looked at: what was `found`, what it is for, and what cures it."""

    name: str
    state: State
    found: str
    purpose: str
    cure: str = ""


def doctor(
    json: Json = None,
    deploy: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Check the buses and real drives of this deployment instead, step by step.",
        ),
    ] = None,
    interface: Annotated[
        str | None,
        typer.Option("--interface", "-i", help="With --deploy: python-can interface of its buses."),
    ] = None,
    channel: Annotated[
        list[str] | None,
        typer.Option("--channel", "-c", metavar="BUS=CHANNEL", help="With --deploy; repeatable."),
    ] = None,
    yes: Annotated[
        bool,
        typer.Option("--yes", help="With --deploy: do not ask; the emergency stop is not proven."),
    ] = False,
) -> None:
    """Check this machine: Python, engine, compiler, networks, CAN, real time; with cures.

    With --deploy: interfaces, drives, registers, watchdogs, directions and emergency stop of a
    deployment with real drives, which move with 1 % of their torque. Exit status 1 if something
    that is needed is missing; with --deploy, 3 if nothing is, but a step was not checked.
    """
    if deploy is not None:
        from bridge.cli.doctor_deploy import check_deployment
        from bridge.cli.options import BusOptions

        buses = BusOptions(interface, channel or [])
        found: list[Any] = list(check_deployment(deploy, buses, yes))
    else:
        found = list(checks())
        _print(found)
    if json is not None:
        write_json(json, "doctor", {"checks": [asdict(c) for c in found]})
    states = {c.state for c in found}
    if "missing" in states:
        raise typer.Exit(1)
    if deploy is not None and "limited" in states:
        raise typer.Exit(3)


def _print(found: list[MachineCheck]) -> None:
    width = max(len(c.name) for c in found)
    for c in found:
        typer.echo(f"{_MARKS[c.state]} {c.name:<{width}}  {c.found}")
        if c.state != "good":
            typer.echo(f"  {'':<{width}}  for {c.purpose}; cure: {c.cure}")


def checks() -> Iterator[MachineCheck]:
    """Everything, in the order in which a user meets it."""
    for look in (
        _python,
        _system,
        _engine,
        _compiler,
        _extras,
        _disk,
        _loopback,
        _multicast,
        _zenoh_port,
        _can,
        _realtime,
        _wakeups,
        _governor,
        _date,
    ):
        yield look()


def _python() -> MachineCheck:
    good = sys.version_info >= (3, 11)
    text = (
        f"Python {platform.python_version()}, cosim {_version('cosim-bridge') or 'not installed'}"
    )
    return MachineCheck(
        "Python",
        "good" if good else "missing",
        text,
        "everything",
        "" if good else "install Python 3.11 or newer",
    )


def _system() -> MachineCheck:
    name = {"Darwin": "macOS"}.get(platform.system(), platform.system())
    machine = platform.machine()
    if name != "Linux":
        able = "offline runs only, and not tried there"
    elif machine == "x86_64":
        able = "offline runs, rehearsals and hardware"
    else:
        able = "offline runs; rehearsals and hardware have not been tried there"
    return MachineCheck(
        "system",
        "good" if name == "Linux" else "limited",
        f"{name} {machine}: {able}",
        "rehearsals and hardware",
        "" if name == "Linux" else "use Linux, also in a virtual machine",
    )


def _engine() -> MachineCheck:
    purpose = "every run"
    try:
        from cosim.engine.engine import Engine
        from cosim.scenario.assemble import assemble
        from cosim.scenario.spec import build

        arm = {"model": "fmus.models.planar2r"}
        document = {"run": {"step": 1e-3, "stop": 1e-3}, "components": {"arm": arm}}
        with Engine(assemble(build(document, Path("doctor.toml")))) as engine:
            engine.initialize()
            engine.run(1)
    except (CosimError, OSError) as error:
        return MachineCheck(
            "engine",
            "missing",
            str(error),
            purpose,
            "reinstall: pip install --force-reinstall cosim-bridge",
        )
    return MachineCheck("engine", "good", "one tick of an FMU was computed", purpose)


def _compiler() -> MachineCheck:
    from importlib.util import find_spec

    names = [os.environ.get("CC", ""), "cc", "gcc", "clang"]
    found = next((n for n in names if n and shutil.which(n)), "")
    if not found and find_spec("ziglang"):
        found = "the package ziglang"
    return MachineCheck(
        "C compiler",
        "good" if found else "limited",
        found or "none",
        "building FMUs (fmus build, build = true)",
        "pip install 'cosim-bridge[build]'",
    )


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def _extras() -> MachineCheck:
    absent = {extra: use for package, (extra, use) in EXTRAS.items() if not _version(package)}
    if not absent:
        return MachineCheck("extras", "good", "all optional packages are installed", "extras")
    uses = ", ".join(absent.values())
    return MachineCheck(
        "extras",
        "limited",
        f"not installed: {', '.join(absent)}",
        uses,
        f"pip install 'cosim-bridge[{','.join(absent)}]'",
    )


def _disk() -> MachineCheck:
    here = Path.cwd()
    if not os.access(here, os.W_OK):
        return MachineCheck(
            "disk",
            "missing",
            f"{here} cannot be written",
            "run folders",
            "change to a folder that you may write, or use --out",
        )
    free = shutil.disk_usage(here).free
    text = f"{free / 2**30:.1f} GiB free in {here}"
    state: State = "good" if free >= SPACE else "limited"
    return MachineCheck("disk", state, text, "long runs", "free some space, or use --out")


def _tried(name: str, what: str, purpose: str, cure: str, look: Callable[[], None]) -> MachineCheck:
    try:
        look()
    except (OSError, CosimError) as error:
        return MachineCheck(name, "limited", str(error), purpose, cure)
    return MachineCheck(name, "good", what, purpose)


def _loopback() -> MachineCheck:
    from bridge.preflight.host import loopback

    return _tried(
        "loopback",
        "127.0.0.1 answers",
        "Zenoh and lock-step on this machine",
        "ip link set lo up",
        loopback,
    )


def _multicast() -> MachineCheck:
    from bridge.can.multicast import probe as multicast

    return _tried(
        "multicast",
        "CAN over UDP multicast works on this machine",
        "rehearsals without CAN hardware (-i udp_multicast)",
        "ip link set lo up; ip route add 239.0.0.0/8 dev lo",
        multicast,
    )


def _zenoh_port() -> MachineCheck:
    def look() -> None:
        with socket.socket() as s:
            s.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            s.bind(("127.0.0.1", ZENOH))

    return _tried(
        "Zenoh port",
        f"{ZENOH} is free",
        "a Zenoh router on this machine",
        f"stop what uses port {ZENOH}, or name another in the deployment",
        look,
    )


def _can() -> MachineCheck:
    from bridge.vcan.capabilities import host, uml

    own = host()
    if own.possible:
        return MachineCheck("SocketCAN", "good", own.why, "rehearsals on vcan, and hardware")
    guest = uml()
    if guest.possible:
        return MachineCheck(
            "SocketCAN",
            "limited",
            f"not in this kernel ({own.why}); a guest kernel works here",
            "rehearsals on vcan, and hardware",
            "python -m bridge.vcan run -- COMMAND",
        )
    return MachineCheck(
        "SocketCAN",
        "limited",
        f"{own.why}; {guest.why}",
        "rehearsals on vcan, and hardware",
        "modprobe vcan, as root",
    )


def _realtime() -> MachineCheck:
    from bridge.realtime.os_grants import Realtime
    from bridge.realtime.requests import enter

    with enter(Realtime()) as granted:
        refused = granted.refused
        if not refused:
            return MachineCheck("real time", "good", granted.kernel, "nodes that keep their time")
        text = "; ".join(f"{i.name}: {i.said}" for i in refused)
    return MachineCheck(
        "real time",
        "limited",
        text,
        "nodes that keep their time",
        "see docs/rehearsal.md, Permissions",
    )


def _wakeups() -> MachineCheck:
    from bridge.realtime.requests import warm_up

    late = warm_up(1_000_000, 0.5).late
    text = f"500 at 1 kHz: median {late.p50 / 1e3:.0f} us late, most {late.maximum / 1e3:.0f} us"
    good = late.maximum < 200_000  # 20 % of the period
    return MachineCheck(
        "wake-ups",
        "good" if good else "limited",
        text,
        "nodes at 1 kHz",
        "stop other work, or run at a lower rate",
    )


def _governor() -> MachineCheck:
    path = Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
    found = path.read_text().strip() if path.is_file() else ""
    good = found in ("", "performance")
    return MachineCheck(
        "CPU governor",
        "good" if good else "limited",
        found or "none to set",
        "short and even step times",
        "cpupower frequency-set -g performance",
    )


def _date() -> MachineCheck:
    from bridge.realtime.host_clock import host_clock

    clock = host_clock()
    return MachineCheck(
        "date",
        "good" if clock.kept else "limited",
        clock.describe(),
        "nodes on several hosts",
        "start chrony, ptp4l or systemd-timesyncd",
    )
