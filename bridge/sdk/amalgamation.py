"""The C core of a participant: ``participant.h``, ``participant.c`` and ``protocol.c``.

Layouts, checksums, sequence numbers and life cycle are those of the nodes themselves:
``protocol.c`` consists of files of ``bridge/c``, and ``participant.h`` includes their headers.
"""

from __future__ import annotations

import re
from pathlib import Path

SDK = Path(__file__).parent / "c"
_NODE = Path(__file__).parent.parent / "c"
#: Files of ``bridge/c`` that ``protocol.c`` consists of, each after those it calls.
_UNITS = ("crc", "e2e", "message", "receiver", "life_cycle", "watchdog", "limit")
_INCLUDE = re.compile(r'^#include "(\w+\.h)"\n', re.MULTILINE)


def core() -> dict[str, str]:
    """The contents of the files, by name."""
    seen: set[str] = set()
    header = _inlined("participant.h", seen)
    parts = "".join(_inlined(f"{unit}.c", seen) for unit in _UNITS)
    return {
        "participant.h": header,
        "participant.c": (SDK / "participant.c").read_text(encoding="utf-8"),
        "protocol.c": f'#include "participant.h"\n\n{parts}',
    }


def _inlined(name: str, seen: set[str]) -> str:
    """A file, with each of its headers that is not in `seen` in place of its line."""
    seen.add(name)
    path = SDK / name if (SDK / name).is_file() else _NODE / name

    def put(found: re.Match[str]) -> str:
        return "" if found[1] in seen else _inlined(found[1], seen)

    return _INCLUDE.sub(put, path.read_text(encoding="utf-8"))
