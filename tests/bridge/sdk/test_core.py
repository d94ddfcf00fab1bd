"""The C core of a participant, rule by rule, in a time that the test moves: slave_control."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from bridge.can.codec import Codec
from bridge.deployment.system import load_system
from bridge.native.message import Decoded
from tests.bridge.deployments import TELEOPERATION
from tests.bridge.sdk.bench import IDENTITY, MS, Bench, library, needs_cc

pytestmark = needs_cc
SHORT = ("run.stop=1",)
STATE, LINK, BEAT = [0.1, 0.2, 0.3, 0.4], 0x3A4, 0x704
INACTIVE, ACTIVE, STOPPING, FAULT, FINISHED = range(1, 6)
START, STOP, ARM, RESET = 1, 2, 128, 129


@pytest.fixture(scope="module")
def core(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return library(tmp_path_factory.mktemp("core") / "c", "can", "slave_control", *SHORT)


@pytest.fixture
def bench(core: Path) -> Bench:
    return Bench(core, load_system(TELEOPERATION, "can", SHORT), "slave_control")


def alive(bench: Bench, until: int, life: int = INACTIVE, start: int = 0) -> None:
    """The other nodes live until `until` (ns): heartbeats, samples, of the run from `start` on."""
    for t in range(bench.now, until, 5 * MS):
        bench.run(t)
        if t % (20 * MS) == 0:
            bench.beat("slave", life, t // MS)
            bench.beat("master", life, t // MS) if "left" in bench.buses else None
            bench.beat("master_control", life, t // MS)
        j = (t - start) // (5 * MS) if life == ACTIVE else 0
        if j >= 0:
            bench.sample("STATE_3", STATE, j, life)
            bench.sample("LINK_2", STATE, j, life)
    bench.run(until)


def running(bench: Bench, origin: int = 700 * MS) -> None:
    """It is started, and 100 ms of the run are over."""
    alive(bench, 200 * MS)
    bench.epoch("right", origin)
    bench.nmt("right", START, 4)
    alive(bench, origin)
    alive(bench, origin + 100 * MS, ACTIVE, origin)


def test_before_the_start_it_sends_heartbeats_and_previews(bench: Bench) -> None:
    bench.run(100 * MS)
    beats, previews = bench.of(BEAT), bench.of(LINK)
    assert [s.t // MS for s in beats] == [
        0,
        0,
        20,
        20,
        40,
        40,
        60,
        60,
        80,
        80,
        100,
        100,
    ]  # two buses
    assert {s.bus for s in beats} == {"left", "right"} and {s.bus for s in previews} == {"right"}
    _, counter, status, t_us = struct.unpack_from("<HBBI", previews[-1].data)
    assert (counter, status, t_us) == (0, 0x80 | INACTIVE, 500)
    assert previews[-1].data[8:16] == bytes(8)  # torque 0
    assert not bench.steps


def test_start_takes_t_0_of_the_epoch_before_it(bench: Bench) -> None:
    running(bench)
    samples = [s for s in bench.of(LINK) if s.data[3] & 7 == ACTIVE]
    assert samples[0].t == 700 * MS + 500_000  # phase 0.5 ms
    assert [s.data[2] for s in samples] == list(range(20))
    assert [struct.unpack_from("<I", s.data, 4)[0] for s in samples] == [
        500 + 5000 * j for j in range(20)
    ]
    assert bench.steps == pytest.approx([0.005 * j for j in range(20)])
    encoding = bench.system.messages["LINK_4"].encoding
    assert isinstance(encoding, Codec)
    assert all(encoding.decode(s.data)[0] is Decoded.OK for s in samples)


def test_start_without_epoch_is_100_ms_after_its_arrival(bench: Bench) -> None:
    alive(bench, 200 * MS)
    bench.nmt("right", START, 0)
    alive(bench, 400 * MS)
    first = next(s for s in bench.of(LINK) if s.data[3] & 7 != INACTIVE)
    assert first.t == 300 * MS + 500_000


@pytest.mark.parametrize(
    ("host", "kept", "shift", "believed"),
    [
        (77, False, 0, True), (78, False, 0, False), (78, True, 0, False),
        (77, False, 9000 * MS, False),
    ],
)  # fmt: skip
def test_an_epoch_of_another_host_is_not_believed(
    bench: Bench, host: int, kept: bool, shift: int, believed: bool
) -> None:
    """Without a time server at both ends, and not of a t = 0 that is more than 5 s ahead."""
    alive(bench, 200 * MS)
    bench.epoch("right", 700 * MS + shift, host, kept)
    bench.nmt("right", START)
    alive(bench, 1000 * MS)
    first = next(s for s in bench.of(LINK) if s.data[3] & 7 != INACTIVE)
    assert (first.t == 700 * MS + 500_000) is believed
    assert believed or first.t == 300 * MS + 500_000


def test_a_start_is_refused_where_a_required_peer_is_missing(bench: Bench) -> None:
    for t in range(0, 400 * MS, 5 * MS):
        bench.run(t)
        bench.sample("STATE_3", STATE, 0, INACTIVE)
        bench.sample("LINK_2", STATE, 0, INACTIVE)
        if t == 200 * MS:
            bench.nmt("right", START)
    assert not bench.steps and bench.state() == INACTIVE


def test_commands_for_others_are_not_obeyed(bench: Bench) -> None:
    alive(bench, 200 * MS)
    bench.nmt("right", START, 3)
    alive(bench, 500 * MS)
    assert not bench.steps


def test_an_emergency_stop_ramps_down_and_is_passed_on_ten_times(bench: Bench) -> None:
    running(bench)
    before = bench.now
    bench.hear("left", 1, b"")  # any length
    alive(bench, before + 300 * MS, ACTIVE, 700 * MS)
    assert bench.state() == FAULT
    first = next(s for s in bench.of(LINK) if s.t > before)
    assert first.t - before <= 5 * MS and first.data[3] & 7 == STOPPING and first.data[3] & 0x10
    passed = [s for s in bench.of(1) if s.bus == "right"]
    assert len(passed) == 10 and passed[0].data[0] == 4 and passed[0].data[1] & 2
    bench.nmt("right", START)
    alive(bench, before + 400 * MS, ACTIVE, 700 * MS)
    assert bench.state() == FAULT  # it is latched
    bench.nmt("right", RESET)
    alive(bench, before + 500 * MS, ACTIVE, 700 * MS)
    assert bench.state() == INACTIVE


@pytest.mark.parametrize("flags", [0x08, 0x10])
def test_a_remote_or_extended_frame_is_no_emergency_stop(bench: Bench, flags: int) -> None:
    running(bench)
    bench.hear("left", 1, b"", flags)
    alive(bench, bench.now + 60 * MS, ACTIVE, 700 * MS)
    assert bench.state() == ACTIVE


def test_a_stop_ends_it_after_the_ramp(bench: Bench) -> None:
    running(bench)
    before = bench.now
    bench.nmt("right", STOP)
    alive(bench, before + 200 * MS, ACTIVE, 700 * MS)
    assert bench.due == -1 and bench.state() == INACTIVE
    assert bench.of(LINK)[-1].t - before == pytest.approx(100 * MS, abs=10 * MS)


def test_silence_of_an_input_stops_it(bench: Bench) -> None:
    running(bench)
    before = bench.now
    for t in range(before, before + 400 * MS, 20 * MS):
        bench.run(t)
        bench.beat("slave", ACTIVE, t // MS)
    stopped = next(s for s in bench.of(LINK) if s.data[3] & 7 == STOPPING)
    assert 95 * MS < stopped.t - before < 115 * MS and stopped.data[3] & 0x40  # stop = "100 ms"
    assert bench.state() == FAULT


def test_silence_of_a_required_peer_stops_it(bench: Bench) -> None:
    running(bench)
    before = bench.now
    for t in range(before, before + 400 * MS, 5 * MS):
        bench.run(t)
        bench.sample("STATE_3", STATE, (t - 700 * MS) // (5 * MS), ACTIVE)
    stopped = next(s for s in bench.of(LINK) if s.data[3] & 7 == STOPPING)
    assert 120 * MS < stopped.t - before < 165 * MS  # within 150 ms of the last heartbeat
    assert bench.state() == FAULT


def test_damaged_repeated_and_absurd_samples_are_not_used(bench: Bench) -> None:
    running(bench)
    number = (bench.now - 700 * MS) // (5 * MS)
    bench.lib.participant_input.restype = bench.lib.participant_output.restype
    held = bench.lib.participant_input(bench.p, 1)
    assert held[0] == pytest.approx(0.1, abs=1e-6)
    encoding = bench.system.messages["STATE_3"].encoding
    assert isinstance(encoding, Codec)
    data = bytearray(encoding.encode([9.0, 9.0, 9.0, 9.0], 0x82, 5000 * number, number))
    data[10] ^= 1
    bench.hear("right", 0x4A3, bytes(data), 3)  # the check sum
    bench.sample("STATE_3", [0.2] * 4, number - 1)  # repeated
    bench.sample("STATE_3", [float("nan")] * 4, number)  # invalid
    bench.sample("STATE_3", [60.0] * 4, number)  # beyond 50 rad
    bench.sample("STATE_3", [0.2] * 4, number + 100)  # ahead of its time
    assert held[0] == pytest.approx(0.1, abs=1e-6)
    bench.sample("STATE_3", [0.2] * 4, number)
    assert held[0] == pytest.approx(0.2, abs=1e-6)


def test_the_end_has_no_torque_and_is_finished(bench: Bench) -> None:
    running(bench)
    alive(bench, 1800 * MS, ACTIVE, 700 * MS)
    assert bench.due == -1 and bench.state() == FINISHED
    last = bench.of(LINK)[-1].data
    assert len(bench.steps) == 200 and last[8:16] == bytes(8) and last[3] & 7 == FINISHED


def test_a_run_that_is_on_is_joined_by_its_epoch(bench: Bench) -> None:
    for t in range(0, 300 * MS, 5 * MS):
        bench.run(t)
        j = (t + 300 * MS) // (5 * MS)
        bench.beat("slave", ACTIVE, j)
        bench.sample("STATE_3", STATE, j)
        bench.sample("LINK_2", STATE, j)
        if t == 100 * MS:
            bench.epoch("right", -300 * MS)
    assert bench.steps[0] == pytest.approx(0.465, abs=0.015)  # 50 ms and two slots later
    first = next(s for s in bench.of(LINK) if s.data[3] & 7 == ACTIVE)
    assert first.data[2] == round(bench.steps[0] / 0.005)


@pytest.mark.parametrize(
    ("number", "identity", "ago", "joins"),
    [(77, IDENTITY, 0, True), (77, IDENTITY + 1, 0, False), (77, IDENTITY + 1, 1000, True),
     (76, IDENTITY + 1, 0, True)],
)  # fmt: skip
def test_the_frame_host_before_an_epoch_tells_hosts_apart(
    bench: Bench, number: int, identity: int, ago: int, joins: bool
) -> None:
    alive(bench, 1100 * MS - ago * MS)
    bench.host("right", number, identity)
    alive(bench, 1100 * MS)
    assert joined(bench) == joins


@pytest.mark.parametrize("apart", [0, 700_000 * MS])
@pytest.mark.parametrize("named", [False, True])
def test_a_date_before_a_host_frame_belongs_to_another_epoch(
    bench: Bench, apart: int, named: bool
) -> None:
    alive(bench, 1100 * MS)
    bench.date("right", 77, apart)
    if named:
        bench.host("right", 77, IDENTITY)
    assert joined(bench) == (named or apart == 0)


def joined(bench: Bench) -> bool:
    """True if it joins a run that is on for 0.3 s, when its EPOCH comes."""
    for t in range(bench.now, 1500 * MS, 5 * MS):
        bench.run(t)
        j = (t - 800 * MS) // (5 * MS)
        bench.beat("slave", ACTIVE, j)
        bench.sample("STATE_3", STATE, j)
        bench.sample("LINK_2", STATE, j)
        if t == 1105 * MS:
            bench.epoch("right", 800 * MS)
    return bool(bench.steps)


def test_it_tells_a_waiting_peer_which_run_is_on(bench: Bench) -> None:
    running(bench)
    alive(bench, 1300 * MS, ACTIVE, 700 * MS)
    assert not bench.of(2)
    bench.beat("slave", INACTIVE, 1)
    bench.run(bench.now + 10 * MS)
    host, date, epoch = (s.data for s in bench.of(2) if s.bus == "right")
    assert int.from_bytes(host[2:], "little") == 77 & 63 | 1 << 14 | IDENTITY << 15
    assert int.from_bytes(date[2:], "little") >> 6 & 255 == 0
    found = int.from_bytes(epoch[2:], "little")
    assert found >> 6 & 255 == 77
    assert found >> 15 == (1_790_000_000 * 100_000 + 70_000) % 2**33  # units of 10 us
