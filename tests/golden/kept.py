"""Results of a case, reduced to what has to stay the same: texts, digests and numbers.

A text is compared as it is (paths, times and versions replaced), a table by the digest of its
values, and a number that NumPy has summed with a tolerance, because the order of a sum depends on
the processor.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pyarrow.parquet as pq

ROOT = Path(__file__).resolve().parents[2]
#: What is kept of one name: a digest or a text, or numbers.
Kept: TypeAlias = "str | list[float | str]"
RELATIVE, ABSOLUTE = 1e-9, 1e-12  # of numbers that depend on the order of a sum

#: Keys of JSON files that differ from run to run or from machine to machine.
VOLATILE = {
    "command",
    "versions",
    "wall",
    "sha256",
    "started",
    "host",
    "kernel",
    "file_bytes",
    "machine",
}
#: Rates, durations and dates in what commands print.
MOVING = (
    (re.compile(r"(wall time\s+).*"), r"\1<time>"),
    (re.compile(r"; \d+\.\d+ s$", re.M), "; <time>"),
    (re.compile(r"(\d+ runs in )\d+\.\d+ s"), r"\1<time>"),
    (re.compile(r"\d{8}-\d{6}"), "<date>"),
)
#: A number with a fraction or an exponent, as a text has it.
NUMBER = re.compile(r"[-+]?\d+\.\d+(?:e[-+]?\d+)?|[-+]?\d+e[-+]?\d+")


@dataclass
class Record:
    """Results of one case by name; `texts` are whole, for a look at differences."""

    folder: Path
    kept: dict[str, Kept] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)

    def text(self, name: str, text: str, *, whole: bool = False) -> None:
        """Keep a text: its digest, or with `whole` the text itself."""
        said = settled(text, self.folder)
        self.texts[name] = said
        self.kept[name] = said if whole else digest(said.encode())

    def document(self, name: str, value: Any) -> None:
        """Keep a JSON document without what differs from run to run."""
        self.text(name, json.dumps(steady(value), indent=1, sort_keys=True, default=str))

    def array(self, name: str, values: np.ndarray) -> None:
        """Keep the bytes of an array, little-endian, with its type and shape."""
        array = np.ascontiguousarray(values)
        array = array.astype(array.dtype.newbyteorder("<"))
        self.kept[name] = digest(f"{array.dtype.descr}{array.shape}".encode() + array.tobytes())

    def numbers(self, name: str, values: Iterable[Any]) -> None:
        """Keep numbers to be compared with a tolerance; what is no finite number, as a text."""
        self.kept[name] = [float(v) if _finite(v) else str(v) for v in values]

    def measured(self, name: str, text: str) -> None:
        """Keep a text, and the numbers in it with a tolerance."""
        said = settled(text, self.folder)
        self.texts[name] = said
        self.kept[name] = digest(NUMBER.sub("<number>", said).encode())
        self.numbers(f"{name}, numbers", map(float, NUMBER.findall(said)))

    def tables(self, folder: Path, prefix: str = "") -> None:
        """Keep every Parquet file below a folder by its values, and every run.json."""
        for path in sorted(folder.rglob("*.parquet")):
            self.kept[f"{prefix}{path.relative_to(folder)}"] = table(path)
        for path in sorted(folder.rglob("run.json")):
            name = f"{prefix}{path.relative_to(folder)}"
            self.document(name, json.loads(path.read_text(encoding="utf-8")))


def _finite(value: Any) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def digest(data: bytes) -> str:
    """The first 128 bits of SHA-256."""
    return sha256(data).hexdigest()[:32]


def table(path: Path) -> str:
    """The digest of a Parquet file's columns: names, types, values; not how they are stored."""
    read = pq.read_table(path)
    found = sha256()
    for name in sorted(read.column_names):
        column = read.column(name).combine_chunks()
        found.update(f"{name} {column.type} {len(column)}".encode())
        values = column.to_numpy(zero_copy_only=False)
        text = values.dtype == object
        found.update(repr(values.tolist()).encode() if text else np.ascontiguousarray(values))
    return found.hexdigest()[:32]


def settled(text: str, folder: Path) -> str:
    """A text without paths of this machine, times and dates; lines without spaces at their ends."""
    for path, name in ((str(folder), "<folder>"), (str(ROOT), "<project>")):
        text = text.replace(path, name)
    for pattern, by in MOVING:
        text = pattern.sub(by, text)
    return "\n".join(line.rstrip() for line in text.splitlines())


def steady(value: Any) -> Any:
    """A JSON document without its volatile keys."""
    if isinstance(value, Mapping):
        return {k: steady(v) for k, v in value.items() if k not in VOLATILE}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [steady(v) for v in value]
    return value


def differences(was: Mapping[str, Kept], now: Mapping[str, Kept]) -> Iterator[str]:
    """A line for every name that is missing, new or different."""
    for name in sorted(was.keys() | now.keys()):
        if name not in now:
            yield f"{name}: is no longer there"
        elif name not in was:
            yield f"{name}: is new"
        elif not same(was[name], now[name]):
            yield f"{name}: {_changed(was[name], now[name])}"


def same(a: Kept, b: Kept) -> bool:
    """Equal, numbers within the tolerance."""
    if isinstance(a, str) or isinstance(b, str):
        return a == b
    return len(a) == len(b) and all(
        x == y
        or (_finite(x) and _finite(y) and math.isclose(x, y, rel_tol=RELATIVE, abs_tol=ABSOLUTE))
        for x, y in zip(a, b, strict=True)
    )


def _changed(was: Kept, now: Kept) -> str:
    if isinstance(was, str) or isinstance(now, str):
        return f"was {was!r}, is {now!r}"
    if len(was) != len(now):
        return f"{len(was)} numbers, now {len(now)}"
    first = next(i for i, (a, b) in enumerate(zip(was, now, strict=True)) if not same([a], [b]))
    return f"number {first} was {was[first]!r}, is {now[first]!r}"
