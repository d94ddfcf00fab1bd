"""True if a shared library of Linux is whole: the loader maps one that is not, and crashes."""

from __future__ import annotations

import struct
from pathlib import Path

#: ELF-64, little-endian: file header up to e_phnum; program header type, offset, size in the file.
_HEADER, _SEGMENT = struct.Struct("<16x16xQQ4x2xHH"), struct.Struct("<I4xQ16xQ16x")
_MAGIC, _LOADED = b"\x7fELF\x02\x01", 1


def missing_bytes(path: Path) -> int:
    """Number of bytes that the segments of a library need beyond its end; 0 for other files."""
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(_HEADER.size)
        if not header.startswith(_MAGIC):
            return 0
        if len(header) < _HEADER.size:
            return _HEADER.size - len(header)
        table, _, entry, n = _HEADER.unpack(header)
        file.seek(table)
        data = file.read(entry * n)
    if len(data) < entry * n or entry < _SEGMENT.size:
        return entry * n - len(data) or 1
    segments = (_SEGMENT.unpack_from(data, i * entry) for i in range(n))
    ends: list[int] = [at + length for kind, at, length in segments if kind == _LOADED]
    return max(0, *ends, size) - size
