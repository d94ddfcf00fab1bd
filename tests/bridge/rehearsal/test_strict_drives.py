"""``cosim rehearse --hardware`` next to strict drives, which know nothing of our code.

The drives log what is done to them; tests/strict_drives/judged.py has the rules.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from bridge.results.overload import transits
from tests.strict_drives.cases import CASES, CONTROLLERS, Case, Ended, relaxed, run
from tests.strict_drives.fed import longest_gap, sent_times
from tests.strict_drives.judged import DriveLog, misdeeds

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
BUSES = ("left", "right", "link")
STILL = 5e6  # ns
INCONCLUSIVE = 3  # exit code
AGAIN, RELAXED = 3, 1000  # a machine that stood still starves drives, and that is no one's fault


def stood_still(case: Case, ended: Ended) -> bool:
    """Whether the machine starved a drive: a node was late, or frames came later than sent."""
    facts = json.loads((ended.folder / "run.json").read_text("utf-8"))
    nodes = facts.get("rehearsal", {}).get("nodes", {})
    late = [n["lateness"]["late"]["maximum"] for n in nodes.values()]
    took = [transits(ended.folder / "nodes", bus)[1].max(initial=0) for bus in BUSES]
    took += [1e9 * drive.end["gap"] - sent_gap(case, ended, drive) for drive in ended.drives]
    return max([*late, *took], default=0) > STILL


def sent_gap(case: Case, ended: Ended, drive: DriveLog) -> float:
    """The longest time without a frame that feeds a drive, as its node logged what it sent, ns.

    A drive of our own protocol is fed from t = 0 on.
    """
    bus, number = drive.name.split()
    side = BUSES.index(bus)
    nodes = ended.folder / "nodes"
    log = nodes / f"{CONTROLLERS[side]}.{bus}.frames"
    t = sent_times(log, case.feeding(side, int(number)))
    if case.kind == "ours":
        said = json.loads((nodes / f"{CONTROLLERS[side]}.json").read_text("utf-8"))
        t = t[t >= said["start_ns"]]
    return longest_gap(t)


def judged(name: str, folder: Path, *faults: str) -> Ended:
    """A run without misdeeds; again where the machine starved a drive, in the end with watchdogs
    so long that it cannot.
    """
    for k in range(AGAIN):
        case = CASES[name] if k < AGAIN - 1 else relaxed(CASES[name], folder, RELAXED)
        ended = run(case, folder / str(k), faults=faults)
        found = misdeeds(ended.drives)
        for drive in ended.drives:
            gap, watchdog = sent_gap(case, ended, drive) * 1e-9, drive.end["watchdog"]
            if gap > watchdog / 2:
                found.append(f"{drive.name}: nothing was sent for {gap:.4f} s")
        if ended.code != INCONCLUSIVE and (not found or not stood_still(case, ended)):
            break
    assert not found, "\n".join(found) + ended.said
    return ended


@pytest.mark.parametrize("name", CASES)
def test_drives_are_enabled_fed_and_moved(name: str, tmp_path: Path) -> None:
    ended = judged(name, tmp_path)
    assert not [text for drive in ended.drives for text in drive.worked()], ended.said
    # three times inconclusive: this machine had so much to do that a bus delivered late
    assert ended.code == 0 or (ended.code == INCONCLUSIVE and stood_still(CASES[name], ended)), (
        ended.said
    )
    for drive in ended.drives:
        assert drive.states.count(CASES[name].enabled) == 1, drive.states


#: Faults of a drive of the left arm, and what the output has to say of each.
FAULTS = {
    ("damiao", "1:trip=0xD@1.5"): r"drive 1\b.*(communication|0xD)",
    ("damiao", "2:trip=0xB@1.5"): r"drive 2\b.*(temperature|0xB)",
    ("damiao", "1:refuse@0"): r"drive 1\b",
    ("damiao", "1:drop@0"): r"drive 1\b",
    ("damiao", "1:reboot@1.5"): r"drive 1\b|master_state_1",
    ("damiao", "1:unplug@1.5"): r"drive 1\b|master_state_1",
    ("damiao", "1:other=5@1.5"): r"drive 1\b|master_state_1",
    ("odrive", "4:trip=0x400@1.5"): r"drive 4\b.*(current|0x0*400)",
    ("odrive", "4:refuse@0"): r"drive 4\b",
    ("cia402", "12:trip=0x2310@1.5"): r"drive 12\b.*fault",
    ("cia402", "12:refuse@0"): r"drive 12\b.*switched.on",
    ("ours", "trip=32@1.5"): r"(drive 1|master)\b",
}


@pytest.mark.parametrize(("name", "fault"), FAULTS)
def test_a_fault_stops_the_run_and_is_named(name: str, fault: str, tmp_path: Path) -> None:
    # watchdogs so long that a busy machine starves no other drive first
    ended = run(relaxed(CASES[name], tmp_path, RELAXED), tmp_path, faults=(fault,))
    # inconclusive where the machine starved drives as well
    assert ended.code == 1 or (ended.code == INCONCLUSIVE and "inconclusive" in ended.said), (
        ended.said
    )
    assert re.search(FAULTS[name, fault], ended.said, re.IGNORECASE | re.DOTALL), ended.said
    off = {drive.name: drive.end["off"] for drive in ended.drives}
    assert not any(off.values()), (off, ended.said)
