"""A table, made by hand, of the EPOCHs that a waiting node believes, refuses or cannot judge."""

from __future__ import annotations

import ctypes as c
from dataclasses import dataclass

import pytest

from bridge.native import epoch as native
from bridge.native.message import Header
from bridge.native.node import WALL, functions
from bridge.native.pace import now
from bridge.native.safety import Status
from cosim.base.clock import realtime_offset_ns
from cosim.base.copies import replace
from tests.bridge.deployments import named
from tests.bridge.slots import Slots

HOST, OTHER, RUN = 70, 71, 9
OURS = (11.0, 12.0, 13.0, 14.0)
NONE = (0.0,) * 4
SECOND = 1_000_000_000
TURN = 2**32 * 1e-6  # s, of a time stamp of 32 bits
NEAR = 5_000_000  # ns; two readings of the clocks, on a busy machine


@dataclass(frozen=True)
class Case:
    """An EPOCH whose t = 0 is `ahead` s from now.

    `sample`: by how many s another t = 0 is later that an early sample tells, of the last message;
    `date`: (number of its host, s from ours, s ago).
    """

    ahead: float = -20.0
    host: int = HOST
    identity: tuple[float, ...] = NONE
    kept: tuple[int, int] = (0, 0)  # ours, theirs
    sample: float | None = None
    date: tuple[int, float, float] | None = None
    age: float = 0.0  # s, the greatest of a sample
    bits: int = 32  # of a time stamp


NOTHING = Case()
US = Case(identity=OURS)
BOTH = Case(host=OTHER, kept=(1, 1))
SOON = Case(ahead=4.5)
BELIEVED = [
    US, replace(US, ahead=30.0), BOTH, replace(BOTH, ahead=30.0), SOON,
    replace(BOTH, identity=(1.0, 2.0, 3.0, 4.0)),
    *(replace(case, sample=x) for case in (NOTHING, US, BOTH) for x in (0.0, 1.9, -1.9)),
    *(replace(NOTHING, sample=x) for x in (TURN, -TURN, TURN + 1.9, -TURN - 1.9)),
    replace(SOON, sample=3.0),  # of another run: this one has not begun
    replace(NOTHING, sample=4.8, age=3.0), replace(NOTHING, sample=-1.9, age=3.0),
    replace(NOTHING, bits=16), replace(NOTHING, bits=16, sample=5.0),
    *(replace(NOTHING, date=(HOST & 63, x, 0.5)) for x in (0.0, 1.9, -1.9)),
    replace(SOON, date=(HOST & 63, 9.0, 1.5)), replace(SOON, date=(HOST - 1 & 63, 9.0, 0.5)),
    replace(NOTHING, ahead=30.0, date=(HOST & 63, 0.0, 0.5)),
]  # fmt: skip
REFUSED = [
    Case(host=OTHER), Case(host=OTHER, identity=OURS),
    replace(BOTH, kept=(0, 1)), replace(BOTH, kept=(1, 0)),
    *(replace(US, identity=(*OURS[:i], x, *OURS[i + 1 :])) for i in range(4) for x in (0.0, 9.0)),
    *(replace(case, sample=x) for case in (NOTHING, US, BOTH) for x in (2.1, -2.1, 10.0, -10.0)),
    *(replace(NOTHING, sample=x) for x in (TURN + 2.1, TURN - 2.1, -TURN - 2.1, 2147.0)),
    replace(NOTHING, sample=5.1, age=3.0), replace(NOTHING, sample=-2.1, age=3.0),
    *(replace(case, date=(HOST & 63, x, 0.5)) for case in (NOTHING, US, SOON) for x in (2.1, -2.1)),
    replace(SOON, ahead=5.5), replace(SOON, ahead=5.5, date=(HOST & 63, 0.0, 1.5)),
]  # fmt: skip
UNKNOWN = [NOTHING, replace(NOTHING, date=(HOST & 63, 0.0, 1.5)),
           replace(NOTHING, date=(HOST - 1 & 63, 0.0, 0.5)), replace(NOTHING, kept=(1, 0)),
           replace(NOTHING, kept=(0, 1))]  # fmt: skip


