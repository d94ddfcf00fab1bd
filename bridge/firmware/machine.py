"""The machine that an image is for, by its ELF header and the build attributes of ARM.

Source of the numbers: System V ABI, chapter 4 (ELF header, sections); ARM IHI 0045, 2.3 and 3.3
(``.ARM.attributes``: tags 10 and 6).
"""

from __future__ import annotations

import os
import platform
import shutil
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cosim.base.errors import ScenarioError

_ARM, _RISCV = 40, 243
_X86_64, _AARCH64 = 62, 183
_HOSTS = {_X86_64: ("x86_64", "AMD64"), _AARCH64: ("aarch64", "arm64")}
_ATTRIBUTES = 0x70000003  # SHT_ARM_ATTRIBUTES
_FP_ARCH, _TEXT_TAGS = 10, (4, 5, 67)
#: Values of Tag_FP_arch that have double precision on Cortex-M: FPv5 and later.
_DOUBLE = 7


@dataclass(frozen=True, slots=True)
class Machine:
    """The emulator that runs an image, with the options of its board; native: "", ().

    `package`: the Debian package of the emulator; `name`: for reports.
    """

    name: str
    emulator: str = ""
    options: tuple[str, ...] = ()
    package: str = ""

    def command(self, image: Path) -> list[str]:
        """The command without the options of its serial line. Raises ScenarioError."""
        if not self.emulator:
            if not os.access(image, os.X_OK):
                text = "is a program without the permission to be executed; expected chmod +x"
                raise ScenarioError(text, str(image))
            return [str(image.absolute())]
        found = shutil.which(self.emulator)
        if found is None:
            raise ScenarioError(
                f"is for {self.name}, which {self.emulator} emulates, and that is not installed; "
                f"install it with: apt-get install {self.package}",
                str(image),
            )
        return [found, *self.options, "-kernel", str(image.absolute())]


NATIVE = Machine("this machine")
M4 = Machine("mps2-an386 (Cortex-M4)", "qemu-system-arm", ("-M", "mps2-an386"), "qemu-system-arm")
M7 = Machine("mps2-an500 (Cortex-M7)", "qemu-system-arm", ("-M", "mps2-an500"), "qemu-system-arm")
RISCV = Machine(
    "virt (RISC-V, 32 bits)", "qemu-system-riscv32", ("-M", "virt", "-bios", "none"),
    "qemu-system-misc",
)  # fmt: skip


def machine_of(image: Path) -> Machine:
    """The machine that an image is for. Raises ScenarioError for a file that is no image."""
    try:
        data = image.read_bytes()
    except OSError as error:
        raise ScenarioError(f"{error.strerror}; expected an image (ELF)", str(image)) from error
    if data[:2] == b"#!":
        return NATIVE
    try:
        return _machine(data)
    except (struct.error, IndexError, LookupError) as error:
        text = f"found {str(error) or 'a truncated ELF file'}; expected an image (ELF) for "
        raise ScenarioError(f"{text}Cortex-M, RISC-V 32 or this machine", str(image)) from error


def _machine(data: bytes) -> Machine:
    if data[:4] != b"\x7fELF":
        raise LookupError("no ELF file")
    wide, little = data[4] == 2, data[5] == 1
    (kind,) = struct.unpack_from("<H" if little else ">H", data, 18)
    if kind == _ARM and not wide and little:
        return M7 if _fp_arch(data) >= _DOUBLE else M4
    if kind == _RISCV and not wide and little:
        return RISCV
    if platform.machine() in _HOSTS.get(kind, ()) and sys.platform == "linux":
        return NATIVE
    raise LookupError(f"an ELF file for machine {kind} with {64 if wide else 32} bits")


def _fp_arch(data: bytes) -> int:
    """The value of Tag_FP_arch of a little-endian ELF file with 32 bits; 0: no instructions."""
    (start,) = struct.unpack_from("<I", data, 32)
    size, count = struct.unpack_from("<HH", data, 46)
    for i in range(count):
        _, kind, _, _, offset, length = struct.unpack_from("<6I", data, start + i * size)
        if kind == _ATTRIBUTES:
            return dict(_attributes(data[offset : offset + length])).get(_FP_ARCH, 0)
    return 0


def _attributes(section: bytes) -> Iterator[tuple[int, int]]:
    """Tags of the whole file with their numbers: format A, vendor aeabi, sub-section 1."""
    at = section.index(b"aeabi\0") + 6
    (size,) = struct.unpack_from("<I", section, at + 1)
    end, at = at + size, at + 5
    while at < end:
        tag, at = _number(section, at)
        if tag in _TEXT_TAGS:
            at = section.index(0, at) + 1
            continue
        value, at = _number(section, at)
        if tag == 32:  # Tag_compatibility: a number and a text
            at = section.index(0, at) + 1
        yield tag, value


def _number(data: bytes, at: int) -> tuple[int, int]:
    """An unsigned LEB128 number, and where it ends."""
    value = shift = 0
    while True:
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if not byte & 0x80:
            return value, at
