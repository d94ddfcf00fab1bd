"""Firmware of nodes: images that do, slot by slot, what the twin does, to the bit."""

from __future__ import annotations

import ctypes
import json
import math
import re
import shutil
import struct
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.deployment.system import System, load_system
from bridge.export import firmware as made_by
from bridge.export.firmware import Firmware, export_firmware, firmware
from bridge.wiring.wiring import row_dtype
from cosim.base.errors import CosimError
from cosim.cli.export import (
    FirmwareOptions,
    NodeFmuOptions,
    RunFileOptions,
    SystemOptions,
    export,
)
from fmus.build.toolchain import FLAGS, compiler
from tests.bridge import rehearsing
from tests.bridge.deployments import TELEOPERATION, named
from tests.bridge.export.records import (
    SLOTS,
    Pipes,
    Serial,
    differences,
    image,
    record,
    recorded,
)
from tests.bridge.export.rehearsal_with_image import SLOW

ROOT = Path(__file__).parents[3]
C = ROOT / "bridge/c"
QEMU = {
    "cortex-m4": ("qemu-system-arm", "-M", "mps2-an386"),
    "cortex-m7": ("qemu-system-arm", "-M", "mps2-an500"),
    "riscv32": ("qemu-system-riscv32", "-M", "virt", "-bios", "none"),
}
GCC = {
    "cortex-m4": "arm-none-eabi-gcc",
    "cortex-m7": "arm-none-eabi-gcc",
    "riscv32": "riscv64-unknown-elf-gcc",
    "native": "cc",
}
FREE = ["-ffreestanding", "-fno-builtin", "-DNODE_FIRMWARE", "-Wall", "-Wextra", "-Werror"]
PLAIN = (RunFileOptions(), SystemOptions())


def needs(target: str, *, zig: bool = False) -> None:
    """Skips where a program is missing."""
    programs = ["make", *(() if zig else (GCC[target],)), *QEMU.get(target, ())[:1]]
    if missing := [name for name in programs if shutil.which(name) is None]:
        pytest.skip(f"no {', '.join(missing)} here")


def built(made: Firmware, folder: Path, target: str, *more: str) -> Path:
    """The image of a node."""
    for name, text in made.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    words = ["make", "-j2", "-C", str(folder), f"TARGET={target}", f"PYTHON={sys.executable}"]
    done = subprocess.run([*words, *more], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr
    return folder / "image.elf"


def line_to(path: Path, target: str) -> Pipes | Serial:
    """The serial line of an image that was started."""
    if target == "native":
        return Pipes(path)
    return Serial([*QEMU[target], "-kernel", str(path)], path.parent)


def check(system: System, node: str, target: str, folder: Path, *more: str) -> None:
    """An image has the rows of both journals and the frames of the twin."""
    found = recorded(system, node, folder / "twin")
    path = built(firmware(system, node, target), folder / "image", target, *more)
    with image(line_to(path, target)) as host:
        assert differences(host, found) == []
        assert host.skipped == 0
        host.say(record("q"))
        assert host.until("l")["l"][0].startswith(b"bytes skipped: ")
    assert len(found.rows) > 9 and np.ptp(found.rows["signals"], axis=0).max() > 0.0


# ---- bits -------------------------------------------------------------------------------------


#: Samples wait in a queue: their delays fall.
QUEUES = [
    f"links.{i}.{key}"
    for i in (0, 1)
    for key in (
        'semantics="queue"',
        "depth=5",
        'delay={law="segments", delay="20 ms", segments=[{from=0, to="0.1 s", delay="0.15 s"}]}',
    )
]


@pytest.mark.parametrize(
    ("deploy", "node", "settings"),
    [
        ("can", "master_control", ()),
        ("can", "master_control", QUEUES),
        ("can-damiao", "slave_control", ()),
        ("can-damiao", "master", ()),
    ],
    ids=["controller", "queue", "commands drives", "arm behind drives"],
)
def test_a_native_image_is_the_node_of_the_twin(
    deploy: str, node: str, settings: Sequence[str], tmp_path: Path
) -> None:
    needs("native")
    check(named(deploy, "run.stop=0.3", *settings), node, "native", tmp_path)


def test_an_image_for_cortex_m4_is_the_node_of_the_twin(tmp_path: Path) -> None:
    needs("cortex-m4")
    check(named("can", "run.stop=0.1"), "master_control", "cortex-m4", tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("target", QEMU)
@pytest.mark.parametrize("zig", [False, True])
def test_images_in_qemu_are_the_nodes_of_the_twin(target: str, zig: bool, tmp_path: Path) -> None:
    """Doubles in software and in hardware, by two compilers; longer."""
    needs(target, zig=zig)
    other = [f"GCC_{target}=none"] if zig else []
    check(named("can", "run.stop=2"), "master_control", target, tmp_path, *other)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "deploy", "node"),
    [
        ("network", "network-can", "robot6"),
        ("six_axis", "six_axis", "slave_control"),
        ("teleoperation", "can-cia402", "master"),
        ("teleoperation", "can-cia402", "slave_control"),
        ("teleoperation", "can-classic", "slave_control"),
    ],
)
def test_other_deployments(scenario: str, deploy: str, node: str, tmp_path: Path) -> None:
    """Two components, weights over time; seven joints; CiA 402; classic CAN."""
    needs("native")
    path = ROOT / "configs" / f"{scenario}.toml"
    check(load_system(path, deploy, ["run.stop=0.3"]), node, "native", tmp_path)