class Waiting:
    """A node that waits for a run, and says what it thinks of an EPOCH."""

    def __init__(self, slots, bus):
        self.slots, self.bus, self.epoch = slots, bus, slots.struct.epoch
        self.encoding = slots.system.services[bus].epoch
        self.epoch.host, self.epoch.identity[:] = HOST, OURS

    def put(self, run, host, kept, origin, t, identity=(), status=Status.SIMULATED):
        """`origin`, `t`: ns of the monotonic clock."""
        date = origin + realtime_offset_ns()
        said = native.values(run, host, bool(kept), date, identity)
        said = said[: self.encoding.message.n_fields]
        frame = self.encoding.frame(said, Header(status=int(status)))
        frame.t_ns = t
        self.slots.rings[self.bus].put(frame)

    def name(self, number, identity, ago):
        """HOST of a host with this number, `ago` s ago."""
        t = now() - round(ago * 1e9)
        frame = self.encoding.frame([number, 0, 1, identity * 10.0], Header())
        frame.t_ns = t
        self.slots.rings[self.bus].put(frame)
        self.slots.step()

    def thinks(self, case):
        """believed, refused or unknown; everything else that it notes is looked at."""
        t, e = now(), self.epoch
        before = e.unshared
        e.origin_ns = e.dated_ns = e.due_ns = e.heard_ns = e.told = 0
        e.kept = case.kept[0]
        origin = t + round(case.ahead * 1e9)
        receptions = list(self.slots.wired.inlet_bindings.receptions.values())
        for r in receptions:
            r.receiver.contents.time_bits, r.early = case.bits, 0
            r.max_age_ns = round(case.age * 1e9)
        if case.sample is not None:
            receptions[-1].early = 1
            receptions[-1].early_ns = origin + round(case.sample * 1e9)
        if case.date is not None:
            number, apart, ago = case.date
            sent = t - round(ago * 1e9)
            self.put(number, 0, 0, sent + round(apart * 1e9), sent, NONE)
            self.slots.step()
            assert e.unshared == before and not e.origin_ns and not e.due_ns
        self.put(RUN, case.host, case.kept[1], origin, t, case.identity)
        self.slots.step()
        assert e.due_ns == t + SECOND // 10
        if e.origin_ns:
            assert abs(e.origin_ns - origin) < NEAR and e.unshared == before
            assert (e.heard_ns, e.told, e.running) == (t, RUN, int(case.ahead <= 0))
            return "believed"
        assert e.unshared - before in (0, 1)
        return "refused" if e.unshared > before else "unknown"


@pytest.fixture
def waiting(tmp_path):
    with Slots(named("zenoh", "run.stop=60"), "master", tmp_path, WALL) as slots:
        yield Waiting(slots, "net")


@pytest.fixture
def on_can(tmp_path):
    """Hears samples of two nodes, and EPOCH without the identity of a host."""
    with Slots(named("can", "run.stop=60"), "master_control", tmp_path, WALL) as slots:
        yield Waiting(slots, "left")


@pytest.mark.parametrize(
    ("expected", "cases"), [("believed", BELIEVED), ("refused", REFUSED), ("unknown", UNKNOWN)]
)
def test_an_epoch_is_believed_by_what_is_known_of_its_host(waiting, expected, cases):
    for case in cases:
        assert waiting.thinks(case) == expected, case


def test_on_can_every_message_may_contradict_and_no_identity_is_missed(on_can):
    cases = [(case, expected) for expected, of in (("believed", BELIEVED), ("refused", REFUSED),
             ("unknown", UNKNOWN)) for case in of if case.identity == NONE]  # fmt: skip
    assert len(on_can.slots.wired.inlet_bindings.receptions) == 2 and len(cases) > 20
    for case, expected in cases:
        assert on_can.thinks(case) == expected, case


def test_a_host_frame_counts_for_the_next_epoch_within_a_second(on_can):
    """A HOST of another number, or an old one, is as none: then the date counts."""
    near = replace(SOON, date=(HOST & 63, 0.0, 0.5))
    for number, ago, expected in (
        (HOST & 63, 0.5, "refused"), (HOST - 1 & 63, 0.5, "believed"), (HOST & 63, 1.5, "believed"),
    ):  # fmt: skip
        on_can.name(number, OURS[0] + 1.0, ago)
        assert on_can.thinks(near) == expected
        assert on_can.thinks(near) == "believed"
    on_can.name(HOST & 63, OURS[0], 0.5)
    assert on_can.thinks(NOTHING) == "believed"  # of a run that is on, without a date
    on_can.epoch.identity[:] = NONE  # who does not know its own
    on_can.name(HOST & 63, OURS[0], 0.5)
    assert on_can.thinks(near) == "believed"


