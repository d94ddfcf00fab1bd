"""``python -m tests.bits [--write]``: kernels and engine by all compilers, on other processors and
as WebAssembly.

Prints a line for each compiler and exits with 1 where a digest is another one than in
``golden.json``, where the control (contraction on) gives the same, or where a compiler or emulator
is missing. `--write` writes the digests of ``gcc -O2``.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

from tests.bits.programs import CONTRACTED, EMULATED, GOLDEN, NATIVE, PAGES, digests, golden


def main() -> int:
    """Compile, run, compare."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--write", action="store_true", help="write golden.json")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        if options.write:
            found = digests(NATIVE[1], Path(scratch) / "write")
            GOLDEN.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        expected, wrong = golden(), 0
        for n, toolchain in enumerate((*NATIVE, *EMULATED, *PAGES, CONTRACTED)):
            if missing := toolchain.missing():
                print(f"{toolchain.name}: {missing} is not installed")
                wrong += 1
                continue
            found = digests(toolchain, Path(scratch) / str(n))
            differ = [name for name, digest in expected.items() if found[name] != digest]
            if toolchain is CONTRACTED:
                print(f"{toolchain.name}: {len(differ)} of {len(found)} differ, as they must")
                wrong += not differ
            else:
                print(f"{toolchain.name}: {len(found) - len(differ)} of {len(found)} equal"
                      + "".join(f"; {name} differs" for name in differ))  # fmt: skip
                wrong += len(differ)
    return int(wrong > 0)


if __name__ == "__main__":
    raise SystemExit(main())
