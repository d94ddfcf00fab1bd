"""``python -m tests.golden [--write] [--jobs N] [--texts FOLDER] [CASE ...]``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tests.golden.run import CASES, compared, written


def main() -> int:
    """Compare with the digests, or write them."""
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument("case", nargs="*", help="Only cases whose name contains one of these.")
    parser.add_argument("--write", action="store_true", help="Freeze what is there now.")
    parser.add_argument("--jobs", type=int, default=2, help="Processes.")
    parser.add_argument("--texts", type=Path, help="Also write the texts that digests are made of.")
    parser.add_argument("--list", action="store_true", help="List the cases; run nothing.")
    given = parser.parse_args()
    names = [n for n in CASES if not given.case or any(part in n for part in given.case)]
    if given.list or not names:
        print("\n".join(CASES))
        return 0 if given.list else 2
    if given.write:
        print(written(names, given.jobs, given.texts))
        return 0
    lines = compared(names, given.jobs, given.texts)
    print("\n".join([*lines, f"{len(names)} cases, {len(lines)} differences"]))
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
