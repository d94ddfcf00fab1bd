"""Results as JSON: one way for all commands."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any


def write_json(path: Path, data: Mapping[str, Any] | Sequence[Any]) -> None:
    """Write a result as JSON; numbers that are not finite become null.

    Raises RunError with the path if it cannot be written.
    """
    from cosim.base.files import write_file

    text = json.dumps(_plain(data), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    write_file(path, text)


def _plain(data: Any) -> Any:
    if isinstance(data, Mapping):
        return {str(key): _plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(value) for value in data]
    if isinstance(data, float):
        return float(data) if isfinite(data) else None
    return data
