"""Programs that command drives over a bus: rates that are reached, answers that get through."""

from __future__ import annotations

from runpy import run_path

import numpy as np
import pytest

from cosim.bus.timing import CLASSIC, BusTiming, FrameFormat, mean
from docs.evidence.drive_bus import DriveBus
from docs.evidence.host_loop import (
    BilateralLoop,
    BlockingLoop,
    bilateral_loop,
    blocking_loop,
    fixed_rate,
)
from tests.cosim.comparison.parts import ROOT

SLOW, FAST = BusTiming(1e6), BusTiming(1e6, 5e6, fd=True)
FD = FrameFormat(fd=True, brs=True)


def test_below_the_limit_of_the_bus_every_command_is_answered() -> None:
    """2 n frames per cycle; the load is their time, with the three bits between frames."""
    for spec, rate in ((DriveBus(8, SLOW), 500.0), (DriveBus(8, FAST, FD), 1200.0)):
        found = fixed_rate(spec, rate, 0.05)
        assert found.answered == 1.0
        frames = [mean(8, spec.format, 0x10 * k + i) for k in (0, 1) for i in range(1, 9)]
        expected = rate * sum(map(spec.timing.time_ns, frames)) / 1e9
        assert found.load == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(("rate", "answered"), [(600, 0.82), (900, 0.20), (1200, 0.0)])
def test_beyond_it_commands_win_and_answers_do_not_get_through(
    rate: float, answered: float
) -> None:
    found = fixed_rate(DriveBus(8, SLOW, CLASSIC), rate, 0.1)
    assert found.load > 0.99
    assert found.answered == pytest.approx(answered, abs=0.04)


def test_a_read_whose_time_out_holds_for_every_frame_ends_with_an_idle_one() -> None:
    """Two arms of (0.5 + 1.0) ms each, the frames of one read at a time, and the controller."""
    frame = FAST.time_ns(mean(8, FD)) * 1e-9
    quiet = BlockingLoop(jitter=0.0)
    cycle = 2 * (1.5e-3 + 2 * 16 * frame + 2 * 30e-6) + quiet.controller
    found = blocking_loop([DriveBus(8, FAST, FD)] * 2, quiet, 0.1)
    assert found.answered == 1.0
    assert found.rate == pytest.approx(1.0 / cycle, rel=0.03)


def test_the_adapter_of_a_bus_lowers_the_rate_by_its_latency_both_ways() -> None:
    rates = [
        blocking_loop([DriveBus(8, FAST, FD, latency=x)] * 2, BlockingLoop(jitter=0.0), 0.1).rate
        for x in (0.0, 125e-6)
    ]
    assert 1 / rates[1] - 1 / rates[0] == pytest.approx(2 * 2 * 2 * 125e-6, rel=0.05)


def test_what_lets_the_loop_run_at_a_millisecond() -> None:
    two = [DriveBus(8, FAST, FD, latency=50e-6)] * 2
    asking = blocking_loop(two, BlockingLoop(every_frame=False, period=1e-3), 0.05)
    assert asking.rate == pytest.approx(1000.0, rel=0.02) and asking.answered < 0.8
    silent = blocking_loop(two, BlockingLoop(every_frame=False, ask=0.0, period=1e-3), 0.05)
    assert silent.rate == pytest.approx(1000.0, rel=0.02)
    assert silent.answered > 0.99 and silent.load == pytest.approx(0.80, abs=0.02)


def test_an_adapter_that_delivers_answers_one_by_one_takes_its_time_for_each() -> None:
    """7 times 125 us between the answers of each read, instead of the time of the bus."""
    quiet = BlockingLoop(jitter=0.0)
    spec = DriveBus(8, FAST, FD, spacing=125e-6)
    cycle = 1 / blocking_loop([spec] * 2, quiet, 0.1).rate
    frame = FAST.time_ns(mean(8, FD)) * 1e-9
    asked = 2 * frame + 30e-6  # answers win against the questions that wait
    commanded = 9 * frame  # and lose against commands
    read = asked + commanded + 2 * (7 * 125e-6)
    assert cycle == pytest.approx(2 * (read + 1.5e-3) + quiet.controller, rel=0.02)


def test_states_are_used_two_cycles_after_they_were_taken() -> None:
    """Read in the next cycle, used in the one after; a third thread brings the other arm's."""
    for period, spec in ((2e-3, DriveBus(8, SLOW)), (1e-3, DriveBus(8, FAST, FD))):
        loop = BilateralLoop(period=period, jitter=0.0)
        for arm in bilateral_loop((spec, spec), loop, 2, 0.2):
            assert len(arm.heard) == pytest.approx(0.2 / period, abs=6)
            assert arm.heard - arm.own == pytest.approx(2 * period, abs=50e-6)
            age = arm.heard - arm.other
            assert (age > period).all() and (age < 4 * period).all()


def test_the_latency_of_an_adapter_counts_twice_and_stalls_make_states_old() -> None:
    spec = DriveBus(8, SLOW, latency=4e-3)
    quiet = BilateralLoop(jitter=0.0)
    arm, _ = bilateral_loop((spec, spec), quiet, 2, 0.2)
    assert np.median(arm.heard - arm.own) == pytest.approx(12e-3, abs=50e-6)
    late, _ = bilateral_loop((DriveBus(8, SLOW),) * 2, BilateralLoop(stalls=20.0), 2, 0.5)
    assert (late.heard - late.own).max() > 15e-3


@pytest.mark.slow
def test_the_page_of_reports_is_what_its_script_writes() -> None:
    text = (ROOT / "docs/evidence/openarm-reports.md").read_text(encoding="utf-8")
    assert run_path(str(ROOT / "docs/evidence/openarm_reports.py"))["page"](text) == text
