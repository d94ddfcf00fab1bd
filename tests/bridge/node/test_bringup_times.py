"""Bring-up, watching and feeding of drives, to the nanosecond: the test has clock and bus."""

from __future__ import annotations

import ctypes as c

import pytest

from bridge.native import node as native
from bridge.native.bus import Bus, BusKind
from bridge.native.commanded import Failure, Phase, Told
from bridge.native.frame import Flags, Frame, Ring
from bridge.native.safety import LifeState, Why
from bridge.wiring.wiring import WiredNode
from tests.bridge.deployments import named

MS = 1_000_000
NOT, STATE, ANSWER = range(3)  # of bringup_hear
DISABLED, ENABLED, HOT = 0, 1, 0xB
WRITE, READ, CLEAR, ENABLE, DISABLE = 0x55, 0x33, 0xFB, 0xFC, 0xFD
FEED = 0  # any other frame to a drive


class Host:
    """``master_control`` before its first slot, armed, on memory rings; two Damiao drives."""

    def __init__(self, folder, name="can-damiao"):
        system = named(name, "run.stop=0.2")
        names = system.buses_of("master_control")
        self.rings = {bus: (Ring(1024), Ring(1024)) for bus in names}
        buses = {
            bus: Bus.from_rings(*self.rings[bus], n, kind=BusKind.MEMORY)
            for n, bus in enumerate(names)
        }
        self.left = names.index("left")
        self.wired = WiredNode(system, "master_control", buses, folder / "journal", native.WALL)
        self.n, self.drives = self.wired.struct, self.wired.commanded.structs
        self.n.life.state, self.n.life.armed = LifeState.INACTIVE, 1

    def call(self, name, *arguments):
        return getattr(native.functions(), f"bringup_{name}")(c.byref(self.n), *arguments)

    def step(self, t, feed_all=1):
        return self.call("step", t, feed_all)

    def sent(self):
        """Frames sent on the left bus since the last call: (number of the drive, command)."""
        found, frame = [], Frame()
        while native.functions().ring_get(c.byref(self.rings["left"][1].struct), c.byref(frame)):
            data = frame.payload
            register = frame.id == 0x7FF
            special = data[7] if data[:7] == b"\xff" * 7 else FEED
            found.append((data[0] if register else frame.id, data[2] if register else special))
        return found

    def hear(self, number, t, *data, flags=0):
        frame = Frame.of(0x10 + number, bytes(data).ljust(8, b"\0"), flags)
        frame.t_ns, frame.bus = t, self.left
        return self.call("hear", c.byref(frame))

    def tell(self, number, state, t):
        """A drive tells its state."""
        return self.hear(number, t, state << 4 | number, 1, 2, 3, 4, 5, 6, 7)

    def register(self, number, t, value=1000):
        """A drive answers for its TIMEOUT."""
        return self.hear(number, t, number, 0, READ, 9, *value.to_bytes(4, "little"))

    def rise(self, t):
        """Both drives to the step that enables them, whose frame is sent at t + 4."""
        for k in range(3):
            self.step(t + k)
        self.register(1, t + 2)
        self.register(2, t + 2)
        self.step(t + 3)
        for number in (1, 2):
            self.tell(number, DISABLED, t + 4)
        self.step(t + 4)

    def serve(self, t):
        """Both drives are ready."""
        self.rise(t - 5)
        for number in (1, 2):
            self.tell(number, ENABLED, t)
        found = self.step(t)
        self.sent()
        return found

    def phases(self):
        return [Phase(d.phase) for d in self.drives]


@pytest.fixture
def host(tmp_path):
    found = Host(tmp_path)
    with found.wired:
        yield found


