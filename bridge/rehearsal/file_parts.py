"""Files in parts, as texts of lines of JSON."""

from __future__ import annotations

import base64
import zlib
from pathlib import Path


def packed(data: bytes) -> str:
    """Bytes as a text for a line."""
    return base64.b64encode(zlib.compress(data, 1)).decode()


def unpacked(text: str) -> bytes:
    """The bytes of which :func:`packed` made a text."""
    return zlib.decompress(base64.b64decode(text))


def write_part(path: Path, at: int, data: bytes, zeros: int = 0) -> None:
    """Write a part of a file, or so many bytes of `zeros`; the file is made where it is missing.

    Raises OSError.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("r+b" if path.exists() else "wb") as file:
        file.seek(at)
        file.write(data)
        if zeros:
            file.truncate(at + zeros)