# ---- records ----------------------------------------------------------------------------------


def test_an_image_says_who_it_is_and_skips_what_is_no_record(tmp_path: Path) -> None:
    needs("native")
    system = named("can", "run.stop=0.1")
    made = firmware(system, "slave_control", "native")
    with image(Pipes(built(made, tmp_path / "image", "native"))) as host:
        whole = record("m", bytes([SLOTS]))
        host.say(b"noise\xc5\xc5\x6d\x01", whole[:-1] + bytes([whole[-1] ^ 1]), whole)
        hello = host.until("h")["h"][0]
        plan = system.nodes["slave_control"]
        assert hello == (
            struct.pack("<HHIqqq", 1, 4, row_dtype(plan).itemsize, 5_000_000, 500_000, plan.slots)
            + made.token
            + b"slave_control"
        )
        host.say(record("s", struct.pack("<qq", 7, 0)))
        wrong = host.until("d")
        assert wrong["d"] == [struct.pack("<qii", 7, -1, 0)]
        assert wrong["l"] == [b"found another slot, expected 0"]
        host.say(record("q"))
        assert host.until("l")["l"] == [b"bytes skipped: %d" % (9 + len(whole))]


def test_the_token_is_that_of_the_tables() -> None:
    short, same, long = (
        firmware(named("can", f"run.stop={stop}"), "master", target).token
        for stop, target in ((0.1, "native"), (0.1, "riscv32"), (0.2, "native"))
    )
    assert short == same != long and len(short) == 16


# ---- a life on the wall clock -----------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("target", ["native", "riscv32"])
@pytest.mark.parametrize("estop", [0.0, 0.5])
def test_an_image_is_a_node_of_a_rehearsal(target: str, estop: float, tmp_path: Path) -> None:
    """It is started by EPOCH and NMT, is ACTIVE, and FINISHED at the end; or stopped by ESTOP."""
    needs(target)
    rehearsing.possible()
    system = load_system(rehearsing.SCENARIO, "can", [*SLOW, "run.stop=2"])
    path = built(firmware(system, "master_control", target), tmp_path / "image", target)
    command = [str(path)] if target == "native" else [*QEMU[target], "-kernel", str(path)]
    module = [sys.executable, "-m", "tests.bridge.export.rehearsal_with_image"]
    done = subprocess.run(
        [*rehearsing.NAMESPACE, *module, str(tmp_path), "2", str(estop), *command],
        capture_output=True, text=True, cwd=ROOT, env=rehearsing.environment(), timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    said: dict[str, Any] = json.loads(done.stdout)
    states = [state for state, _, _ in said["beats"]]
    if target != "native" and set(states) == {1}:
        pytest.skip("on a busy machine, the emulator hears START after t = 0, and refuses it")
    assert states[0] == 1 and 2 in states
    if estop:
        assert states[-1] == 4 and said["beats"][-1][2] & 2
        assert said["sent"]["1"] >= 10 and said["lines"][-1] == "ended with -3"
        return
    if (tmp_path / "said.txt").read_text().find("inconclusive: ") >= 0:
        pytest.skip("the machine was too slow for a rehearsal")
    assert states[-1] == 5 and said["lines"] == ["ended with 0"]
    left = rehearsing.Left(tmp_path / "run")
    assert left.exact() and left.state("master") == 5


# ---- what it needs ----------------------------------------------------------------------------


def test_the_core_needs_no_library(tmp_path: Path) -> None:
    """Compiled without a system, it calls its HAL, and what compilers call by themselves."""
    if shutil.which("nm") is None:
        pytest.skip("no nm here")
    made = firmware(named("can-damiao", "run.stop=0.1"), "slave_control", "native")
    folder = tmp_path / "node"
    for name, text in made.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    parts = ("core", "node", "controllers")
    units = [str(p) for part in parts for p in sorted((folder / part).glob("*.c"))]
    include = [f"-I{folder / part}" for part in parts]
    command = [*compiler(), *FLAGS, *FREE, *include, "-isystem", str(folder / "freestanding")]
    subprocess.run(
        [*command, "-nostdlib", "-r", "-o", str(tmp_path / "core.o"), *units], check=True
    )
    found = subprocess.run(["nm", "-u", tmp_path / "core.o"], capture_output=True, text=True)
    missing = set(re.findall(r"U (\w+)", found.stdout))
    functions = re.findall(r"\b(hal_\w+)\(", (C / "hal.h").read_text(encoding="utf-8"))
    assert missing - {"_GLOBAL_OFFSET_TABLE_"} <= {
        *functions,
        *["memcpy", "memset", "memmove", "memcmp", "sqrt"],
    }
    assert {*functions} - {"hal_idle", "hal_log"} <= missing


def test_the_square_root_is_that_of_ieee_754(tmp_path: Path) -> None:
    folder = C / "firmware/freestanding"
    command = [*compiler(), *FLAGS, "-ffreestanding", "-fno-builtin", "-isystem", str(folder)]
    library = tmp_path / "freestanding.so"
    command += ["-shared", "-fPIC", "-fvisibility=default", "-Wl,-Bsymbolic", "-o", str(library)]
    subprocess.run([*command, str(folder / "freestanding.c")], check=True)
    root = ctypes.CDLL(str(library)).sqrt
    root.restype, root.argtypes = ctypes.c_double, [ctypes.c_double]
    bits = np.random.default_rng(4).integers(0, 0x7FF << 52, 20_000, dtype=np.uint64)
    edges = [0.0, -0.0, 1.0, 2.0, 4.0, 5e-324, 2.2250738585072014e-308, 1.7976931348623157e308]
    for x in (*edges, math.inf, *bits.view(np.float64).tolist()):
        assert struct.pack("<d", root(x)) == struct.pack("<d", math.sqrt(x)), x
    assert math.isnan(root(-1.0)) and math.isnan(root(math.nan))


# ---- refusals ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scenario", "deploy", "node", "said"),
    [
        (TELEOPERATION, "zenoh", "master", "of the kind zenoh, expected a CAN bus"),
        (TELEOPERATION, "can", "me", "found no node 'me', expected one of master"),
        (
            TELEOPERATION,
            "gateway",
            "left_gateway",
            "a gateway, expected a node that forwards nothing",
        ),
    ],
)
def test_a_node_that_cannot_be_firmware_is_refused(
    scenario: Path, deploy: str, node: str, said: str, tmp_path: Path
) -> None:
    system = load_system(scenario, deploy, ["run.stop=0.1"])
    with pytest.raises(CosimError, match=said):
        export_firmware(system, node, tmp_path / "x", "native", real=False)
    assert not (tmp_path / "x").exists()