def test_each_step_follows_the_answer_to_the_one_before(host):
    t = 10 * MS
    assert host.step(t) == 0
    assert host.sent() == [(1, WRITE), (2, WRITE), (1, FEED), (2, FEED)]
    host.step(t + 1)  # the write has no answer
    assert host.sent() == [(1, READ), (2, READ)]
    host.step(t + 2)
    assert host.sent() == []
    assert host.register(1, t + 2) == ANSWER
    host.step(t + 3)
    assert host.sent() == [(1, CLEAR)]
    assert host.tell(1, DISABLED, t + 3) == STATE  # as old as the question
    host.step(t + 4)
    assert host.sent() == []
    host.tell(1, DISABLED, t + 4)
    host.step(t + 4)
    assert host.sent() == [(1, ENABLE)]
    host.tell(1, ENABLED, t + 5)
    assert host.step(t + 5) == 0
    assert host.phases() == [Phase.SERVING, Phase.RISING] and host.drives[0].up_ns == t + 5
    host.register(2, t + 6)
    for k, state in enumerate((DISABLED, ENABLED)):
        host.step(t + 7 + 2 * k)
        host.tell(2, state, t + 8 + 2 * k)
    assert host.step(t + 11) == native.ENABLED
    assert host.step(t + 12) == 0  # told once


def test_answers_count_only_where_they_were_asked_for(host):
    assert host.register(1, MS) != STATE and host.drives[0].answered == 0  # nothing was sent
    host.step(MS)
    assert host.register(1, MS) != STATE and host.drives[0].answered == 0  # another question
    host.step(MS + 1)
    assert host.drives[0].answered == 0
    assert host.tell(1, DISABLED, 3) == STATE  # while the answer of a register is awaited
    assert host.drives[0].answered == 0
    assert host.hear(3, 3, 3, 0, READ, 9, 0xE8, 3) == NOT  # no drive of this node
    assert host.hear(1, 3, 1, 0, READ, 10, 0xE8, 3) != STATE and host.drives[0].answered == 0
    assert host.register(1, 4) == ANSWER and host.drives[0].answered == 1


def test_a_wrong_value_and_a_wrong_format_of_an_answer_are_failures(host):
    host.step(MS)
    host.step(MS + 1)
    host.register(1, MS + 2, value=1001)
    host.hear(2, MS + 2, 2, 0, READ, 9, 0xE8, 3, flags=int(Flags.FD))
    assert [Failure(d.failure) for d in host.drives] == [Failure.VALUE, Failure.FORMAT]
    assert [d.failed_step for d in host.drives] == [1, 1]
    host.sent()
    host.step(MS + 3)
    assert host.sent() == [(1, DISABLE), (2, DISABLE)]
    host.step(MS + 4)
    assert host.sent() == []  # disabled once
    assert Why.DRIVE in Why(host.n.life.now)


def test_a_frame_without_an_answer_is_repeated_and_given_up_on_time(host):
    host.step(MS)
    host.sent()
    t = MS + 1
    host.step(t)
    assert host.sent() == [(1, READ), (2, READ)]
    host.step(t + 50 * MS - 1)
    assert (1, READ) not in host.sent()
    host.step(t + 50 * MS)
    assert host.sent()[:2] == [(1, READ), (2, READ)]
    host.step(t + 300 * MS)
    assert host.phases() == [Phase.RISING] * 2
    host.step(t + 300 * MS + 1)
    assert host.phases() == [Phase.FAILED] * 2
    assert [Failure(d.failure) for d in host.drives] == [Failure.ANSWER] * 2


def test_a_node_that_stood_still_gives_its_drives_their_time(host):
    """They were asked for nothing meanwhile, or could not answer."""
    host.step(MS)
    host.step(MS + 1)
    host.call("excuse", 200 * MS)
    host.step(1 + 501 * MS)
    assert host.phases() == [Phase.RISING] * 2
    host.register(2, 1 + 501 * MS)
    host.step(2 + 501 * MS)
    assert host.phases() == [Phase.FAILED, Phase.RISING]
    host.step(2 + 801 * MS)
    assert host.phases()[1] is Phase.RISING
    host.step(3 + 801 * MS)
    assert host.phases()[1] is Phase.FAILED  # the next step has no excuse


def test_silence_is_judged_on_time_and_not_for_what_the_node_stood_still(host):
    host.serve(MS)
    within = host.drives[0].within_ns
    assert within == 100 * MS
    host.tell(2, ENABLED, MS + within)
    host.call("watch", MS + within)
    assert host.phases() == [Phase.SERVING] * 2
    host.call("excuse", 7)
    host.call("watch", MS + within + 7)
    assert host.phases() == [Phase.SERVING] * 2
    host.call("watch", MS + within + 8)
    assert host.phases() == [Phase.FAILED, Phase.SERVING]
    assert Failure(host.drives[0].failure) is Failure.SILENT and host.drives[0].failed_step == -1


