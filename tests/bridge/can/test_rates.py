"""Control rates of layouts, and simulated response times compared with those of the analysis."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.can.messages import BusMessage, bus_responses
from bridge.can.rates import control_rate, simulated_worst
from cosim.bus.timing import BusTiming
from cosim.record import Run
from tests.cli.command import Command

ROOT = Path(__file__).parents[3]
CLASSIC, FD = BusTiming(1e6), BusTiming(1e6, 5e6, True)


def motors(count: int, fd: bool, period: float = 2e-3) -> list[BusMessage]:
    """A command and a reply for each motor."""
    return [
        BusMessage(
            name=f"{what}_{i}",
            identifier=base + i,
            length=8,
            period=period,
            node="host" if base == 0 else f"motor {i}",
            bus="can0",
            fd=fd,
            brs=fd,
        )
        for i in range(1, count + 1)
        for base, what in ((0, "command"), (0x10, "reply"))
    ]


@pytest.mark.parametrize(
    ("count", "fd", "known"),
    [
        (6, False, 719), (7, False, 616), (8, False, 539), (9, False, 479),
        (6, True, 1659), (7, True, 1423), (8, True, 1242), (9, True, 1105),
    ],
)  # fmt: skip
def test_the_rate_of_motors_is_that_of_their_very_frames(count: int, fd: bool, known: int) -> None:
    """The known rates are of the bits of MIT frames of random motion; random data has fewer."""
    found = control_rate(motors(count, fd), FD if fd else CLASSIC)
    assert found is not None
    assert found.frames == 2 * count
    assert known <= found.mean < 1.01 * known


def test_the_worst_rate_has_the_most_stuff_bits() -> None:
    slow, fast = control_rate(motors(8, False), CLASSIC), control_rate(motors(8, True), FD)
    assert slow and fast
    assert slow.worst == pytest.approx(1e6 / (16 * 135), rel=1e-3)
    assert round(fast.worst) == 1120


def test_other_messages_take_their_share() -> None:
    alone = control_rate(motors(4, False), CLASSIC)
    other = BusMessage(name="log", identifier=0x700, length=8, period=0.01, node="x", bus="can0")
    beside = control_rate([*motors(4, False), other], CLASSIC)
    assert alone and beside
    assert beside.frames == alone.frames == 8
    assert beside.worst == pytest.approx(alone.worst * (1 - 135e-6 / 0.01), rel=1e-6)
    crowd = [
        BusMessage(name=f"x{i}", identifier=0x300 + i, length=8, period=3e-3, node="x", bus="b")
        for i in range(30)
    ]
    full = control_rate([*motors(1, False), *crowd], CLASSIC)
    assert full and full.worst == full.mean == 0.0
    assert control_rate([], CLASSIC) is None


@given(
    lengths=st.lists(st.integers(0, 8), min_size=1, max_size=12),
    periods=st.lists(st.sampled_from([2e-3, 5e-3, 0.01, 0.02]), min_size=12, max_size=12),
    seed=st.integers(0, 1000),
)
def test_no_simulated_response_is_longer_than_the_analysis(
    lengths: list[int], periods: list[float], seed: int
) -> None:
    messages = [
        BusMessage(
            name=f"m{i}", identifier=16 * i + 1, length=n, period=periods[i], node=f"n{i % 3}",
            bus="can0",
        )
        for i, n in enumerate(lengths)
    ]  # fmt: skip
    seen = simulated_worst(messages, CLASSIC, seed)
    for message, response in bus_responses(messages, CLASSIC):
        if response.worst is not None:
            assert seen[False, message.identifier] <= response.worst * 1e-9 + 1e-12


def test_what_is_never_sent_is_not_there() -> None:
    assert (False, 0x19) not in simulated_worst(motors(9, False, 8e-4), CLASSIC)


@pytest.fixture
def cosim(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """The command in this process, in the folder of the checkout."""
    monkeypatch.chdir(ROOT)
    return Command(monkeypatch, capsys)


def test_a_dbc_file_is_checked(cosim: Command) -> None:
    file = "configs/can/motors8.dbc"
    done = cosim("check", file, "--fd", "--data-bitrate", "5e6")
    assert done.code == 0, done.err
    assert "1246 Hz" in done.out and "1120 Hz" in done.out
    assert "0 errors" in done.out
    slow = cosim("check", file)
    assert slow.code == 1
    assert "543 Hz" in slow.out and "[bus-load]" in slow.out
    assert cosim("check", file, "--deploy", "can").code == 2
    assert "no-such.dbc" in cosim("check", "no-such.dbc").err


GRIPPERS = ("configs/openarm.toml", "--deploy", "openarm-grippers")


def test_two_openarms_with_grippers_have_the_rate_of_eight_motors(cosim: Command) -> None:
    done = cosim("check", *GRIPPERS)
    assert done.code == 0, done.err
    assert done.out.count("1246 Hz") == done.out.count("1120 Hz") == 2


@pytest.mark.slow
def test_a_gripper_closes_as_its_operator_wants_and_the_other_follows(
    cosim: Command, tmp_path: Path
) -> None:
    recorded = [f"{arm}{part}.q" for arm in ("master", "slave") for part in ("", "_gripper")]
    signals = f"run.record.signals={json.dumps(recorded)}"
    out = ("--out", tmp_path / "run", "--no-plot", "-q")
    ran = cosim("run", *GRIPPERS, "--set", "run.stop=2", "--set", signals, *out)
    assert ran.code == 0, ran.err
    run = Run.open(tmp_path / "run")
    assert run.array("master_gripper.q")[[0, -1], 0] == pytest.approx([-0.8, -0.1], abs=0.05)
    assert run.array("slave_gripper.q")[-1, 0] > -0.59  # after the delay
