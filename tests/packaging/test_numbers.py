"""Numbers, defaults and identifiers in the pages of ``docs/`` are those of the code."""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import cantools
import msgspec
import pytest

from bridge.deployment import spec as deployment
from bridge.deployment.drive_sequences import FEED_NS
from bridge.faults.script import FaultScript
from bridge.faults.spec import SPECS
from bridge.monitor.sinks import LIVE_RATE
from bridge.native.pace import _LINEAR, _PER_OCTAVE
from bridge.realtime.os_grants import Realtime
from bridge.simulated_can.bus import CosimBus
from bridge.zenoh.options import ZenohOptions
from cosim.fmi.options import FmuOptions
from cosim.scenario.spec import ComponentSpec, LinkSpec, RecordSpec, RunSpec
from cosim.study.spec import StudySpec

ROOT = Path(__file__).resolve().parents[2]


def page(name: str) -> str:
    """A page of ``docs/`` with each run of blanks as one blank."""
    return re.sub(r"\s+", " ", (ROOT / "docs" / name).read_text(encoding="utf-8"))


def in_c(file: str, pattern: str) -> float:
    """The number that follows a word, or that a pattern finds, in a file of ``bridge/c``."""
    pattern = pattern if "(" in pattern else rf"\b{pattern} = (\d+)"
    found = re.findall(pattern, (ROOT / "bridge" / "c" / file).read_text(encoding="utf-8"))
    assert len(found) == 1, f"{file}: {pattern}: {found}"
    return float(found[0])


def default(of: Any, name: str) -> Any:
    """The default of a field of a struct or data class, or of an argument of a function."""
    if dataclasses.is_dataclass(of):
        return {field.name: field.default for field in dataclasses.fields(of)}[name]
    if isinstance(of, type) and issubclass(of, msgspec.Struct):
        return {f.encode_name: f.default for f in msgspec.structs.fields(of)}[name]
    return inspect.signature(of).parameters[name].default


def usual(key: str) -> float:
    """The default of a top-level key of a deployment, s."""
    found = re.search(rf'_seconds\(document, "{key}", ([\d.]+)', inspect.getsource(deployment))
    assert found
    return float(found[1])


NODE = deployment.NodeSpec
NUMBERS: list[tuple[str, str, Callable[[], float]]] = [
    ("can.md", r"`ESTOP` .{9,15} every (\d+) ms", lambda: in_c("service.c", "ALARM_NS") / 1e6),
    ("can.md", r"at most every (\d+) ms", lambda: in_c("run_epoch.c", "APART_NS") / 1e6),
    ("can.md", r"HEARTBEAT_n` .{9,15} every (\d+) ms", lambda: default(NODE, "heartbeat") * 1e3),
    ("can.md", r"at most (\d+) ppm", lambda: in_c("receiver.h", r"at most (\d+) ppm")),
    ("can.md", r"by (\d+) ppm", lambda: in_c("receiver.c", r"Forgotten by (\d+) ppm")),
    ("faults.md", r"\(at most (\d+) a frame\)", lambda: in_c("faults.h", "FAULT_MOST")),
    (
        "faults.md",
        r"At most (\d+) frames wait",
        lambda: default(FaultScript.frames_for, "capacity"),
    ),
    ("rehearsal.md", r"`patience` \((\d+) s", lambda: usual("patience")),
    ("rehearsal.md", r"`silence` \((\d+) s", lambda: usual("silence")),
    ("rehearsal.md", r"`within` \((\d+) ms\)", lambda: default(NODE, "within") * 1e3),
    ("rehearsal.md", r"`heartbeat` \((\d+) ms\)", lambda: default(NODE, "heartbeat") * 1e3),
    ("rehearsal.md", r"torque to 0 in (\d+) ms", lambda: default(NODE, "ramp") * 1e3),
    ("rehearsal.md", r"slot later than (\d+) ms", lambda: default(NODE, "overrun") * 1e3),
    ("safety.md", r"`ramp` \((\S+) s by default\)", lambda: default(NODE, "ramp")),
    ("safety.md", r"it every (\d+) ms until", lambda: in_c("service.c", "ALARM_NS") / 1e6),
    ("safety.md", r"\(every (\d+) to 20 ms\)", lambda: FEED_NS[0] / 1e6),
    ("safety.md", r"\(every 5 to (\d+) ms\)", lambda: FEED_NS[1] / 1e6),
    ("rehearsal.md", r"at most (\d+) slots a second", lambda: LIVE_RATE),
    ("network.md", r"`options.wait` \((\d+) s\)", lambda: default(ZenohOptions, "wait")),
    ("rehearsal.md", r"bins of 1 µs up to (\d+) µs", lambda: _LINEAR),
    ("rehearsal.md", r"then (\d+) a factor of two", lambda: _PER_OCTAVE),
    ("rehearsal.md", r"TIMERSLACK` (\d+) ns", lambda: default(Realtime, "timer_slack_ns")),
]