def test_states_are_read_by_the_first_row_that_fits(host):
    host.serve(MS)
    host.tell(1, HOT, 2 * MS)
    host.call("watch", 2 * MS)
    assert Failure(host.drives[0].failure) is Failure.STATE
    second = host.drives[1]
    second.n_told -= 1  # the last row is none of the table any more
    host.tell(2, 0xE, 2 * MS)
    assert second.row == -1
    second.n_told, second.row = 13, 0
    second.told[0].kind = Told.ENABLED
    host.call("watch", 2 * MS)
    assert second.phase == Phase.SERVING
    second.row = -1
    host.call("watch", 2 * MS)
    assert Failure(second.failure) is Failure.STATE


def test_the_number_of_another_drive_and_another_format_are_failures_at_any_time(host):
    host.serve(MS)
    host.hear(1, 2 * MS, ENABLED << 4 | 2)
    host.hear(2, 2 * MS, ENABLED << 4 | 2, flags=int(Flags.FD))
    assert [Failure(d.failure) for d in host.drives] == [Failure.NUMBER, Failure.FORMAT]
    failed = [d.failed_word for d in host.drives]
    host.tell(1, HOT, 3 * MS)
    assert [d.failed_word for d in host.drives] == failed  # it keeps why


def test_drives_are_fed_on_time_by_frames_of_their_message(host):
    host.serve(MS)
    t = host.n.fed_ns
    host.step(t + host.n.feed_ns - 1)
    assert host.sent() == []
    host.step(t + host.n.feed_ns, 0)  # the run feeds those that are ready
    assert host.sent() == [] and host.n.fed_ns == t + host.n.feed_ns
    host.step(t + 2 * host.n.feed_ns)
    assert host.sent() == [(1, FEED), (2, FEED)]
    outlets = host.n.outlets[: host.n.n_outlets]
    assert sum(o.sent for o in outlets) == 0
    host.n.begun = 1
    host.drives[1].feeds = 0
    host.step(t + 3 * host.n.feed_ns)
    assert host.sent() == [(1, FEED)]
    assert sorted(o.sent for o in outlets)[-2:] == [0, 1]


def test_drives_rest_where_the_node_is_not_armed_and_are_told_so_again_in_a_fault(host):
    host.n.life.armed = 0
    assert host.step(MS) == 0 and host.sent() == []  # they rest already
    host.n.life.armed = 1
    host.serve(2 * MS)
    host.n.life.state, host.n.life.armed = LifeState.FAULT, 0
    assert host.step(3 * MS) == native.DISABLED
    assert host.sent() == [(1, DISABLE), (2, DISABLE)]
    assert host.phases() == [Phase.RESTING] * 2
    assert host.step(103 * MS - 1) == 0 and host.sent() == []
    assert host.step(103 * MS) == native.DISABLED
    assert host.sent() == [(1, DISABLE), (2, DISABLE)]


@pytest.mark.parametrize("state", [LifeState.ACTIVE, LifeState.STOPPING])
def test_drives_of_a_node_that_runs_serve_and_none_is_brought_up(host, state):
    host.serve(MS)
    host.n.life.state, host.n.life.armed = state, 0
    host.drives[0].phase = Phase.RESTING
    host.step(2 * MS)
    assert host.phases() == [Phase.RESTING, Phase.SERVING]
    assert (1, ENABLE) not in host.sent()


def test_the_first_changes_are_kept_and_all_are_counted(host):
    host.n.drive_events.capacity = 3
    events = host.n.drive_events.events
    events[3].drive = 77
    host.serve(MS)
    assert host.n.drive_events.n > 3
    assert [events[k].drive for k in range(4)] == [0, 1, 0, 77]
    assert Phase(events[0].phase) is Phase.RISING and events[0].t_ns == MS - 5


# ---- positions ----


def positions(host, first, second):
    """The positions of both drives came at these times."""
    for index, t in enumerate((first, second)):
        (mine,) = [r for r in host.n.receptions[: host.n.n_receptions] if r.drive == index]
        mine.previewed_ns = t


