"""The ring of the benchmark: the same bits of Euler's method here, by FMPy, and inside of FMUs."""

from __future__ import annotations

import pytest

from benchmarks import exchange_ring

pytestmark = pytest.mark.usefixtures("compiled_once")


@pytest.mark.parametrize("n", [2, 5])
def test_eulers_method_is_the_same_in_the_engine_in_fmpy_and_inside_of_the_fmu(n: int) -> None:
    euler = exchange_ring.ours(n, 300, exchange_ring.OURS["engine, euler"])[1]
    assert euler == exchange_ring.ours(n, 300, {})[1]
    assert euler == exchange_ring.theirs(n, 300)[1]
    assert euler != exchange_ring.ours(n, 300, exchange_ring.OURS["engine, heun"])[1]
