"""``python -m tests.fuzz [TARGET ...] --seconds N | --minutes N | --count N [--seed S]``.

Tries mutants of every target's inputs, the time divided among the targets, and exits with 1 where
one was found that is not refused as it has to be. The input is kept in ``runs/fuzz/``.
"""

from __future__ import annotations

import argparse
import hashlib
import resource
import sys
from pathlib import Path

from tests.fuzz import drive, sanitized

KEPT = Path("runs") / "fuzz"
#: Bytes of memory a reader may have: an input that makes it ask for more is a finding.
MEMORY = 4 << 30


def main() -> int:
    """Parse, fuzz, report."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("target", nargs="*", help=f"{', '.join(drive.names())}; default: all")
    parser.add_argument("--seconds", type=float, default=0.0, help="for each target")
    parser.add_argument("--minutes", type=float, default=0.0, help="for all targets together")
    parser.add_argument("--count", type=int, default=0, help="mutants of each target")
    parser.add_argument("--seed", type=int, default=0)
    said = parser.parse_args()
    chosen = said.target or list(drive.names())
    for name in chosen:
        if name not in drive.names():
            parser.error(f"no target {name!r}; expected one of {', '.join(drive.names())}")
    seconds = said.seconds or said.minutes * 60 / len(chosen) or (0.0 if said.count else 10.0)
    found = 0
    for name in chosen:
        why = sanitized.missing() if name in sanitized.TARGETS else ""
        if why:
            print(f"{name:<11} left out: {why}")
            continue
        shadow = name in sanitized.TARGETS  # AddressSanitizer reserves terabytes
        limit = resource.RLIM_INFINITY if shadow else MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))
        result = drive.fuzz(name, said.seed, said.count, seconds)
        print(
            f"{name:<11} {result.tried} mutants{result.rate}, {len(result.findings)} findings",
            flush=True,
        )
        for finding in result.findings:
            found += 1
            print(f"\n{_kept(finding)}\n{finding.what}")
    return 1 if found else 0


def _kept(finding: drive.Finding) -> str:
    """Write the input down; where it is."""
    if not finding.data:
        return finding.target
    KEPT.mkdir(parents=True, exist_ok=True)
    digest = hashlib.sha256(finding.data).hexdigest()[:12]
    path = KEPT / f"{finding.target}-{digest}{finding.suffix}"
    path.write_bytes(finding.data)
    return str(path)


if __name__ == "__main__":
    sys.exit(main())