def test_all_positions_have_to_be_of_now(host):
    host.serve(1000 * MS)
    t, old = 1000 * MS, 1000 * MS - 50 * MS
    positions(host, t, t)
    assert host.call("ready", t)
    for pair in ((old - 1, t), (t, old - 1), (-1, t)):
        positions(host, *pair)
        assert not host.call("ready", t), pair
    positions(host, old, old)
    assert host.call("ready", t)
    for drive in host.drives:
        drive.phase = Phase.RISING
        assert not host.call("ready", t)
        drive.phase = Phase.SERVING


def test_a_position_of_long_before_the_drive_was_ready_is_none(host):
    host.serve(1000 * MS)
    positions(host, 940 * MS, 940 * MS)
    for drive in host.drives:
        drive.up_ns = 990 * MS
    assert host.call("ready", 985 * MS)
    for drive in host.drives:
        drive.up_ns = 991 * MS
    assert not host.call("ready", 985 * MS)


def test_some_periods_of_a_slow_message_are_now(host):
    host.serve(1000 * MS)
    for reception in host.n.receptions[: host.n.n_receptions]:
        reception.period_ns = 20 * MS
    positions(host, 1000 * MS, 1000 * MS)
    assert host.call("ready", 1080 * MS) and not host.call("ready", 1080 * MS + 1)


def moved(host, newest, q, dq):
    """Drive 1 tells a position and a velocity in sample `newest`."""
    drive = host.drives[0]
    reception = host.n.receptions[drive.q_of]
    reception.newest = newest
    values = (c.c_double * 2).from_address(reception.values)
    values[drive.q_at], values[drive.dq_at] = q, dq
    host.drives[0].told_ns = host.drives[1].told_ns = 0
    host.call("watch", 0)
    return Failure(drive.failure)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_position_that_stands_still_for_a_way_that_no_encoder_hides_is_old(host, sign):
    """The period is 5 ms: 0.05 rad are ten of them at 1 rad/s."""
    host.serve(0)
    for newest in range(11):
        assert moved(host, newest, 0.3, 1.0 * sign) is Failure.NOT, newest
    assert moved(host, 10, 0.3, 1.0 * sign) is Failure.NOT  # the same sample counts once
    assert moved(host, 11, 0.3, 1.0 * sign) is Failure.STILL


