"""The steps of `cosim doctor --deploy` next to strict drives in this process, one by one."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.commission import drive_line, steps
from bridge.commission.interfaces import StepFinding
from bridge.commission.registers import registers
from tests.bridge.commission.bench import WATCHDOG, Bench, bench
from tests.strict_drives.core import Fault

KINDS = ("damiao", "cia402", "odrive")


def checked(b: Bench, *refused: str) -> dict[str, StepFinding]:
    """The findings by name; each question is answered with yes, unless it has a refused word."""

    def ask(question: str) -> bool:
        return not any(word in question for word in refused)

    return {f.name: f for f in steps.drive_steps(b.line, b.known, ask, alone=True)}


def settings(b: Bench) -> dict[str, StepFinding]:
    """The findings on firmware and settings of the first drive, by the last word of their name."""
    assert not b.line.bring_up(b.known[:1], enable=False)
    return {f.name.partition(": ")[2]: f for f in registers(b.line, b.known[0])}


@pytest.fixture(name="damiao")
def damiao_(tmp_path: Path) -> Iterator[Bench]:
    with bench("damiao", tmp_path) as b:
        yield b


@pytest.fixture(name="cia402")
def cia402_(tmp_path: Path) -> Iterator[Bench]:
    with bench("cia402", tmp_path) as b:
        yield b


@pytest.mark.parametrize("name", KINDS)
def test_a_drive_that_is_well_passes_each_step(name: str, tmp_path: Path) -> None:
    with bench(name, tmp_path) as b:
        found = checked(b)
        drive = next(iter(b.drives.values()))
    assert [f for f in found.values() if f.state == "missing"] == []
    whole = b.known[0].name
    for step in ("", ": watchdog", ": firmware", f": direction of {b.known[0].joint}"):
        assert found[whole + step].state == "good", found[whole + step]
    assert drive.counts["trips"] >= 1  # the step of the watchdog
    assert drive.counts["off"] == 0 and not drive.enabled


def test_the_frames_are_those_of_a_node(damiao: Bench) -> None:
    """The register is written before the drive is cleared and enabled, and disabled at the end."""
    assert not damiao.line.bring_up(damiao.known)
    assert damiao.known[0].is_enabled()
    damiao.line.rest()
    damiao.line.serve(0.1)
    assert damiao.events(1, "written")[0]["value"] == WATCHDOG * 20  # in 50 us
    assert [e["what"] for e in damiao.events(1, "request")] == ["0xFB", "0xFC", "0xFD"]


# ---- settings -----------------------------------------------------------------------------------


def test_firmware_and_ranges_of_a_damiao_are_read(damiao: Bench) -> None:
    found = settings(damiao)
    assert found["firmware"].found == "hardware 4, firmware 5017, serial number 1001"
    assert "TMAX (23) 10" in found["settings"].found and found["settings"].state == "good"


@pytest.mark.parametrize(
    ("register", "value", "said"),
    [
        (10, 2, "CTRL_MODE (10) 2, expected 1"),
        (7, 0x21, "MST_ID (7) 33, expected 17"),
        (35, 9, "can_br (35) 9, expected 4"),
        (23, 28.0, "TMAX (23) 28, expected 10"),
        (21, 12.566, "PMAX (21) 12.566, expected 12.5"),
    ],
)
def test_another_register_of_a_damiao_is_named(
    register: int, value: Any, said: str, damiao: Bench
) -> None:
    drive: Any = damiao.drives[1]
    if isinstance(value, float):
        drive.told_ranges = {register: struct.pack("<f", value)}
    else:
        drive.registers[register] = value
    found = settings(damiao)["settings"]
    assert (found.state, found.found) == ("missing", said) and "vendor's tool" in found.cure


def test_the_objects_of_a_cia_402_drive_agree(cia402: Bench) -> None:
    found = settings(cia402)
    assert "name a strict CiA 402 drive" in found["firmware"].found  # read in segments
    assert "vendor 0x1a0, product 0x402, revision 0x10002" in found["firmware"].found
    assert found["settings"].state == found["torque limit"].state == "good"


@pytest.mark.parametrize(
    ("where", "value", "step", "said"),
    [
        ((0x1000, 0), 0x191, "firmware", "profile 401, expected 402"),
        ((0x1016, 1), 0, "settings", "node 0, 0 ms, expected node 2, 250 ms"),
        ((0x1A00, 2), 0x60630020, "settings", "60630020 60770010, expected 0x18b of type 0x1"),
        ((0x1800, 2), 255, "settings", "of type 0xff"),
        ((0x6061, 0), 8, "settings", "mode (0x6061) 8, expected 10"),
        ((0x6076, 0), 5000, "settings", "5000 mN.m, expected 1000 mN.m"),
        ((0x6072, 0), 4000, "torque limit", "4 N.m (0x6072), the profile has 3 N.m at most"),
    ],
)
def test_another_object_is_named(
    where: tuple[int, int], value: int, step: str, said: str, cia402: Bench
) -> None:
    drive: Any = cia402.drives[11]
    drive.changed[where] = value
    found = settings(cia402)[step]
    assert found.state == "missing" and said in found.found, found


def test_an_object_that_is_not_there_is_not_checked(cia402: Bench) -> None:
    drive: Any = cia402.drives[11]
    drive.hidden = {(0x6072, 0), (0x1801, 1)}
    found = settings(cia402)
    assert found["torque limit"].state == found["objects"].state == "limited"
    assert "0x1801:1: the drive aborts with 0x06020000" in found["objects"].found
    drive.changed[0x60C2, 1], drive.changed[0x60C2, 2] = 4, 0xFD
    assert "expects SYNC every 4 ms" in settings(cia402)["period"].found


# ---- drives that are not well -------------------------------------------------------------------


def test_a_drive_that_is_not_there_ends_the_steps(tmp_path: Path) -> None:
    with bench("damiao", tmp_path) as b:
        b.drives[1].silent_until = float("inf")
        found = checked(b)
    assert found["drive 1 on bus left"].found == "does not answer"
    assert list(found) == ["drive 1 on bus left", "emergency stop"]


def test_a_drive_with_the_number_of_another_is_named(damiao: Bench) -> None:
    drive: Any = damiao.drives[1]
    drive.told_number = 3  # in its status, under its own identifier
    found = checked(damiao)["drive 1 on bus left"]
    assert found.state == "missing" and "the number of another drive (0x3)" in found.found


def test_a_watchdog_that_is_off_is_found(tmp_path: Path) -> None:
    with bench("odrive", tmp_path, "--timeout", "0") as b:
        found = checked(b)["drive 1 on bus left: watchdog"]
        b.line.serve(0.2)
        assert not b.drives[1].enabled
    assert found.state == "missing"
    assert f"still CLOSED_LOOP_CONTROL after {2 * WATCHDOG} ms without a frame" in found.found


@pytest.mark.parametrize(("stalls", "state"), [(1, "good"), (99, "limited")])
def test_a_machine_that_stands_still_is_no_fault_of_the_drive(
    stalls: int, state: str, damiao: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drive that this program itself has not fed in time is tried again, and not blamed."""
    seen = [0]  # once an enabling, a moment after it

    def sleep(seconds: float) -> None:
        drive, served = damiao.drives[1], damiao.line.late > 0 and damiao.known[0].is_enabled()
        stands = served and seen[0] < min(drive.counts["enabled"], stalls)
        seen[0] += stands
        time.sleep(2 * WATCHDOG / 1e3 if stands else seconds)

    monkeypatch.setattr(drive_line, "sleep", sleep)
    *_, found = steps.watchdog(damiao.line, _found(damiao))
    assert found.state == state, found
    assert damiao.drives[1].counts["trips"] >= 2
    assert state == "good" or "this machine stood still for" in found.found


