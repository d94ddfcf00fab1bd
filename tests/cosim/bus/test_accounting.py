"""Response times and losses of each identifier, from the events of a simulated bus."""

from __future__ import annotations

import numpy as np

from cosim.bus.accounting import IdentifierAccount, accounts
from cosim.bus.frames import REQUEST, BusFrame, DropCause
from cosim.bus.settings import BusNodeSettings, ScriptedError
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming

BIT = 1_000_000


def test_each_identifier_has_its_times_and_its_losses():
    nodes = [BusNodeSettings("a"), BusNodeSettings("b", queue_length=1)]
    bus = SimulatedBus(BusTiming(1e6), nodes, disturbances=[ScriptedError(0x123, 30)])
    rows = np.zeros(4, REQUEST)
    long, short = BusFrame(0x123, b"\x55" * 8).row(), BusFrame(0x7FF, b"\x55").row()
    rows[0] = (5 * BIT, 0, 0, long)
    rows[1] = (10 * BIT, 1, 0, short)
    rows[2] = (11 * BIT, 1, 0, short)
    rows[3] = (500 * BIT, 0, 0, long)
    first = bus.request_many(rows[:1])
    bus.request_many(rows[1:])
    events = bus.advance(10**9)
    # the first attempt of 0x123 fails in bit 30: the next starts 52 bits later
    assert accounts(rows, events, first) == [
        IdentifierAccount(0x123, False, 2, (52 + 109 + 109) / 2 * BIT, 161 * BIT, 52 * BIT, 1, {}),
        IdentifierAccount(
            0x7FF, False, 1, 214.0 * BIT, 214 * BIT, 159 * BIT, 0, {DropCause.OVERFLOW: 1}
        ),
    ]
