"""A deterministic mutator: bytes, texts and ZIP archives, changed by a seeded generator."""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from collections.abc import Sequence

import numpy as np

#: Numbers that programs often treat wrongly, as they stand in a text.
NUMBERS = (
    b"0", b"-0.0", b"-1", b"1e-320", b"5e-324", b"1e308", b"1e400", b"nan", b"inf", b"-inf",
    b"2147483648", b"4294967296", b"9223372036854775808", b"-9223372036854775809",
    b"99999999999999999999999999999999", b"0.1", b"true", b'"1 ms"', b'"1 furlong"', b"[]",
    b"[1, 2]", b"{}", b'""', b"1979-05-27", b"0x7fffffff",
)  # fmt: skip
BYTES = (0, 1, 0x7F, 0x80, 0xFE, 0xFF)
INTEGERS = (0, 1, 2**31 - 1, 2**32, 2**63 - 1, 2**64 - 1)
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_][A-Za-z0-9_.-]*")


def of_bytes(random: np.random.Generator, data: bytes, others: Sequence[bytes]) -> bytes:
    """One to four changes of single bits, bytes, stretches, or 8-byte integers."""
    found = bytearray(data)
    for _ in range(int(random.integers(1, 5))):
        n = len(found)
        at = int(random.integers(0, n + 1))
        long = int(random.integers(1, 17))
        match int(random.integers(0, 8)):
            case 0 if n:
                found[at % n] ^= 1 << int(random.integers(0, 8))
            case 1 if n:
                found[at % n] = BYTES[int(random.integers(0, len(BYTES)))]
            case 2:
                del found[at : at + long]
            case 3:
                found[at:at] = random.bytes(long)
            case 4:
                found[at:at] = found[at : at + long]
            case 5:
                del found[at:]
            case 6 if n >= 8:
                at %= n - 7
                value = INTEGERS[int(random.integers(0, len(INTEGERS)))]
                found[at : at + 8] = value.to_bytes(8, "little")
            case _:
                other = others[int(random.integers(0, len(others)))] if others else b""
                start = int(random.integers(0, len(other) + 1))
                found[at:] = other[start:]
    return bytes(found)


def of_text(random: np.random.Generator, data: bytes, others: Sequence[bytes]) -> bytes:
    """One to three changes of numbers, words and lines; now and then of bytes."""
    found = data
    for _ in range(int(random.integers(1, 4))):
        match int(random.integers(0, 7)):
            case 0 | 1:
                found = _replaced(random, found, _NUMBER, NUMBERS)
            case 2:
                words = _WORD.findall(found)
                found = _replaced(random, found, _WORD, (*words[:200], b"x", b""))
            case 3 | 4 | 5:
                found = _lines(random, found, others)
            case _:
                found = of_bytes(random, found, others)
    return found


def _replaced(
    random: np.random.Generator, data: bytes, what: re.Pattern[bytes], by: Sequence[bytes]
) -> bytes:
    places = list(what.finditer(data))
    if not places:
        return data
    place = places[int(random.integers(0, len(places)))]
    return data[: place.start()] + by[int(random.integers(0, len(by)))] + data[place.end() :]


def _lines(random: np.random.Generator, data: bytes, others: Sequence[bytes]) -> bytes:
    lines = data.split(b"\n")
    at = int(random.integers(0, len(lines)))
    match int(random.integers(0, 4)):
        case 0:
            del lines[at]
        case 1:
            lines.insert(at, lines[int(random.integers(0, len(lines)))])
        case 2 if others:
            other = others[int(random.integers(0, len(others)))].split(b"\n")
            lines.insert(at, other[int(random.integers(0, len(other)))])
        case _:
            to = int(random.integers(0, len(lines)))
            lines[at], lines[to] = lines[to], lines[at]
    return b"\n".join(lines)


def of_archive(random: np.random.Generator, data: bytes, others: Sequence[bytes]) -> bytes:
    """A member of a ZIP archive is changed and packed again, or the bytes of the archive are."""
    if random.random() < 0.3:
        return of_bytes(random, data, others)
    members = unpacked(data)
    if not members:
        return of_bytes(random, data, others)
    name = sorted(members)[int(random.integers(0, len(members)))]
    if random.random() < 0.1:
        del members[name]
    else:
        text = name.endswith((".xml", ".ssd", ".ssv", ".ssm", ".json", ".toml"))
        members[name] = (of_text if text else of_bytes)(random, members[name], ())
    return packed(members)


def unpacked(data: bytes) -> dict[str, bytes]:
    """The members of an archive by name; none where it cannot be read."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return {e.filename: archive.read(e) for e in archive.infolist() if not e.is_dir()}
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        NotImplementedError,
        RuntimeError,
        ValueError,
    ):
        return {}


def packed(members: dict[str, bytes]) -> bytes:
    """An archive of these members."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return out.getvalue()