@pytest.mark.parametrize(("name", "words", "number"), NUMBERS, ids=[n[1] for n in NUMBERS])
def test_a_number_of_a_page_is_that_of_the_code(
    name: str, words: str, number: Callable[[], float]
) -> None:
    found = {float(text) for text in re.findall(words, page(name))}
    assert sorted(found) == pytest.approx([float(number())]), f"docs/{name}: {words}"


#: The structs whose keys a page has in a table with a column of defaults; prefixes of the keys.
TABLES: list[tuple[str, str, Any]] = [
    *(("running.md", "", struct) for struct in (RunSpec, ComponentSpec)),
    ("links.md", "", LinkSpec),
    ("running.md", "record.", RecordSpec),
    ("running.md", "", FmuOptions),
    ("sweep.md", "", StudySpec),
    ("can.md", "", CosimBus.__init__),
]
WORDS = {"yes": True, "no": False}


def stated(name: str) -> dict[str, Any]:
    """The defaults of the tables of a page that are values (``0``, `"hold"`, yes), by key."""
    found = {}
    for line in (ROOT / "docs" / name).read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        if len(cells) != 3 or not line.startswith("| `"):
            continue
        keys, values = re.findall(r"`([\w.]+)`", cells[0]), cells[2].rstrip(" |").split(", ")
        for key, value in zip(keys, values, strict=False):
            text = value.strip("`").removesuffix(" s")
            try:
                found[key] = WORDS[text] if text in WORDS else json.loads(text)
            except ValueError:
                found.setdefault(key, None)
                if value.startswith("`") and value.endswith("`"):
                    found[key] = text
    return {key: value for key, value in found.items() if value is not None}


@pytest.mark.parametrize(
    ("name", "prefix", "of"), TABLES, ids=[f"{t[0]} {t[2].__qualname__}" for t in TABLES]
)
def test_a_default_of_a_table_is_that_of_the_code(name: str, prefix: str, of: Any) -> None:
    table, compared = stated(name), 0
    for key, value in table.items():
        try:
            expected = default(of, key.removeprefix(prefix))
        except KeyError:
            continue
        if key.startswith(prefix) and expected not in (None, ""):  # "": from other keys
            assert value == expected, f"docs/{name}: {key}"
            compared += 1
    assert compared, f"docs/{name}: no default of {of}"


@pytest.mark.parametrize("kind", SPECS)
def test_a_default_of_a_fault_is_that_of_the_code(kind: str) -> None:
    row = re.search(rf"^\| `{kind}` \|.*$", (ROOT / "docs/faults.md").read_text("utf-8"), re.M)
    assert row, kind
    for key, text in re.findall(r"`(\w+)` \((\d[\de.]*)(?: \w+)?\)", row[0]):
        assert float(text) == float(default(SPECS[kind], key)), f"{kind}: {key}"


def identifiers() -> list[tuple[str, str, int, int]]:
    """Rows of the table of messages: file, name, identifier and bytes of node 1."""
    rows = []
    for line in (ROOT / "docs" / "can.md").read_text(encoding="utf-8").splitlines():
        row = re.match(r"\| (0x.*?) \| (.*?) \| (\d+)(?: or (\d+))? \|", line)
        if row is None:
            continue
        bases = [int(x, 16) for x in re.findall(r"0x[0-9A-F]+", row[1])]
        names = [x.replace("_n", "_1") for x in re.findall(r"`(\w+)`", row[2])]
        stem = names[0].split("_")[0]
        per_node = " + n" in row[1]
        files = ["link_fd", "link_fd2"] if "(FD)" in row[1] or not per_node else []
        files += ["link", "link2"] if "(FD)" not in row[1] else []
        for file in files:
            letters = [f"{stem}_{x}_1" for x in "ABC"] if len(bases) == 3 else names
            letters = [f"{stem}_1"] if len(bases) == 3 and file == "link2" else letters
            if file.startswith("link_fd") and len(bases) == 3:
                continue
            size = int(row[4]) if row[4] and file == "link_fd2" else int(row[3])
            rows += [
                (file, n, base + per_node, size) for n, base in zip(letters, bases, strict=False)
            ]
    return rows


@cache
def database(file: str) -> cantools.database.Database:
    return cantools.database.load_file(ROOT / "configs" / "can" / f"{file}.dbc")


def test_identifiers_and_bytes_of_the_table_are_those_of_the_dbc_files() -> None:
    rows = identifiers()
    assert len(rows) >= 40
    for file, name, identifier, size in rows:
        message = database(file).get_message_by_name(name)
        assert (message.frame_id, message.length) == (identifier, size), f"{file}: {name}"
