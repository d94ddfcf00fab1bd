"""EPOCH: the run on the buses and the date of its t = 0, its senders and its acceptance."""

from __future__ import annotations

import ctypes as c
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import pytest

from bridge.deployment.system import load_system
from bridge.native import epoch as native
from bridge.native.bus import Bus
from bridge.native.frame import Flags, Ring
from bridge.native.library import library
from bridge.native.message import Decoded, Header
from bridge.native.node import WALL, NodeStruct, functions
from bridge.native.pace import now
from bridge.native.safety import Status
from bridge.node.missing_inputs import report_missing_inputs
from bridge.realtime.host_clock import HostClock, host_clock
from bridge.wiring.wiring import WiredNode
from cosim.base.clock import realtime_ns, realtime_offset_ns
from tests.bridge.bench import PATIENCE, Bench, until
from tests.bridge.deployments import TELEOPERATION, named
from tests.bridge.gates import Gate

RUN, HOST, OTHER = 7, 3, 4
IDENTITY = 2.0**32 - 1
INACTIVE, ACTIVE = 1, 2
START, STOP = 1, 2
STATUS = int(Status.SIMULATED)
UNIT = 10_000  # ns
TURN = UNIT * 2**33


class Alone(Bench):
    """A bench whose node nobody supervises, on host HOST."""

    host = HOST

    def __enter__(self):
        self.struct.epoch.host, self.struct.epoch.follows = self.host, 1
        if self.host == HOST:
            self.struct.epoch.identity[:] = [IDENTITY, 0.0, 0.0, 0.0]
        return super().__enter__()

    def epoch(self, origin_ns, host=HOST, kept=0, status=Status.SIMULATED, run=RUN, apart=0.0):
        """EPOCH of a run with t = 0 at this time of the monotonic clock, and the date before it.

        `apart`: the sender's date from ours, s; None: it does not say its date.
        """
        off = realtime_offset_ns() + seconds(apart or 0.0)
        date = origin_ns + off
        header = Header(status=int(status))
        encoding = self.system.services["left"].epoch
        if apart is not None:
            said = native.values(host & 63, 0, False, now() + off)
            self.put("left", encoding.frame(said, header, now()))
        values = native.values(run, host, bool(kept), date)
        self.put("left", encoding.frame(values, header, now()))

    def nmt(self, command):
        frame = self.system.services["left"].nmt.frame([command, 0], Header(), now())
        self.put("left", frame)

    @property
    def epochs(self):
        return [x for x in self.said(self.system.services["left"].epoch) if x[0][1]]

    @property
    def dates(self):
        return [x for x in self.said(self.system.services["left"].epoch) if not x[0][1]]


def seconds(n):
    return round(n * 1e9)


# ---- bytes ------------------------------------------------------------------------------------


@pytest.mark.parametrize("deployment", ["can", "can-classic", "zenoh"])
@pytest.mark.parametrize("date", [0, 1_790_000_000_123_456_789, TURN - UNIT])
def test_what_is_said_is_what_is_heard(deployment, date):
    system = load_system(TELEOPERATION, deployment)
    encoding = next(s.epoch for s in system.services.values() if s.epoch)
    more = (0.0, 1.0, 2.0, 2.0**32 - 1) if deployment == "zenoh" else ()
    values = native.values(63, 255, True, date, more)
    data = encoding.encode(values, status=Status.SIMULATED, counter=5)
    result, heard, header = encoding.decode(data)
    assert result is Decoded.OK and list(heard) == values
    assert (header.counter, header.status) == (5, Status.SIMULATED)
    assert heard[3] == round((date % TURN) / UNIT) * 10