def test_a_position_that_changes_or_a_joint_that_rests_is_not_old(host):
    host.serve(0)
    for newest in range(0, 40, 2):
        assert moved(host, newest, 0.3 + 1e-9 * (newest // 8), 1.0) is Failure.NOT
    for newest in range(100, 400, 2):
        assert moved(host, newest, 0.3, 0.09) is Failure.NOT
        assert moved(host, newest + 1, 0.3, -0.09) is Failure.NOT
    host.drives[0].dq_of = -1
    for newest in range(400, 800, 100):
        assert moved(host, newest, 0.3, 1.0) is Failure.NOT
    assert moved(host, 900, 0.3, 1.0) is Failure.NOT


def test_a_position_or_velocity_that_is_older_than_it_may_be_is_silence(tmp_path):
    """A CiA 402 drive is tested, because it tells them in two messages."""
    host = Host(tmp_path, "can-cia402")
    with host.wired:
        for which in ("q_of", "dq_of"):
            for drive in host.drives:
                drive.phase, drive.failure, drive.heard, drive.told_ns = 2, 0, 1, 1000 * MS
                drive.row = next(i for i in range(8) if drive.told[i].kind == Told.ENABLED)
            host.n.begun, host.n.now_ns = 1, 1000 * MS
            mine = c.addressof(host.n.receptions[getattr(host.drives[0], which)])
            inlets = host.n.inlets[: host.n.n_inlets]
            for inlet in inlets:
                inlet.stop_ns, inlet.heard_ns = 50 * MS, 1000 * MS
                inlet.last_newest = inlet.reception.contents.newest
            (one,) = [i for i in inlets if c.addressof(i.reception.contents) == mine]
            for old, failure in ((50 * MS, Failure.NOT), (50 * MS + 1, Failure.SILENT)):
                one.heard_ns = 1000 * MS - old
                host.call("watch", 1000 * MS)
                assert Failure(host.drives[0].failure) is failure, which
            assert Failure(host.drives[1].failure) is Failure.NOT


@pytest.mark.parametrize(
    ("within", "stop", "limit"),
    [(100, 200, 100), (300, 200, 200), (300, 20, 50), (10, 20, 50), (300, 0, 50), (90, 1000, 90)],
)
def test_a_position_may_be_as_old_as_a_state_and_as_an_input_may_be(host, within, stop, limit):
    """And 50 ms in any case; of the inputs those of other messages do not count (ms)."""
    host.serve(1000 * MS)
    t, n = 5000 * MS, host.n
    for drive in host.drives:
        drive.within_ns, drive.up_ns = within * MS, t
    for inlet in n.inlets[: n.n_inlets]:
        mine = inlet.reception.contents.drive == 0
        inlet.stop_ns = stop * MS if mine else 1
    for reception in n.receptions[: n.n_receptions]:
        reception.previewed_ns = t - limit * MS if reception.drive == 0 else t
    assert host.call("ready", t)
    assert not host.call("ready", t + 1)


@pytest.mark.parametrize(
    ("newest", "arrival", "previewed", "ready"),
    [
        (-1, 9 * MS, -1, False), (-1, 9 * MS, 0, True), (0, 0, -1, True), (5, 0, -1, True),
        (0, -50 * MS, -1, True), (0, -50 * MS - 1, -1, False),
        (0, -50 * MS - 1, -50 * MS, True), (0, -50 * MS, -60 * MS, True),
    ],
)  # fmt: skip
def test_a_position_is_that_of_the_last_frame_of_the_run_or_before_it(
    host, newest, arrival, previewed, ready
):
    """Arrivals count from t = 0, previews are on the clock; both as if `ready` were asked at 0."""
    start = 700_000 * MS
    host.serve(start)
    host.n.start_ns = start
    for drive in host.drives:
        drive.up_ns = start - 100 * MS
    for reception in host.n.receptions[: host.n.n_receptions]:
        reception.newest, reception.arrival_ns = newest, arrival
        reception.previewed_ns = -1 if previewed == -1 else start + previewed
    assert bool(host.call("ready", start)) is ready


@pytest.mark.parametrize(("dq", "counts"), [(0.1, True), (0.0999, False), (-0.1, True),
                                            (-0.0999, False)])  # fmt: skip
def test_a_joint_rests_below_a_tenth_of_a_radian_a_second(host, dq, counts):
    host.serve(0)
    found = [moved(host, newest, 0.3, dq) for newest in range(0, 400, 10)]
    assert (Failure.STILL in found) is counts


def test_a_way_is_unseen_up_to_the_limit_itself(host):
    """At 1 rad/s and 50 ms it is exactly the way of a period."""
    host.serve(0)
    reception = host.n.receptions[host.drives[0].q_of]
    reception.period_ns = 50 * MS  # 1 rad/s for one period is the limit
    assert [moved(host, k, 0.3, 1.0) for k in range(3)] == [Failure.NOT, Failure.NOT, Failure.STILL]


def test_a_drive_without_a_position_or_that_tells_no_state_never_stands_still(host):
    host.serve(0)
    host.drives[0].q_of = -1
    reception = host.n.receptions[host.drives[0].dq_of]
    for newest in range(0, 400, 100):
        reception.newest = newest
        host.drives[0].told_ns = host.drives[1].told_ns = 0
        host.call("watch", 0)
    assert host.phases() == [Phase.SERVING] * 2


def test_a_drive_whose_states_have_no_time_limit_may_be_silent(host):
    host.serve(MS)
    for drive in host.drives:
        drive.within_ns = 0
    host.call("watch", 10**6 * MS)
    assert host.phases() == [Phase.SERVING] * 2
    host.drives[1].within_ns = 1
    host.call("watch", 10**6 * MS)
    assert host.phases() == [Phase.SERVING, Phase.FAILED]


def test_drives_behind_the_table_are_not_looked_at(host):
    host.serve(MS)
    host.n.n_commanded = 1
    host.call("watch", 10**6 * MS)
    assert host.phases() == [Phase.FAILED, Phase.SERVING]
    host.call("excuse", 77)
    assert host.drives[1].told_ns == MS
    assert host.tell(2, HOT, 2 * MS) == NOT
    host.sent()
    host.n.life.state, host.n.life.armed = LifeState.FAULT, 0
    host.step(2 * MS)
    assert host.sent() == [(1, DISABLE)] and host.phases() == [Phase.RESTING, Phase.SERVING]
    assert host.step(3 * MS) == 0  # all of its drives rest
