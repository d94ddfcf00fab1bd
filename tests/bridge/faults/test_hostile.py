"""Faults of a hostile peer: valid frames made with knowledge of the format."""

from __future__ import annotations

import ctypes as c

import numpy as np
import pytest

from bridge.can.codec import Codec
from bridge.can.dbc import load
from bridge.can.layout import find
from bridge.deployment.zenoh_keys import codec as streamed
from bridge.native import faults as native
from bridge.native.bus import Accept
from bridge.native.faults import Injector
from bridge.native.journal import Journal
from bridge.native.message import Decoded, Header
from tests.bridge.injection import MS, START, frame, rule, through
from tests.bridge.rehearsing import ROOT

VALUES = np.array([0.5, -1.0, 2.0, 3.0])


def can():
    layouts = load(ROOT / "configs" / "can" / "link_fd2.dbc")
    return Codec(find(layouts, "STATE_1"), ["q1", "q2", "dq1", "dq2"])


def zenoh():
    return streamed("a/b/c/d", 0x1000, ["q1", "q2", "dq1", "dq2"])


@pytest.fixture(params=[can, zenoh], ids=["can", "zenoh"])
def codec(request):
    return request.param()


def hostile(codec, kind, **more):
    return rule(kind, accept=Accept.of(codec.message), message=c.pointer(codec.message), **more)


def sent(codec, n, ms=None):
    """Sample number n, 5 ms apart."""
    t_ms = 5 * n if ms is None else ms
    made = codec.frame(VALUES + n, Header(n, 7, 5000 * n), START + t_ms * MS)
    made.sequence = n
    return made


def heard(codec, *rules, frames):
    """(ms, counter, values, status) of all that gets through; every frame has to be valid."""
    found = []
    for ms, _, data in through(Injector(list(rules), 4096), frames):
        result, values, header = codec.decode(data)
        assert result is Decoded.OK
        found.append((ms, header.counter, values, header.status))
    return found


def test_a_forged_frame_comes_first_with_its_values_and_a_counter_ahead(codec):
    forged, true = heard(
        codec, hostile(codec, native.FORGE, count=60, a=2.0, b=2.0), frames=[sent(codec, 1)]
    )
    assert (forged[0], true[0]) == (5, 5)
    assert (forged[1], true[1]) == (61, 1)
    assert np.allclose(forged[2], VALUES + 3, atol=1e-3)
    assert np.allclose(true[2], VALUES + 1, atol=1e-3)
    assert forged[3] == true[3] == 7


def test_what_a_forged_frame_adds_is_drawn_from_the_whole_of_its_range(codec):
    rule = hostile(codec, native.FORGE, a=2.0, b=6.0)
    found = heard(codec, rule, frames=[sent(codec, n) for n in range(10)])
    added = np.array([f[2] - t[2] for f, t in zip(found[::2], found[1::2], strict=True)])
    assert 2 - 1e-3 <= added.min() < 2.5 and 5.5 < added.max() <= 6 + 1e-3
    assert len(np.unique(added.round(3))) == added.size  # each value has a draw of its own


def test_the_record_counts_the_frames_of_a_hostile_peer(codec, tmp_path):
    rules = [hostile(codec, native.FORGE, a=2.0, b=2.0), hostile(codec, native.FORGE, a=3.0, b=3.0)]
    with Journal.create(tmp_path / "injected", native.INJECTED, 10) as journal:
        through(Injector(rules, 4096, journal.address), [sent(codec, 1)])
        assert journal.rows["copies"].tolist() == [3]


def test_absurd_values_take_the_place_of_the_true_ones(codec):
    (found,) = heard(codec, hostile(codec, native.ABSURD, a=1e6, b=1e6), frames=[sent(codec, 1)])
    assert found[1] == 1
    assert (np.abs(found[2]) > 10).all()  # an integer saturates at the end of its field
    assert (np.sign(found[2]) == [1, -1, 1, -1]).all()


def test_a_recorded_stretch_is_sent_again(codec):
    rules = [hostile(codec, native.REPLAY, count=3, t0_ns=20 * MS)]
    found = heard(codec, *rules, frames=[sent(codec, n) for n in range(9)])
    counters = [counter for _, counter, _, _ in found]
    assert counters == [0, 1, 2, 3, 1, 4, 2, 5, 3, 6, 1, 7, 2, 8]


def test_nothing_recorded_is_not_sent_again(codec):
    found = heard(codec, hostile(codec, native.REPLAY, count=3), frames=[sent(codec, 1)])
    assert len(found) == 1


def test_a_flood_has_its_rate_and_counters_that_go_on(codec):
    rules = [hostile(codec, native.FLOOD, a=0.001, b=0.0)]
    found = heard(codec, *rules, frames=[sent(codec, n) for n in (1, 2, 3)])
    assert [(ms, counter) for ms, counter, _, _ in found] == [
        (5, 1), (10, 2), (11, 3), (12, 4), (13, 5), (14, 6),
        (15, 7), (15, 3), (16, 4), (17, 5), (18, 6), (19, 7), (20, 8),
    ]  # fmt: skip


def test_a_flood_is_bounded(codec):
    rules = [hostile(codec, native.FLOOD, a=1e-6, b=0.0)]
    found = heard(codec, *rules, frames=[sent(codec, 1), sent(codec, 2, ms=2000)])
    assert len(found) == 2 + 512


def test_frames_that_are_not_valid_are_left_alone(codec):
    injector = Injector([hostile(codec, native.ABSURD, a=1e6, b=1e6)])
    broken = sent(codec, 1)
    broken.data[5] ^= 1
    assert through(injector, [broken])[0][2] == broken.payload
    assert injector.struct.injected == 0


def test_other_messages_are_left_alone(codec):
    out = through(Injector([hostile(codec, native.FORGE, a=1.0, b=1.0)]), [frame(1)])
    assert len(out) == 1


@pytest.mark.parametrize("kind", [native.FORGE, native.ABSURD, native.FLOOD])
def test_of_a_frame_that_is_not_valid_nothing_is_made_and_nothing_counted(codec, kind):
    """The flood has its first frame before it."""
    injector = Injector([hostile(codec, kind, a=0.001, b=0.001, t0_ns=7 * MS)], 64)
    broken = sent(codec, 2)
    broken.data[5] ^= 1
    injector.put(sent(codec, 1), START)
    injector.rules[0].last_ns = 5 * MS
    assert [data for _, _, data in through(injector, [broken])][-1] == broken.payload
    assert injector.hits() == (0,) and injector.struct.injected == 0
    assert injector.struct.n_waiting == 0
