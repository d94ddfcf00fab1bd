"""The machine of an image, by its ELF header and the attributes of ARM."""

from __future__ import annotations

import platform
import struct
import sys
from pathlib import Path

import pytest

from bridge.firmware.machine import M4, M7, NATIVE, RISCV, machine_of
from cosim.base.errors import ScenarioError

#: Tags as gas writes them: CPU name, architecture v7E-M, profile M, FP architecture, compatibility.
TAGS = b"\x05" + b"7E-M\0" + b"\x06\x0d\x07\x4d" + b"\x20\x00gnu\0"


def elf(machine, tags=b"", wide=False):
    """An ELF file with the section .ARM.attributes, if there are tags."""
    head = bytearray(b"\x7fELF" + bytes([2 if wide else 1, 1]) + bytes(58))
    struct.pack_into("<H", head, 18, machine)
    if not tags:
        return bytes(head)
    part = b"\x01" + struct.pack("<I", len(tags) + 5) + tags
    vendor = b"aeabi\0" + part
    section = b"A" + struct.pack("<I", len(vendor) + 4) + vendor
    table = struct.pack("<10I", 0, 1, 0, 0, 0, 0, 0, 0, 0, 0)
    table += struct.pack("<10I", 0, 0x70000003, 0, 0, 64, len(section), 0, 0, 0, 0)
    struct.pack_into("<I", head, 32, 64 + len(section))
    struct.pack_into("<HH", head, 46, 40, 2)
    return bytes(head) + section + table


def written(tmp_path, data):
    path = tmp_path / "image.elf"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("data", "machine"),
    [
        (elf(40), M4),
        (elf(40, TAGS), M4),
        (elf(40, TAGS + b"\x0a\x06"), M4),  # VFPv4-D16: single precision on Cortex-M
        (elf(40, TAGS + b"\x0a\x08"), M7),  # FPv5
        (elf(243), RISCV),
        (b"#!/bin/sh\n", NATIVE),
    ],
)
def test_an_image_names_its_machine(data, machine, tmp_path):
    assert machine_of(written(tmp_path, data)) == machine


@pytest.mark.skipif(sys.platform != "linux", reason="ELF is Linux")
@pytest.mark.skipif(platform.machine() not in ("x86_64", "aarch64"), reason="another machine")
def test_a_program_of_this_machine_is_native():
    assert machine_of(Path(sys.executable)) == NATIVE


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"MZ", "found no ELF file; expected an image"),
        (b"\x7fELF\x01\x01", "a truncated ELF file|unpack_from requires"),
        (elf(8), "an ELF file for machine 8 with 32 bits; expected an image .* Cortex-M"),
        (elf(243, wide=True), "machine 243 with 64 bits"),
    ],
)
def test_another_file_is_refused(data, text, tmp_path):
    with pytest.raises(ScenarioError, match=text):
        machine_of(written(tmp_path, data))


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(ScenarioError, match="No such file or directory; expected an image"):
        machine_of(tmp_path / "none.elf")


@pytest.mark.parametrize(
    ("machine", "package"), [(M7, "qemu-system-arm"), (RISCV, "qemu-system-misc")]
)
def test_a_missing_emulator_is_said_with_its_package(machine, package, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ScenarioError, match=f"not installed; .*: apt-get install {package}"):
        machine.command(tmp_path / "image.elf")


def test_a_program_that_cannot_be_executed_is_said(tmp_path):
    with pytest.raises(ScenarioError, match=r"expected chmod \+x"):
        NATIVE.command(written(tmp_path, b"#!/bin/sh\n"))
