"""``python -m tests.fmus.firmware [--steps N] [NAME ...]``: firmware has the bits of the FMU.

Each model, built for each processor by each compiler, makes its steps in an emulator; the digest of
all variables at all steps has to be that of the library in its FMU. Arms, whose steps are long,
make a tenth of them. Prints a line for each model and a sum, and exits with 1 where a digest
is another one or where a compiler or an emulator is missing.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from fmus.build.archive import shipped_models
from fmus.firmware import measure
from fmus.firmware.folder import write
from fmus.firmware.targets import TARGETS, compilers
from fmus.model import Model


def missing() -> list[str]:
    """The programs that are not here."""
    needed = {name for t in TARGETS.values() for name in (*t.gcc[:1], *t.emulator[:1])}
    return sorted(name for name in needed if shutil.which(name) is None)


def differences(model: Model, steps: int, scratch: Path) -> Iterator[str]:
    """A sentence for each program whose digest is not that of the FMU."""
    steps = max(1, steps // 10) if model.identifier in ("planar2r", "arm") else steps
    expected = measure.expected(model, steps)
    for target in TARGETS.values():
        folder = scratch / target.name
        write(model, target, folder, measured=False)
        for compiler in compilers(target):
            measure.build(model, target, compiler, (folder, scratch / "check.elf"), steps)
            ran = measure.run(scratch / "check.elf", target)
            if ran is None or ran.digest != expected:
                yield f"{target.name}, {compiler.name}: {ran}, expected {expected}"


def _judge(model: Model, steps: int) -> tuple[str, list[str], float]:
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as scratch:
        found = list(differences(model, steps, Path(scratch)))
    return model.identifier, found, time.monotonic() - begin


def main() -> int:
    """Build, run, compare."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", help="models; all that are shipped by default")
    parser.add_argument("--steps", type=int, default=100_000)
    options = parser.parse_args()
    wrong = len(missing())
    for name in missing():
        print(f"{name} is not installed")
    known = {model.identifier: model for model in shipped_models()}
    for name in options.names:
        if name not in known:
            parser.error(f"no model {name!r}; expected one of {', '.join(known)}")
    models = [known[name] for name in options.names or known]
    models.sort(key=lambda model: len(model.variables))
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for name, found, took in pool.map(_judge, models, [options.steps] * len(models)):
            print(f"{name}: {'; '.join(found) or 'equal'} ({took:.0f} s)", flush=True)
            wrong += len(found)
    print(f"{len(models)} models, {wrong} differences or missing programs")
    return int(wrong > 0)


if __name__ == "__main__":
    raise SystemExit(main())
