"""Rates that rise until a path breaks: by losses, by a queue, or by this host."""

import json
from pathlib import Path

import numpy as np
import pytest

from bridge.cli.paths.path import PathRequest
from bridge.cli.paths.several import ping_ramp
from bridge.ping.figures import PathResult, evaluate
from bridge.ping.measure import PingResponder
from bridge.ping.ramp import HIGHEST, RampStep, ramp
from bridge.ping.udp import UdpPath
from tests.bridge.ping.test_paths import answering
from tests.bridge.ping.test_watch import FakePath


def path(rate: float, *, lost: float = 0.0, queue: float = 0.0, sends: float = 1e9) -> PathResult:
    """400 questions; of their delays, 4 ms, each is `queue` s longer than the one before."""
    fake = FakePath(period_ns=round(1e9 / min(rate, sends)))
    for k in range(400):
        fake.ask(1, lost=k < 400 * lost, delay=4e-3 + k * queue)
    return evaluate(fake.record)


def test_the_rate_between_holding_and_breaking_is_found() -> None:
    told: list[RampStep] = []
    found = ramp(lambda rate: path(rate, lost=0.3 * (rate > 1000)), 100, told.append)
    assert [s.rate for s in told[:5]] == [100, 200, 400, 800, 1600] and len(told) == 9
    assert found.holds <= 1000 < (found.breaks or 0) < 1.05 * found.holds
    assert found.why == "30.0% lost" and [s.rate for s in found.steps] == sorted(
        s.rate for s in told
    )
    assert found.text(128).startswith(f"holds at {found.holds:.5g} a second (") and (
        f"{1.024 * found.holds:.4g} kbit/s" in found.text(128)
    )


def test_a_queue_that_grows_breaks_a_path_without_losses() -> None:
    found = ramp(lambda rate: path(rate, queue=1e-4 * (rate > 1000)), 100, lambda _: None)
    assert found.holds <= 1000 < (found.breaks or 0) and "round trips grow to" in found.why


def test_losses_at_the_first_rate_are_no_sign_of_a_limit() -> None:
    found = ramp(lambda rate: path(rate, lost=0.008), 100, lambda _: None)
    assert found.breaks is None and found.holds == HIGHEST
    assert found.text(1) == (
        "holds at 20000 a second (160 kbit/s of payload each way); higher rates were not tried"
    )


def test_a_host_that_is_too_slow_is_said_to_be_the_limit() -> None:
    found = ramp(lambda rate: path(rate, sends=500), 100, lambda _: None)
    assert found.holds == 400 and found.breaks is None and len(found.steps) == 4
    assert found.why == "this host cannot send more than 500 a second"
    assert found.steps[-1].text.endswith("not sent at this rate")
    none = ramp(lambda rate: path(rate, lost=0.5), 100, lambda _: None)
    assert none.text(1) == "does not even hold at 100 a second: 50.0% lost"


def test_the_command_reaches_a_limit_of_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    end = UdpPath(("127.0.0.1", 0), listen=True)
    with answering(PingResponder(end)):
        request = PathRequest("udp", f"127.0.0.1:{end.port}", 2000, 100, 0.02, tmp_path)
        ping_ramp(request, tmp_path / "said.json")
    end.close()
    found = json.loads((tmp_path / "said.json").read_text("utf-8"))
    rates = [step["rate"] for step in found["steps"]]
    assert rates[0] == 2000 and rates == sorted(rates)
    assert found["holds"] in (0, *rates) and found["breaks"] in (None, *rates) and found["why"]
    assert all(np.isfinite(step["p50"]) for step in found["steps"])