@pytest.mark.parametrize(("beat", "said"), [("100", True), ("5", False)])
def test_a_state_that_comes_seldom_is_said(beat: str, said: bool, tmp_path: Path) -> None:
    """An ODrive comes with a heartbeat every 100 ms; its profile has it set to 10 ms."""
    with bench("odrive", tmp_path, "--beat", beat) as b:
        found = checked(b)
    state = found.get("drive 1 on bus left: state")
    assert (state is not None and state.state == "limited") == said
    assert state is None or state.cure == "set axis.config.can.heartbeat_msg_rate_ms"


@pytest.mark.parametrize(
    ("kind", "state", "said"),
    [
        ("wrong", "missing", "turned by -0.0"),
        ("nothing", "limited", "not checked: did not move"),
    ],
)
def test_a_joint_that_turns_the_wrong_way_or_not_at_all(
    kind: str, state: str, said: str, damiao: Bench
) -> None:
    damiao.drives[1].faults.append(Fault(kind, 0.0, 0.0))
    found = steps.direction(damiao.line, _found(damiao), lambda _: True)
    assert found.state == state and said in found.found, found


def test_a_person_who_saw_another_motion_or_wants_none(damiao: Bench) -> None:
    drive = _found(damiao)
    other = steps.direction(damiao.line, drive, lambda question: "Did" not in question)
    assert (other.state, other.cure) == ("missing", "direction and zero in the deployment")
    none = steps.direction(damiao.line, drive, lambda _: False)
    assert (none.state, none.found) == ("limited", "not checked: not tried")


def test_a_drive_that_trips_under_torque_is_named(damiao: Bench) -> None:
    drive = _found(damiao)
    damiao.drives[1].faults.append(Fault("trip", 0xA, 0.05))
    found = steps.direction(damiao.line, drive, lambda _: True)
    assert found.state == "missing" and "it tells OVER_CURRENT" in found.found
    damiao.line.serve(0.1)
    assert damiao.drives[1].counts["off"] == 0


def _found(b: Bench) -> Any:
    assert [f for f in steps.find(b.line, b.known[0]) if f.state == "missing"] == []
    return b.known[0]


# ---- emergency stop -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", KINDS)
def test_an_emergency_stop_that_cuts_the_power_is_proven(name: str, tmp_path: Path) -> None:
    with bench(name, tmp_path, "--fault", "unplug@0.3", first=2) as b:
        found = steps.emergency_stop(b.line, b.known, lambda _: True)
    assert (found.state, found.found) == ("good", "all 2 drives are off"), found


@pytest.mark.parametrize("name", KINDS)
def test_a_drive_that_the_emergency_stop_does_not_reach_is_named(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(steps, "PRESS", 1.5)
    with bench(name, tmp_path, first=2) as b:
        first, second = b.known
        b.drives[first.foreign.node].faults.append(Fault("unplug", 0.0, 0.2))
        found = steps.emergency_stop(b.line, b.known, lambda _: True)
        b.line.serve(0.2)
        assert not b.drives[second.foreign.node].enabled  # disabled when the step is over
    assert (found.state, found.found) == ("missing", f"still enabled: {second.name}")


def test_an_emergency_stop_that_nobody_presses_is_not_checked(damiao: Bench) -> None:
    found = steps.emergency_stop(damiao.line, damiao.known, lambda _: False)
    assert found.state == "limited" and found.found.startswith("not checked")
    assert not damiao.events(1, "request")  # nothing was enabled
