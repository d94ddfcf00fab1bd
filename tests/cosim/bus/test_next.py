"""`bus_next` of C: when a frame can be received next."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.bus.frames import BusEvent, BusFrame
from cosim.bus.settings import BusNodeSettings, ErrorRate
from cosim.bus.shared import library
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming

NEVER = 2**63 - 1


@pytest.mark.parametrize("errors", [[], [ErrorRate(1e-3)]], ids=["undisturbed", "with errors"])
def test_no_frame_is_received_before_the_next_time(errors) -> None:
    names = [BusNodeSettings(name) for name in "abc"]
    bus = SimulatedBus(BusTiming(1e6), names, disturbances=errors, seed=1)
    assert library().bus_next(bus.address) == NEVER
    random, received, steps = np.random.default_rng(2), 0, 0
    for node in range(3):
        for at in np.sort(random.integers(0, 10**10, 20)):
            bus.request(node, int(at), BusFrame(int(random.integers(16 * node, 16 * node + 16))))
    while (until := library().bus_next(bus.address)) != NEVER:
        assert until > bus.now_ps
        events = bus.advance(until)
        times = events["time"][events["kind"] == BusEvent.RECEIVED]
        assert (times == until).all()
        received, steps = received + len(times), steps + 1
    assert received == 2 * 60
    if not errors:
        assert steps <= 3 * 60