@pytest.mark.parametrize("adopts", [0, 1])
def test_a_date_before_a_host_frame_belongs_to_another_epoch(on_can, adopts):
    """That of another sender with this number: a gateway may send HOST without DATE."""
    e = on_can.epoch
    e.adopts, e.host = adopts, 0 if adopts else HOST  # a board has no number of a host
    for introduced in (False, True):
        on_can.put(HOST & 63, 0, 0, now() + 700 * SECOND, now(), NONE)
        on_can.slots.step()
        if introduced:
            on_can.name(HOST & 63, OURS[0], 0.1)
        e.origin_ns = 0
        on_can.put(RUN, HOST, 0, now() + SECOND, now(), NONE)
        on_can.slots.step()
        assert (e.origin_ns > 0) == (bool(adopts) != introduced)


def test_what_a_node_that_runs_hears_moves_nothing(waiting):
    waiting.slots.struct.begun = 1
    assert waiting.thinks(US) == waiting.thinks(Case(host=OTHER)) == "unknown"


@pytest.mark.parametrize(
    ("ours", "theirs", "ahead", "expected"),
    [(0, 1, -20.0, "unknown"), (0, 1, 0.5, "believed"), (0, 0, -20.0, "believed"),
     (1, 1, -20.0, "believed"), (1, 0, -20.0, "believed")],
)  # fmt: skip
def test_a_simulated_run_that_runs_is_none_for_real_drives(waiting, ours, theirs, ahead, expected):
    waiting.slots.struct.simulated = ours
    put = waiting.put
    waiting.put = lambda *given: put(*given, status=Status.SIMULATED if theirs else 0)
    assert waiting.thinks(replace(US, ahead=ahead)) == expected


def test_each_epoch_is_counted_whole_or_damaged(waiting):
    for n in range(3):
        waiting.thinks(US)
        assert (waiting.epoch.heard, waiting.slots.struct.damaged) == (n + 1, n)
        t = now()
        frame = waiting.encoding.frame(native.values(1, HOST, True, t, OURS), Header())
        frame.data[5] ^= 1
        waiting.slots.put("net", frame, t * 1e-9)
        waiting.slots.step()
        assert (waiting.epoch.heard, waiting.slots.struct.damaged) == (n + 1, n + 1)


@pytest.mark.parametrize(
    ("apart", "ago", "expected"),
    [
        (2 * SECOND, SECOND, "believed"), (-2 * SECOND, SECOND, "believed"),
        (2 * SECOND + 1, SECOND, "refused"), (-2 * SECOND - 1, SECOND, "refused"),
        (2 * SECOND, SECOND + 1, "unknown"), (9 * SECOND, SECOND + 1, "unknown"),
    ],
)  # fmt: skip
def test_a_date_counts_for_a_second_and_may_differ_by_two(waiting, apart, ago, expected):
    """To the nanosecond, as the node keeps it."""
    e, t = waiting.epoch, now()
    for r in waiting.slots.wired.inlet_bindings.receptions.values():
        r.receiver.contents.time_bits, r.early = 32, 0
    e.dated_host, e.dated_ns, e.apart_ns = HOST & 63, t - ago, apart
    waiting.put(RUN, HOST, 0, t - 20 * SECOND, t, NONE)
    waiting.slots.step()
    assert (bool(e.origin_ns), e.unshared) == (expected == "believed", expected == "refused")


@pytest.mark.parametrize(
    ("origin", "ago", "said"),
    [(5, 0, True), (5, SECOND, True), (5, SECOND + 1, False), (0, 0, False)],
)
def test_a_start_belongs_to_the_epoch_of_the_last_second(waiting, origin, ago, said):
    e, t = waiting.epoch, now()
    e.origin_ns, e.heard_ns = origin, t - ago
    found = functions().node_origin(c.byref(waiting.slots.struct), t, 300)
    assert found == (origin if said else t + 300)


def test_a_node_without_a_date_believes_the_host_whose_date_it_has_taken(on_can):
    """A microcontroller: of another host, and only right behind its DATE; it sends none itself."""
    on_can.epoch.host, on_can.epoch.adopts = 0, 1
    soon = Case(ahead=0.5)
    assert on_can.thinks(soon) == "refused"
    assert on_can.thinks(replace(soon, date=(HOST & 63, 700.0, 0.001))) == "believed"
    turn = 2**33 * 10_000  # ns, of a date on the bus
    assert (on_can.epoch.date_ns - 700 * SECOND + NEAR) % turn < 2 * NEAR
    assert on_can.thinks(replace(soon, date=(OTHER & 63, 700.0, 0.001))) == "refused"
    assert on_can.thinks(replace(soon, date=(HOST & 63, 700.0, 1.5))) == "refused"
    said = on_can.epoch.said
    on_can.slots.struct.life.state, on_can.epoch.asked = 2, 1
    on_can.slots.step()
    assert on_can.epoch.said == said
