"""CSV files with two stamps of each sample, or with one stamp and a number.

The header names the columns; a suffix says the unit of a stamp (``_ns``, ``_us``, ``_ms``, else s).
Stamps are read as decimal numbers, exact to 1 ns.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path

from bridge.captures.samples import ReadingNotes, RecordedSample
from bridge.ping.exchanges import NONE
from cosim.base.errors import ScenarioError

#: Names of columns without their unit: sent, received, and the number of a sample.
SENT = ("sent", "t_sent", "t_send", "send", "tx", "stamp", "header_stamp", "publish_time")
RECEIVED = ("received", "t_received", "receive", "t_receive", "recv", "t_recv", "rx", "arrived")
LOGGED = ("log_time", "time", "timestamp", "t")
NUMBER = ("sequence", "seq", "number", "counter")
_UNITS = {"_ns": Decimal(1), "_us": Decimal(1000), "_ms": Decimal(10**6), "_s": Decimal(10**9)}
_SECOND = Decimal(10**9)
_LARGEST = Decimal(2**62)


def csv_samples(
    path: Path, notes: ReadingNotes, columns: Sequence[str] = ()
) -> Iterator[RecordedSample]:
    """The rows of a file; the stream has the file's name.

    `columns`: names of SENT, RECEIVED and perhaps NUMBER, instead of the usual ones. A row without
    a time of arrival was lost. Raises ScenarioError with the line.
    """
    with path.open(newline="", encoding="utf-8-sig") as file:
        first = file.readline()
        while first.startswith("#"):
            first = file.readline()
        mark = max(",;\t", key=first.count)
        names = [cell.strip().strip('"') for cell in first.rstrip("\r\n").split(mark)]
        found = _columns(names, columns, str(path))
        reader = csv.reader(file, delimiter=mark)
        try:
            for row in reader:
                if not row or row[0].startswith("#"):
                    continue
                if len(row) < len(names):
                    notes.counts["lines have too few values, and are left out"] += 1
                    continue
                yield _sample(path, row, names, found, reader.line_num)
        except (UnicodeDecodeError, csv.Error) as error:
            raise ScenarioError(f"this is not text ({error})", str(path)) from None


Columns = tuple[int | None, int | None, int | None]  # sent, received, number


def _columns(names: Sequence[str], wanted: Sequence[str], place: str) -> Columns:
    if wanted:
        missing = [name for name in wanted if name not in names]
        if missing or not 2 <= len(wanted) <= 3:
            raise ScenarioError(
                f"columns {', '.join(names)}; expected --columns SENT,RECEIVED[,NUMBER] of them, "
                f"found {','.join(wanted)!r}",
                place,
            )
        at = [names.index(name) for name in wanted]
        return at[0], at[1], at[2] if len(at) > 2 else None
    received = _first(names, RECEIVED)
    logged = _first(names, LOGGED)
    found = _first(names, SENT), logged if received is None else received, _first(names, NUMBER)
    if found[1] is None:
        raise ScenarioError(
            f"columns {', '.join(names) or 'none'}; expected two stamps ('sent', 'received', with "
            "_ns, _us or _ms behind it unless in s), or --columns SENT,RECEIVED",
            place,
        )
    return found


def _first(names: Sequence[str], known: Sequence[str]) -> int | None:
    plain = [name.lower().removesuffix(_unit(name.lower())) for name in names]
    return next((plain.index(one) for one in known if one in plain), None)


def _unit(name: str) -> str:
    return next((suffix for suffix in _UNITS if name.endswith(suffix)), "")


def _sample(
    path: Path, row: Sequence[str], names: Sequence[str], found: Columns, line: int
) -> RecordedSample:
    sent, received, number = found
    place = f"{path}:{line + 1}"
    stamps = [NONE if at is None else _stamp(row[at], names[at], place) for at in (sent, received)]
    count = NONE
    if number is not None and row[number].strip():
        try:
            count = int(row[number])
        except ValueError:
            raise ScenarioError(
                f"{names[number]} = {row[number]!r}; expected a whole number", place
            ) from None
    rest = tuple(cell for i, cell in enumerate(row) if i not in (sent, received))
    key = hash(rest if count == NONE else count)
    return RecordedSample(path.stem, stamps[1], count, NONE, stamps[0], key)


def _stamp(text: str, name: str, place: str) -> int:
    text = text.strip()
    if not text or text.lower() == "nan":
        return NONE
    try:
        ns = Decimal(text) * _UNITS.get(_unit(name.lower()), _SECOND)
    except InvalidOperation:
        raise ScenarioError(f"{name} = {text!r}; expected a number", place) from None
    if not ns.is_finite() or abs(ns) > _LARGEST:
        raise ScenarioError(f"{name} = {text}; expected a time in its unit", place)
    return round(ns)
