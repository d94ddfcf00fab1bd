"""The simulated CAN bus as an FMU: a Bus Simulation FMU of FMI-LS-BUS 1.0 for n nodes.

The FMU is the C code of ``cosim/c/bus`` behind that of ``fmus/c/lsbus``, with its sources. Each
node is a terminal ``Node1``, ``Node2``, ... whose Tx_Clock counts down to the next operation of the
bus.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cosim
from cosim.base.errors import FmuError
from cosim.bus.described import bit_ps
from cosim.bus.settings import BusNodeSettings
from cosim.bus.timing import BusTiming
from fmus.build.archive import write_archive
from fmus.build.lsbus_fmu import LsBusFmu, binaries, entries, shell_sources, token_of

IDENTIFIER = "can_bus"
_HERE = Path(__file__).parents[1] / "c"


def build_bus(
    nodes: int, timing: BusTiming, target: Path | str, platforms: Sequence[str] | None = None
) -> Path:
    """Build the FMU of a bus with so many `nodes` and return its path, `target`.

    `platforms`: of :data:`fmus.build.toolchain.PLATFORMS`; default the host's. Raises FmuError for
    a number of nodes that is not 1 to 64 and where the file cannot be written, and
    fmus.build.toolchain.ToolchainError from the compiler.
    """
    if not 1 <= nodes <= 64:
        raise FmuError(f"found {nodes} nodes, expected 1 to 64")
    sources = bus_sources(nodes, timing)
    token = token_of(sources)
    sources["bus_config.h"] += f'#define TOKEN "{token}"\n#endif\n'
    rates = f"{timing.bitrate:g} bit/s"
    if timing.fd:
        rates += f", FD {timing.data_bitrate or timing.bitrate:g} bit/s"
    fmu = LsBusFmu(
        name="CanBus",
        identifier=IDENTIFIER,
        description=f"CAN bus with {nodes} nodes, {rates}",
        token=token,
        terminals=tuple(f"Node{n + 1}" for n in range(nodes)),
        bus=True,
    )
    content = {name: text.encode() for name, text in entries(fmu, sources).items()}
    content |= binaries(IDENTIFIER, sources, platforms)
    write_archive(content, Path(target))
    return Path(target)


def bus_sources(nodes: int, timing: BusTiming) -> dict[str, str]:
    """The C files by name; ``bus_config.h`` still without token and end."""
    bus = Path(cosim.__file__).parent / "c" / "bus"
    files = [*bus.glob("*.[ch]"), *(_HERE / "lsbus" / "bus").glob("*.[ch]")]
    found = {file.name: file.read_text(encoding="utf-8") for file in files}
    return found | shell_sources() | {"bus_config.h": _config(nodes, timing)}


def _config(nodes: int, timing: BusTiming) -> str:
    data_rate = timing.data_bitrate or timing.bitrate
    default = BusNodeSettings("default")
    values = {
        "N_NODES": nodes,
        "BITRATE": f"{round(timing.bitrate)}u",
        "DATA_BITRATE": f"{round(data_rate)}u",
        "BIT_PS": bit_ps(timing.bitrate),
        "DATA_BIT_PS": bit_ps(data_rate),
        "WITH_FD": int(timing.fd),
        "SAMPLE_POINT": round(default.sample_point * 1000),
        "JUMP_WIDTH": round(default.sjw * 1000),
    }
    lines = "".join(f"#define {name} {value}\n" for name, value in values.items())
    return f"/* bus_config.h - this bus. */\n#ifndef BUS_CONFIG_H\n#define BUS_CONFIG_H\n{lines}"