def test_a_message_with_too_many_values_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(made_by, "FIELDS", 3)
    with pytest.raises(CosimError, match="found message STATE_1 with 4 values, expected at most 3"):
        firmware(named("can", "run.stop=0.1"), "master", "native")


def test_the_room_for_values_is_that_of_the_header() -> None:
    text = (C / "target.h").read_text(encoding="utf-8")
    assert f"MESSAGE_FIELDS = {made_by.FIELDS}" in text


@pytest.mark.parametrize(
    ("network", "options", "said"),
    [
        ({}, {"firmware": Path("x")}, "expected --deploy NAME --node NODE --firmware FOLDER"),
        ({"deploy": "can"}, {"firmware": Path("x")}, "expected --deploy NAME --node NODE"),
        ({"deploy": "can", "node": ["master"]}, {"target": "native"}, "found --firmware, --target"),
        ({"deploy": "can", "node": ["master", "slave"]}, {"firmware": Path("x")}, "and no --nodes"),
        (
            {"deploy": "can", "node": ["master"]},
            {"firmware": Path("x"), "target": "avr"},
            "found 'avr', expected cortex-m4, cortex-m7, riscv32, native",
        ),
    ],
)
def test_the_command_says_what_it_expected(
    network: dict[str, Any], options: dict[str, Any], said: str
) -> None:
    with pytest.raises(CosimError, match=said):
        export(TELEOPERATION, *PLAIN, NodeFmuOptions(**network), FirmwareOptions(**options))


def test_the_command_writes_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    network = NodeFmuOptions(deploy="can", node=["slave_control"])
    options = FirmwareOptions(firmware=tmp_path / "x", target="riscv32", real=True)
    export(TELEOPERATION, *PLAIN, network, options, ["run.stop=0.1"])
    assert "node slave_control for riscv32, on CAN left, right" in capsys.readouterr().out
    text = (tmp_path / "x/README.md").read_text()
    assert "# Node slave_control as firmware" in text and "{" not in text.replace("{\n", "")
    assert "refuses samples that are marked as simulated" in text
    assert ".simulated" not in (tmp_path / "x/node/node_data.c").read_text().split(".h_ns")[0]
    assert "TARGET = riscv32" in (tmp_path / "x/Makefile").read_text()
