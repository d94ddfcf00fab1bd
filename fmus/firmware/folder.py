"""A folder with a model as firmware: sources, the check on a board, a Makefile, and a page."""

from __future__ import annotations

import tempfile
from pathlib import Path

from cosim.base.errors import FmuError, ScenarioError
from fmus.build.toolchain import ToolchainError
from fmus.firmware import measure
from fmus.firmware.page import Row, page
from fmus.firmware.sources import FOLDER, files
from fmus.firmware.targets import HOSTED, OPTIONS, TARGETS, Target, compilers
from fmus.model import Model

#: Steps of the check.
STEPS = 1000


def target_of(name: str) -> Target:
    """The target called `name`. Raises ScenarioError for another name."""
    if name not in TARGETS:
        raise ScenarioError(f"{name!r} is not one of {', '.join(TARGETS)}", "--firmware")
    return TARGETS[name]


def write(model: Model, target: Target, folder: Path, *, measured: bool = True) -> list[Row]:
    """Write the folder and return what was measured, a row for each compiler that is here.

    Raises FmuError for a model that cannot be firmware, or whose folder cannot be written,
    ToolchainError if a compiler fails or the check has another digest than the FMU.
    """
    texts = files(model)
    ranges = ", ".join(f"{{{first}, {size}}}" for first, size in measure.inputs(model))
    check = _shipped("check.c").replace("MODEL", model.identifier)
    texts["check.c"] = check.replace("INPUT_RANGES", f"{{{ranges or '{0, 0}'}}}")
    texts |= {name: _shipped(name) for name in target.board}
    digest = measure.expected(model, STEPS)
    texts["Makefile"] = makefile(model, target, digest)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8", newline="\n")
        rows = _measured(model, target, folder, digest) if measured else []
        (folder / "README.md").write_text(page(model, target, rows, digest), encoding="utf-8")
    except OSError as error:
        raise FmuError(f"{folder}: cannot write the firmware: {error.strerror}") from error
    return rows


def _shipped(name: str) -> str:
    return (FOLDER / name).read_text(encoding="utf-8")


def _measured(model: Model, target: Target, folder: Path, digest: str) -> list[Row]:
    rows: list[Row] = []
    if measure.obstacle(target):
        return rows
    for compiler in compilers(target):
        with tempfile.TemporaryDirectory(prefix="firmware-") as scratch:
            program = Path(scratch, "check.elf")
            sizes = measure.build(model, target, compiler, (folder, program), STEPS)
            ran = measure.run(program, target)
        if ran is not None and ran.digest != digest:
            raise ToolchainError(
                f"{model.identifier} built by {compiler.name} for {target.name}: {STEPS} steps have"
                f" the digest {ran.digest}, those of the FMU {digest}"
            )
        rows.append(Row(compiler.name, sizes, ran))
    return rows


def makefile(model: Model, target: Target, digest: str) -> str:
    """The rules that build and run the check, with the options of :mod:`fmus.firmware.targets`."""
    name, sources = model.identifier, ["check.c", *(n for n in target.board if n.endswith(".c"))]
    options = OPTIONS if target.script else HOSTED
    link = f"-T {target.script} -Wl,--gc-sections" if target.script else ""
    choice = _choice(target) if target.gcc else ""
    return f"""\
# make: the check of {name} for {target.name}; make run: in {target.emulator[:1] or "this system"}
STEPS = {STEPS}
{choice}CFLAGS = {" ".join(options)}

check.elf: {name}.c {" ".join(sources)} {name}.h board.h {target.script}
\t$(CC) $(CPU) $(CFLAGS) -DSTEPS=$(STEPS) {name}.c {" ".join(sources)} {link} $(LIBS) -o $@

run: check.elf
\t{" ".join(target.emulator)} ./check.elf | tee check.txt
\t[ $(STEPS) != {STEPS} ] || grep -q 'digest {digest}' check.txt # of the FMU

clean:
\trm -f check.elf check.txt

.PHONY: run clean
"""


def _choice(target: Target) -> str:
    """The compiler: that of Debian if it is there, else zig, from the package ziglang."""
    gcc = target.gcc[0]
    return f"""\
ifeq ($(origin CC),default)
CC := $(if $(shell command -v {gcc}),{gcc},python3 -m ziglang cc)
endif
ifneq ($(findstring zig,$(CC)),)
CPU = {" ".join(target.zig)} -fno-sanitize=undefined
else
CPU = {" ".join(target.gcc[1:])}
LIBS = -nostdlib -lgcc
endif
"""
