"""Delays that a simulated bus gave: in order, again from the start, and what is known of them."""

from fractions import Fraction

import numpy as np
import pytest

from cosim.base.errors import ScenarioError
from cosim.base.random_numbers import generator
from cosim.links.traces import BusDelays

DELAY = np.array([0.003, np.inf, 0.001, 0.002])


def test_the_delays_come_in_order_and_again_from_the_start():
    law = BusDelays(DELAY)
    stream = law.stream(Fraction(1, 100), generator(1, "not asked"))
    found = np.concatenate([stream.take(n) for n in (1, 2, 0, 6)])
    assert found.tolist() == np.tile(DELAY, 3)[:9].tolist()
    assert law.limit(Fraction(1, 100)) == len(DELAY)


def test_what_is_known_of_them_leaves_out_what_was_lost():
    law = BusDelays(DELAY, {"bus": "can0"})
    assert (law.minimum, law.mean, law.maximum) == (0.001, pytest.approx(0.002), 0.003)
    assert law.loses_packets and not BusDelays(DELAY[2:]).loses_packets
    assert law.facts()["bus"] == "can0"
    assert law.facts()["sha256"] != BusDelays(DELAY[::-1]).facts()["sha256"]
    with pytest.raises(ScenarioError, match="bus can0: found no frame None that arrives"):
        BusDelays(DELAY[1:2], {"bus": "can0"})