def test_on_can_it_is_eight_protected_bytes():
    encoding = load_system(TELEOPERATION, "can").services["left"].epoch
    data = encoding.encode([1, 2, 0, 30])
    assert (encoding.message.id, len(data), encoding.message.flags & Flags.FD) == (2, 8, 0)
    for bit in range(64):
        wrong = bytearray(data)
        wrong[bit // 8] ^= 1 << bit % 8
        assert encoding.decode(bytes(wrong))[0] is Decoded.CRC


def test_the_date_of_c_is_that_of_python():
    date = library().pace_date
    date.restype = c.c_int64
    assert abs(date() - (realtime_offset_ns())) < 50_000_000


# ---- who has which clock ------------------------------------------------------------------------


def test_processes_of_a_host_have_its_clock():
    assert host_clock().host == host_clock().host and 1 <= host_clock().number <= 255
    assert HostClock("a", kept=False).number != HostClock("b", kept=False).number


def test_a_host_says_what_keeps_its_date():
    assert "kept by no time server" in HostClock("a", kept=False).describe()
    assert "to 2 ms" in HostClock("a", kept=True, error=0.002).describe()


# ---- a node that waits --------------------------------------------------------------------------


def test_it_joins_a_run_that_it_hears_of(tmp_path):
    with Alone(tmp_path) as bench:
        said = []
        with report_missing_inputs(bench.wired, said.append, lambda: {"event": "ready"}):
            began = now() - seconds(3)
            bench.epoch(began)
            until(lambda: bench.struct.begun and bench.struct.slot > bench.struct.first + 2)
            until(lambda: any(e["event"] == "joined" for e in said))
        assert abs(bench.struct.start_ns - began) < 2_000_000
        assert bench.struct.first * bench.struct.h > 3.0
        assert bench.struct.epoch.run == RUN
        assert next(e for e in said if e["event"] == "joined")["t"] > 3.0


@pytest.mark.parametrize(
    ("ours", "theirs", "shared"), [(0, 0, False), (0, 1, False), (1, 0, False), (1, 1, True)]
)
def test_another_hosts_date_counts_where_both_are_kept(tmp_path, ours, theirs, shared):
    with Alone(tmp_path) as bench:
        bench.struct.epoch.kept = ours
        bench.epoch(now() - seconds(3), host=OTHER, kept=theirs)
        if shared:
            until(lambda: bench.struct.begun)
        else:
            until(lambda: bench.struct.epoch.unshared == 1)
        assert bool(bench.struct.epoch.origin_ns) == shared


@contextmanager
def waiting_master(folder):
    """The master's node over Zenoh, waiting; its wired node, and how to send it a frame."""
    system = load_system(TELEOPERATION, "zenoh", ["run.stop=60", "deploy.silence=0"])
    rx = Ring(4096)
    bus = Bus.from_rings(rx, Ring(4096), 0)
    wired = WiredNode(system, "master", {"net": bus}, folder / "journal", WALL)
    wired.struct.epoch.host, wired.struct.epoch.follows = HOST, 1
    with wired, ThreadPoolExecutor(1) as pool:
        pool.submit(functions().node_live, c.byref(wired.struct))
        try:
            yield wired, rx.put
        finally:
            wired.struct.quit = 1


@pytest.mark.parametrize("apart", [-3600.0, -10.0, 3.0, 250.0])
@pytest.mark.parametrize(("kept", "ahead"), [(0, -3.0), (0, 0.6), (1, 0.6)])
def test_on_can_the_date_of_a_host_is_compared_before_it_is_believed(tmp_path, kept, ahead, apart):
    """Its number is ours, as that of one host in 255; no sample of the run has come."""
    with Alone(tmp_path) as bench:
        bench.struct.epoch.kept = kept
        bench.epoch(now() + seconds(ahead), kept=kept, apart=apart)
        until(lambda: bench.struct.epoch.unshared == 1)
        assert bench.struct.epoch.origin_ns == 0 and not bench.struct.begun
        bench.epoch(now() + seconds(ahead), kept=kept)
        until(lambda: bench.struct.epoch.origin_ns)


@pytest.mark.parametrize("late", [0.0, -10.0, 10.0])
def test_without_a_date_a_run_that_has_begun_is_believed_by_its_samples(tmp_path, late):
    """A foreign participant that sends EPOCH alone."""
    with Alone(tmp_path, there=False) as bench:
        began, epoch = now() - seconds(20), bench.struct.epoch
        bench.epoch(began + seconds(late), apart=None)
        until(lambda: epoch.heard == 1)
        assert (epoch.origin_ns, epoch.unshared) == (0, 0)  # nothing speaks for it or against it
        codec = bench.system.messages["STATE_1"].encoding
        header = Header(status=ACTIVE | Status.SIMULATED, t_us=20_000_000)
        bench.put("left", codec.frame([*bench.q, 0.0, 0.0], header, now()))
        until(lambda: bench.wired.inlet_bindings.receptions["STATE_1"].early == 1)
        bench.epoch(began + seconds(late), apart=None)
        if late:
            until(lambda: epoch.unshared == 1)
            assert epoch.origin_ns == 0
        else:
            until(lambda: epoch.origin_ns)
            assert abs(epoch.origin_ns - began) < 50_000_000


def test_without_a_date_a_run_that_is_to_begin_begins_within_seconds(tmp_path):
    with Alone(tmp_path) as bench:
        bench.epoch(now() + seconds(9.5), apart=None)
        until(lambda: bench.struct.epoch.unshared == 1)
        bench.epoch(origin := now() + seconds(0.6), apart=None)
        until(lambda: bench.struct.epoch.origin_ns)
        assert abs(bench.struct.epoch.origin_ns - origin) < 50_000_000


def test_over_zenoh_hosts_of_one_number_are_told_apart_by_all_128_bits(tmp_path):
    """Before the first sample, and before a start."""
    with waiting_master(tmp_path) as (wired, put):
        epoch, encoding = wired.struct.epoch, wired.system.services["net"].epoch
        ours = HostClock("ours", kept=False).identity
        epoch.identity[:] = ours
        assert all(0 <= x < 2**32 for x in ours) and len(encoding.encode([0.0] * 8)) == 24 + 8 * 8

        def announce(ahead, identity):
            origin = now() + seconds(ahead)
            said = native.values(RUN, HOST, False, origin + realtime_offset_ns(), identity)
            put(encoding.frame(said, Header(status=int(Status.SIMULATED)), now()))
            return origin

        for n, ahead in enumerate((-9.5, 0.5), 1):
            announce(ahead, (*ours[:3], ours[3] + 1.0))
            until(lambda n=n: epoch.unshared == n)
            assert epoch.origin_ns == 0
        origin = announce(30.0, ours)
        until(lambda: epoch.origin_ns)
        assert abs(epoch.origin_ns - origin) < 50_000_000


def test_a_date_that_samples_contradict_is_not_believed(tmp_path):
    """Numbers of hosts have 8 bits: a stranger may have ours, and a date 10 s from ours."""
    with waiting_master(tmp_path) as (wired, put):
        services, codec = wired.system.services["net"], wired.system.messages["xi_slave"].encoding
        epoch, status = wired.struct.epoch, ACTIVE | Status.SIMULATED
        began = now() - seconds(20)

        def announce(origin):
            unknown = (0.0,) * 4  # it came over a gateway from CAN
            date = native.values(RUN, HOST, False, origin + realtime_offset_ns(), unknown)
            put(services.epoch.frame(date, Header(status=int(Status.SIMULATED)), now()))

        put(codec.frame([0.0, 0.0], Header(status=status, t_us=20_000_000), now()))
        until(lambda: wired.inlet_bindings.receptions["xi_slave"].early == 1)
        for wrong in (-10, 10):
            before = epoch.unshared
            announce(began + seconds(wrong))
            until(lambda before=before: epoch.unshared == before + 1)
            assert epoch.origin_ns == 0 and not wired.struct.begun
        announce(began)
        until(lambda: wired.struct.begun)
        assert abs(wired.struct.start_ns - began) < 2_000_000


def test_a_clock_that_is_not_known_well_enough_is_measured_again(tmp_path):
    """After each EPOCH; a machine that is busy now may answer in time a moment later."""
    said, tries = [], []

    def measured():
        tries.append(sum(e["event"] == "unshared" for e in said))
        return len(tries) == 5

    with (
        Alone(tmp_path) as bench,
        report_missing_inputs(bench.wired, said.append, lambda: {"event": "ready"}, measured),
    ):
        for n in range(1, 6):
            bench.epoch(now() - seconds(3), host=OTHER)
            until(lambda n=n: len(tries) == n)
    assert tries == [0, 0, 0, 1, 1]
    assert sum(e["event"] == "unshared" for e in said) == 1


def test_a_run_that_is_to_begin_is_not_joined_without_a_start(tmp_path):
    with Alone(tmp_path) as bench:
        origin = now() + seconds(0.4)
        bench.epoch(origin)
        until(lambda: bench.struct.epoch.origin_ns)
        until(lambda: now() > origin + seconds(0.3))
        assert not bench.struct.begun and bench.struct.start_ns == 0


def test_a_start_from_the_bus_has_the_origin_that_was_said(tmp_path):
    with Alone(tmp_path) as bench:
        origin = now() + seconds(0.6)
        bench.epoch(origin)
        bench.nmt(START)
        until(lambda: bench.struct.begun)
        assert abs(bench.struct.start_ns - origin) < 2_000_000
        assert (bench.struct.first, bench.struct.epoch.run) == (0, RUN)


def test_a_start_without_epoch_is_as_before(tmp_path):
    with Alone(tmp_path) as bench:
        until(lambda: not bench.wired.peers or bench.beats)
        bench.nmt(START)
        until(lambda: bench.struct.begun)
        assert (bench.struct.first, bench.struct.epoch.run) == (0, 0)


def test_a_node_with_a_supervisor_waits_for_it(tmp_path):
    with Alone(tmp_path) as bench:
        bench.struct.epoch.follows = 0
        bench.epoch(now() - seconds(3))
        until(lambda: bench.struct.epoch.origin_ns and not bench.struct.epoch.running)
        assert bench.struct.start_ns == 0


def test_who_was_told_to_stop_stays_away_until_a_start(tmp_path):
    with Alone(tmp_path) as bench:
        bench.nmt(STOP)
        until(lambda: not bench.struct.epoch.follows)
        bench.epoch(began := now() - seconds(3))
        until(lambda: bench.struct.epoch.origin_ns and not bench.struct.epoch.running)
        assert bench.struct.start_ns == 0
        bench.nmt(START)
        until(lambda: bench.struct.begun)
        assert abs(bench.struct.start_ns - began) < 2_000_000


def test_where_drives_are_real_a_simulated_run_is_none_and_arm_comes_first(tmp_path):
    with Alone(tmp_path, real=True) as bench:
        bench.epoch(now() - seconds(3))  # simulated
        bench.epoch(now() - seconds(3), status=0, run=RUN + 1)
        until(lambda: bench.struct.epoch.told == RUN + 1 and not bench.struct.epoch.running)
        assert bench.struct.start_ns == 0
        until(lambda: not functions().node_unheard(c.byref(bench.struct), 0))
        bench.control.arm()
        until(lambda: bench.struct.life.armed)
        bench.epoch(now() - seconds(3))  # simulated
        bench.epoch(now() - seconds(3), status=0, run=RUN + 2)
        until(lambda: bench.struct.start_ns)
        assert bench.struct.epoch.run == RUN + 2


def test_who_is_to_start_at_once_takes_the_start_of_another(tmp_path):
    with Alone(tmp_path) as bench:
        bench.epoch(origin := now() + seconds(0.6))
        until(lambda: bench.struct.epoch.origin_ns)
        bench.control.begin(0.5)
        until(lambda: bench.struct.begun)
        assert abs(bench.struct.start_ns - origin) < 2_000_000
        assert bench.struct.epoch.run == RUN


def test_a_node_that_has_heard_no_epoch_starts_after_its_lead():
    """Also within a second of the boot, when the monotonic clock itself is less than a second."""
    node = NodeStruct()
    origin = functions().node_origin
    assert origin(c.byref(node), seconds(0.4), seconds(0.5)) == seconds(0.9)
    node.epoch.origin_ns, node.epoch.heard_ns = seconds(5), seconds(4)
    assert origin(c.byref(node), seconds(4.9), seconds(0.5)) == seconds(5)
    assert origin(c.byref(node), seconds(5), seconds(0.5)) == seconds(5)
    assert origin(c.byref(node), seconds(5) + 1, seconds(0.5)) == seconds(5.5) + 1


def test_who_starts_at_once_says_when(tmp_path):
    with Alone(tmp_path) as bench:
        bench.control.begin(0.5)
        until(lambda: bench.struct.begun)
        until(lambda: bench.epochs)
        (values, _), *others = bench.epochs
        date = bench.struct.start_ns + realtime_offset_ns()
        assert abs(values[3] * 1000 - date % TURN) < 50_000_000
        assert values[0] == bench.struct.epoch.run > 0 and values[1] == HOST and not others
        (named, _), (dated, _) = bench.dates  # before it, who sends it and its date
        assert list(named) == [HOST & 63, 0, 1, 10 * IDENTITY]
        assert (dated[0], dated[2]) == (HOST & 63, 0)
        assert dated[3] * 1000 < values[3] * 1000 < dated[3] * 1000 + seconds(PATIENCE)


@pytest.mark.parametrize("kept", [0, 1])
@pytest.mark.parametrize("same", [True, False])
def test_two_hosts_on_can_with_one_number_are_told_apart(tmp_path, same, kept):
    """A node hears the EPOCH of a node whose host has the same number, and HOST before it."""
    ours = HostClock("ours", kept=False)
    sender = ours if same else namesake(ours)
    with of(Alone(tmp_path), sender, kept) as bench:
        bench.control.begin(2.0)
        until(lambda: bench.epochs)
        number = bench.system.services["left"].epoch.message.id
        said = [frame for bus, frame in bench.sent if (bus, frame.id) == ("left", number)]
    with of(Alone(tmp_path), ours, kept) as waiting:
        for frame in said:
            frame.t_ns = now()
            waiting.put("left", frame)
        epoch = waiting.struct.epoch
        until(lambda: epoch.heard == len(said) == 3)
        until(lambda: epoch.origin_ns or epoch.unshared)
        assert bool(epoch.origin_ns) == (same or bool(kept))


def namesake(ours, other="other"):
    """The clock of another host whose number is that of ours."""
    names = (HostClock(f"{other}{i}", kept=False) for i in range(10_000))
    return next(host for host in names if host.number == ours.number)


def through_gateway(folder, sender, gateway, kept):
    """The frames on CAN of an EPOCH that a host says on Zenoh; `kept`: of (sender, gateway)."""
    with Gate(named("gateway", "run.stop=1000"), "left_gateway", folder, start=False) as gate:
        of(gate, gateway, kept[1])
        origin = now() + seconds(0.6)
        said = native.values(
            RUN, sender.number, bool(kept[0]), origin + realtime_offset_ns(), sender.identity
        )
        gate.put("net", gate.system.services["net"].epoch.frame(said, Header(status=STATUS)))
        epoch = gate.system.services["left"].epoch
        values = [said for said, _ in gate.forwarded(epoch, "left")]
        assert gate.frames(gate.system.services["net"].epoch, "net") == []
    return origin, [epoch.frame(one, Header(status=STATUS)) for one in values], values


@pytest.mark.parametrize("kept", [(0, 0), (0, 1), (1, 0), (1, 1)])
@pytest.mark.parametrize("where", ["sender's", "another"])
def test_a_gateway_names_the_host_of_an_epoch_from_zenoh(tmp_path, where, kept):
    """It is on another host than the sender; DATE is of use where both hosts have one clock."""
    sender = HostClock("sender", kept=False)
    gateway = sender if where == "sender's" else namesake(sender)
    origin, _, (host, *dated, epoch) = through_gateway(tmp_path, sender, gateway, kept)
    number = sender.number & 63
    assert host == [number, 0, 1, 10 * sender.identity[0]]
    assert len(dated) == (gateway is sender or kept == (1, 1))
    date = (origin + realtime_offset_ns()) % TURN
    for one in dated:
        assert one[:3] == [number, 0, 0] and abs(one[3] * 1000 - date) < seconds(PATIENCE)
    assert epoch[:3] == [RUN, sender.number, kept[0]]
    assert abs(epoch[3] * 1000 - date) < 50_000_000


def test_a_gateway_passes_the_epoch_of_can_on_as_it_is(tmp_path):
    """HOST and DATE are frames of their own, which go to Zenoh like any EPOCH, and on to CAN."""
    system = named("gateway", "run.stop=1000")
    with Gate(system, "right_gateway", tmp_path, start=False) as gate:
        encodings = [system.services[bus].epoch for bus in ("net", "right")]
        clock = HostClock("sender", kept=False)
        date = realtime_ns()
        said = [*native.before(clock.number, date, clock.identity),
                native.values(RUN, clock.number, False, date)]  # fmt: skip
        for one in said:
            gate.put("net", encodings[0].frame([*one, *[0.0] * (8 - len(one))], Header()))
        found = []
        until(lambda: found.extend(gate.frames(encodings[1], "right")) or len(found) >= 3)
        found += gate.frames(encodings[1], "right", 0.1)
        assert [values for values, _ in found] == said


@pytest.mark.parametrize("gateway", ["sender", "receiver", "third"])
@pytest.mark.parametrize("same", [True, False])
def test_behind_a_gateway_an_epoch_counts_on_the_host_of_its_sender(tmp_path, same, gateway):
    """All numbers are equal; the gateway is on the host of either, or on a third one."""
    sender = HostClock("sender", kept=False)
    receiver = sender if same else namesake(sender)
    hosts = {"sender": sender, "receiver": receiver, "third": namesake(sender, "third")}
    origin, frames, _ = through_gateway(tmp_path, sender, hosts[gateway], (0, 0))
    (tmp_path / "receiver").mkdir()
    with of(Alone(tmp_path / "receiver"), receiver, 0) as waiting:
        for frame in frames:
            frame.t_ns = now()
            waiting.put("left", frame)
        epoch = waiting.struct.epoch
        until(lambda: epoch.heard == len(frames))
        until(lambda: epoch.origin_ns or epoch.unshared)
        assert bool(epoch.origin_ns) == same
        if same:
            assert abs(epoch.origin_ns - origin) < 50_000_000


def of(bench, clock, kept):
    """A bench on a host with this clock."""
    epoch = bench.struct.epoch
    bench.host = epoch.host = clock.number
    epoch.identity[:], epoch.kept = clock.identity, kept
    return bench


# ---- a node that runs -------------------------------------------------------------------------


def test_it_tells_a_peer_that_waits_which_run_this_is(tmp_path):
    with Alone(tmp_path) as bench:
        bench.begin()
        before = len(bench.epochs)
        bench.there = False

        def answered():
            bench.beat(1, INACTIVE)
            return len(bench.epochs) > before

        until(answered)
        values, header = bench.epochs[-1]
        date = bench.struct.start_ns + realtime_offset_ns()
        assert abs(values[3] * 1000 - date % TURN) < 50_000_000
        assert header.status & Status.SIMULATED


def test_it_says_nothing_while_nobody_waits(tmp_path):
    with Alone(tmp_path) as bench:
        bench.begin()
        before = len(bench.epochs)
        until(lambda: bench.struct.slot > 200)
        assert len(bench.epochs) == before


def test_a_run_that_runs_is_not_moved(tmp_path):
    with Alone(tmp_path) as bench:
        bench.begin()
        start = bench.struct.start_ns
        bench.epoch(now() - seconds(3))
        slot = bench.struct.slot
        until(lambda: bench.struct.slot > slot + 20)
        assert bench.struct.start_ns == start and not bench.struct.epoch.origin_ns


def test_a_frame_that_is_damaged_is_not_believed(tmp_path):
    with Alone(tmp_path) as bench:
        encoding = bench.system.services["left"].epoch
        frame = encoding.frame(native.values(1, HOST, True, realtime_ns()), Header(), now())
        frame.data[5] ^= 1
        bench.put("left", frame)
        bench.nmt(START)
        until(lambda: bench.struct.begun)
        assert not bench.struct.epoch.origin_ns
