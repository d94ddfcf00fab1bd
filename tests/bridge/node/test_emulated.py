"""Emulated drives of vendors in their node, on the simulated clock: power, faults, their bus."""

from __future__ import annotations

import pytest

from bridge.native.frame import Frame
from bridge.native.node import MotorFault
from bridge.native.vendor import VendorFault, VendorKind
from tests.bridge.deployments import named
from tests.bridge.slots import Slots

ACTS, FAULT, FIRST, SECOND = 1, 2, 4, 8
FAR = 1 << 62


@pytest.fixture(name="arm")
def arm_(tmp_path):
    """``master`` of can-damiao.toml, the node of two drives; nobody commands them."""
    with Slots(named("can-damiao", "run.stop=1"), "master", tmp_path) as slots:
        s = slots.struct
        s.n_peers = 0
        slots.begin()
        for motor in s.motors[: s.n_motors]:
            motor.vendor.timeout_ns = motor.vendor.word = 0  # no watchdog
            motor.vendor.fed_ns = FAR
        yield slots


def motors(arm):
    """Its drives, each with what its inlet points to."""
    return arm.struct.motors[: arm.struct.n_motors]


POWER = [  # acts, error, kind, network, owed of both kinds -> bits
    (1, 0, VendorKind.DAMIAO, 1, (0, 0), ACTS),
    (0, 0, VendorKind.DAMIAO, 1, (0, 0), 0),
    (0, 10, VendorKind.DAMIAO, 1, (0, 0), FAULT),
    (1, 10, VendorKind.DAMIAO, 1, (0, 0), ACTS),
    (1, 0, VendorKind.DAMIAO, 1, (1, 0), ACTS | FIRST),
    (0, 0, VendorKind.DAMIAO, 1, (0, 2), SECOND),
    (0, 0, VendorKind.DAMIAO, 1, (3, 1), FIRST | SECOND),
    (1, 0, VendorKind.ODRIVE, 1, (0, 0), ACTS | FIRST | SECOND),
    (0, 0, VendorKind.ODRIVE, 0, (0, 0), 0),
    (0, 0, VendorKind.ODRIVE, 0, (1, 0), FIRST),
    (0, 0, VendorKind.CIA402, 5, (0, 0), 0),
    (0, 7, VendorKind.CIA402, 127, (0, 1), FAULT | SECOND),
]


@pytest.mark.parametrize(("acts", "error", "kind", "network", "owed", "power"), POWER)
def test_a_slot_knows_what_the_state_machine_of_a_drive_makes_of_it(
    arm, acts, error, kind, network, owed, power
):
    first, _ = motors(arm)
    v = first.vendor
    v.kind, v.acts, v.error, v.network, v.owed[:] = kind, acts, error, network, owed
    v.booted_ns = v.due_ns = v.ramp_ns = v.beat_due_ns = FAR
    v.timeout_ns = v.input = 0
    arm.step()
    assert first.power == power


def test_a_fault_happens_to_its_drive_when_the_run_comes_to_its_time(arm):
    """Faults at one time act in their order; an entry behind the end of the table does not."""
    s, (first, second) = arm.struct, motors(arm)
    s.start_ns = 5_000_000_000
    for motor in (first, second):
        motor.vendor.now_ns = motor.vendor.fed_ns = s.start_ns
    at = 3 * s.h_ns
    table = (MotorFault * 4)(
        MotorFault(at, VendorFault.LATE, 5), MotorFault(at, VendorFault.LATE, 6),
        MotorFault(at + 1, VendorFault.LATE, 7), MotorFault(0, VendorFault.LATE, 9),
    )  # fmt: skip
    first.faults, first.n_faults = table, 3
    late = []
    for _ in range(6):
        arm.step()
        late.append((first.happened, first.vendor.late_ns, second.vendor.late_ns))
    assert late == [(0, 0, 0)] * 3 + [(2, 6, 0)] + [(3, 7, 0)] * 2


def test_a_drive_hears_what_is_for_it(arm):
    """A command to be disabled, which the other one does not obey."""
    first, second = motors(arm)
    arm.put(arm.names[0], Frame.of(first.vendor.node, b"\xff" * 7 + b"\xfd"), 0.0)
    arm.step()
    assert (first.vendor.acts, second.vendor.acts) == (0, 1)


def test_drives_behind_the_table_are_not_there(arm):
    s, (_, second) = arm.struct, motors(arm)
    arm.step()
    s.n_motors = 1
    arm.put(
        arm.names[0], Frame.of(second.vendor.node, b"\xff" * 7 + b"\xfd"), s.slot * s.h_ns * 1e-9
    )
    arm.step()
    assert second.vendor.acts == 1
