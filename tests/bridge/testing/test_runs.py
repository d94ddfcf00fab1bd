"""Fixtures as this project's own tests have them: buses, twins, limits."""

from __future__ import annotations

import shlex
import subprocess
from contextlib import ExitStack
from pathlib import Path
from time import monotonic

import can
import numpy as np
import pytest

import cosim
from bridge.simulated_can.local_channel import channel_names
from bridge.testing.buses import CanBuses
from bridge.testing.case import PytestCase
from bridge.testing.limit import TimeLimitError, time_limit
from tests.cli.command import CALL

ROOT = Path(__file__).resolve().parents[3]
CONFIG = ROOT / "configs" / "teleoperation.toml"


def message(identifier: int, data: bytes = b"") -> can.Message:
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False)


def test_buses_of_a_test_are_apart_and_their_frames_take_time(can_bus) -> None:
    a, b = can_bus()
    c, d = can_bus(bitrate=125_000)
    a.send(message(1))
    c.send(message(2))
    first, second = b.recv(1.0), d.recv(1.0)
    assert (first.arbitration_id, second.arbitration_id) == (1, 2)
    assert second.timestamp == pytest.approx(4 * first.timestamp, rel=0.1)  # a quarter of the rate
    assert b.recv(0.1) is None and d.recv(0.1) is None


def test_buses_are_closed_after_their_test(tmp_path: Path) -> None:
    case = PytestCase("t.py::test_x", tmp_path, tmp_path / "t.py", tmp_path / "cosim")
    with ExitStack() as closing:
        (bus,) = CanBuses(case, closing)(1)
        assert "t.py::test_x#1" in channel_names()
    assert "t.py::test_x#1" not in channel_names()
    with pytest.raises(can.CanOperationError):
        bus.send(message(1))


def test_random_errors_of_a_bus_come_from_the_name_of_the_test(tmp_path: Path) -> None:
    def arrivals(name: str) -> list[float]:
        case = PytestCase(name, tmp_path, tmp_path / "t.py", tmp_path / "cosim")
        with ExitStack() as closing:
            a, b = CanBuses(case, closing)(error_rate=2e-3)
            for i in range(30):
                a.send(message(i, b"eight by"))
            return [b.recv(1.0).timestamp for _ in range(30)]

    first = arrivals("t.py::test_x")
    assert arrivals("t.py::test_x") == first
    assert arrivals("t.py::test_y") != first


def test_a_twin_is_that_of_the_command(twin, tmp_path: Path) -> None:
    changes = {"run.stop": "0.3 s", "deploy.latency": False}
    run = twin(CONFIG, "can", set=changes)
    assert run.has_no_faults() and run.metadata["scenario"]["run"]["seed"] != 0
    words = shlex.split(run.metadata["command"])
    assert words[0] == "cosim"
    call = [*CALL, *words[1:], "--out", str(tmp_path / "again"), "--no-plot"]
    subprocess.run(call, check=True, capture_output=True, timeout=120)
    assert run.is_identical_to(tmp_path / "again")
    late = twin(CONFIG, "can", set=changes | {"deploy.latency": True})
    assert not run.is_identical_to(late)
    assert not np.array_equal(run["slave.q"], late["slave.q"])


def test_a_limit_ends_python_code_and_leaves_what_comes_next_alone() -> None:
    too_long = pytest.raises(TimeLimitError, match=r"took longer than its limit of 0\.05 s")
    with too_long, time_limit("50 ms"):
        while True:
            pass
    begin = monotonic()
    with time_limit(60):
        assert True
    assert monotonic() - begin < 30  # the timer is not waited for
    with pytest.raises(ZeroDivisionError), time_limit(60):
        _ = 1 / 0
    with pytest.raises(cosim.CosimError, match="limit"), time_limit("3 m"):
        pass
