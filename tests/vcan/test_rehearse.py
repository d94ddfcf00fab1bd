"""``cosim rehearse`` on SocketCAN: four processes, two buses, and what others see of them."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import can
import numpy as np
import pytest

from bridge.can.log import read_log
from bridge.native.frame import Flags
from bridge.native.journal import Journal
from tests.vcan.peers import call
from tests.vcan.rehearsals import (
    CALM,
    ROOT,
    SCENARIO,
    bring_up,
    cosim,
    dump,
    ended,
    running,
    settings,
    slots,
    until,
)

DBC = ROOT / "configs" / "can" / "link_fd2.dbc"
# The command `cantools`, without the seconds that the import of asammdf takes.
CANTOOLS = "import sys; sys.modules['asammdf'] = None; import cantools; cantools._main()"
LSB = 2.0**-20


@dataclass(frozen=True)
class Seen:
    """A rehearsal: what it said, its folder, and what candump wrote next to it."""

    code: int
    text: str
    folder: Path
    dumps: dict[str, Path]


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Seen]:
    """Three seconds of two arms, with candump on both buses."""
    bring_up()
    tmp = tmp_path_factory.mktemp("rehearse")
    words = ("--no-plot", "--out", str(tmp / "run"), *settings(*CALM, 'run.stop="3 s"'))
    dumps = {"left": tmp / "left.dump", "right": tmp / "right.dump"}
    with dump("vcan0", dumps["left"]), dump("vcan1", dumps["right"]):
        done = cosim(tmp / "lib", "rehearse", str(SCENARIO), "--deploy", "can", *words)
    assert (tmp / "run" / "run.json").is_file(), done.stdout + done.stderr
    yield Seen(done.returncode, done.stdout + done.stderr, tmp / "run", dumps)


@cache
def decoded(log: Path) -> dict[str, list[dict[str, float]]]:
    """Signals of every frame by message, as ``cantools decode`` prints them."""
    command = [sys.executable, "-c", CANTOOLS, "decode", "-s", str(DBC)]
    with log.open() as text:
        done = subprocess.run(command, stdin=text, capture_output=True, text=True, check=True)
    rows: dict[str, list[dict[str, float]]] = {}
    for line in done.stdout.splitlines():
        match = re.search(r":: (\w+)\((.*)\)", line)
        if match:
            found = re.findall(r"(\w+): (-?[\d.]+(?:e[+-]?\d+)?)", match[2])
            rows.setdefault(match[1], []).append({name: float(value) for name, value in found})
    return rows


def test_it_comes_to_its_end_and_says_what_it_was(seen: Seen) -> None:
    assert seen.code == 0, seen.text
    for words in (
        *("master ", "slave_control ", " late ", "age ", "bus left", "bus right", "twin "),
        *("difference exactly 0", "replays exactly"),
    ):
        assert words in seen.text, words
    facts = json.loads((seen.folder / "run.json").read_text())["rehearsal"]
    assert facts["finished"] and facts["replay"] == 0.0
    assert all(n["said"]["state"] == "finished" for n in facts["nodes"].values())


def test_every_node_ran_every_slot(seen: Seen) -> None:
    for path in (seen.folder / "nodes").glob("*.journal"):
        slots = Journal.open(path)["slot"]
        assert slots.tolist() == list(range(600)), path.name


@pytest.mark.parametrize("bus", ["left", "right"])
def test_candump_saw_the_frames_that_the_log_has(seen: Seen, bus: str) -> None:
    ours, theirs = read_log(seen.folder / "buses" / f"{bus}.log"), read_log(seen.dumps[bus])

    def counted(rows: np.ndarray) -> Counter[tuple[int, bytes]]:
        return Counter((int(r["id"]), r["data"].tobytes()[: r["length"]]) for r in rows)

    assert len(ours.rows) > 600
    assert not counted(ours.rows) - counted(theirs.rows)
    assert all(r["flags"] & Flags.FD for r in ours.rows if r["length"] > 8)


@pytest.mark.parametrize(
    ("bus", "message", "node", "names"),
    [
        ("left", "LINK_2", "master_control", ("tau1", "tau2", "xi1", "xi2")),
        ("left", "STATE_1", "master", ("q1", "q2", "dq1", "dq2")),
        ("right", "LINK_4", "slave_control", ("tau1", "tau2", "xi1", "xi2")),
    ],
)
def test_cantools_reads_what_the_journals_have(
    seen: Seen, bus: str, message: str, node: str, names: tuple[str, ...]
) -> None:
    sent = Journal.open(seen.folder / "nodes" / f"{node}.journal")["sent"]
    read = np.array([[row[name] for name in names] for row in decoded(seen.dumps[bus])[message]])
    end = len(read) - message.startswith("LINK")  # the last torque of all is zero
    read = read[end - len(sent) : end]  # before the start it is said what will be sent first
    assert len(sent) == 600
    assert np.abs(read - sent).max() <= 0.5 * LSB + 1e-9


def test_the_log_is_for_everybody(seen: Seen, tmp_path: Path) -> None:
    log = seen.folder / "buses" / "left.log"
    n = len(log.read_text().splitlines())
    call("log2asc", "-I", str(log), "-O", str(tmp_path / "left.asc"), "vcan0")
    lines = (tmp_path / "left.asc").read_text().splitlines()
    assert sum(" CANFD " in line or " Rx " in line for line in lines) >= n
    with can.LogReader(log) as reader:
        assert sum(1 for _ in reader) == n
    assert len(decoded(log)["LINK_2"]) == len(decoded(seen.dumps["left"])["LINK_2"])


def test_it_replays_to_the_bit(seen: Seen, tmp_path: Path) -> None:
    done = cosim(tmp_path / "lib", "replay", str(seen.folder))
    assert done.returncode == 0, done.stdout + done.stderr
    assert "exactly 0 in every signal" in done.stdout
    assert done.stdout.count("600 slots") == 4


def test_it_is_near_its_twin(seen: Seen) -> None:
    """Both have the same delays of the scenario; the difference is what the wall clock did."""
    assert json.loads((seen.folder / "run.json").read_text())["rehearsal"]["twin_rms"]["rad"] < 0.3


def test_nmt_stop_on_one_bus_ends_all_of_it_safely(vcan: tuple[str, str], tmp_path: Path) -> None:
    folder = tmp_path / "run"
    words = ("--no-plot", "--no-twin", "--out", str(folder), *settings(*CALM, 'run.stop="15 s"'))
    with running(tmp_path / "lib", "rehearse", str(SCENARIO), "--deploy", "can", *words) as run:
        journal = folder / "nodes" / "master_control.journal"
        until(lambda: slots(journal) > 100, "it runs", run)
        call("cansend", vcan[0], "000#0200")
        text = ended(run)
    assert run.returncode == 1
    assert "failed: " in text and "difference exactly 0" in text
    scale = Journal.open(journal)["scale"]
    assert scale[50] == 1.0 and scale[-1] == 0.0
    assert (np.diff(scale[50:]) <= 0).all()
    assert ((scale > 0) & (scale < 1)).any()  # a ramp
