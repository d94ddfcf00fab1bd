"""Faults in C: several rules, the effect of the seed, and the correctness of the record."""

from __future__ import annotations

from zlib import crc32

from hypothesis import given
from hypothesis import strategies as st

from bridge.native import faults as native
from bridge.native.faults import INJECTED, Fault, Injector
from bridge.native.journal import Journal
from tests.bridge.injection import MS, START, frame, numbers, rule, through

# ---- several rules, seeds, bounds ----

kinds = st.integers(0, 6)
rules = st.lists(
    st.builds(
        rule,
        kinds,
        count=st.integers(1, 5),
        t0_ns=st.integers(0, 30 * MS),
        t1_ns=st.integers(20 * MS, 90 * MS),
        probability=st.floats(0, 1),
        a=st.floats(0, 0.003),
        b=st.floats(0.003, 0.02),
        random=st.integers(0, 2**64 - 1),
    ),
    max_size=5,
)


def copy(r):
    return Fault.from_buffer_copy(bytes(r))


@given(rules=rules)
def test_the_same_seed_does_the_same(rules):
    frames = [frame(n) for n in range(80)]
    a, b = (through(Injector([copy(r) for r in rules]), frames) for _ in range(2))
    assert a == b


@given(rules=rules)
def test_frames_are_accounted_for(tmp_path_factory, rules):
    """What went in, less what was dropped, and copies, comes out; the record says the same."""
    folder = tmp_path_factory.mktemp("journal")
    with Journal.create(folder / "injected", INJECTED, 100) as journal:
        injector = Injector(rules, journal=journal.address)
        frames = [frame(n) for n in range(80)]
        out = through(injector, frames)
        rows = journal.rows.copy()
    s = injector.struct
    assert (s.frames, s.overflow, s.n_waiting) == (80, 0, 0)
    assert len(rows) == s.injected
    copies = {n: 1 for n in range(80)} | {int(r["sequence"]): int(r["copies"]) for r in rows}
    assert {n: numbers(out).count(n) for n in range(80)} == copies
    assert sum(n == 0 for n in copies.values()) == s.dropped
    assert [t for t, _, _ in out] == sorted(t for t, _, _ in out)
    changed = {int(r["sequence"]) for r in rows if r["copies"] and r["crc"] != r["crc_after"]}
    assert len(changed) == s.corrupted
    for r in rows:
        was = frames[r["sequence"]].payload
        assert (r["crc"], bytes(r["data"][:8]), r["length"]) == (crc32(was), was, 8)
        assert r["t_ns"] == r["sequence"] * MS and r["id"] == 0x100
        assert r["kinds"] >> rules[r["rule"]].kind & 1
    for _, n, payload in out:
        assert (payload != frames[n].payload) == (n in changed)


def test_the_record_names_the_first_rule_that_struck(tmp_path):
    rules = [rule(native.DELAY, a=0.001, b=0.001), rule(native.DUPLICATE), rule(native.CORRUPT)]
    with Journal.create(tmp_path / "injected", INJECTED, 10) as journal:
        through(Injector(rules, journal=journal.address), [frame(n) for n in range(3)])
        rows = journal.rows.copy()
    assert rows["rule"].tolist() == [0, 0, 0]
    assert set(rows["kinds"]) == {1 << native.DELAY | 1 << native.DUPLICATE | 1 << native.CORRUPT}


def test_a_rule_draws_the_same_whatever_others_do():
    """The frames hit by a rule do not depend on the rules before it."""
    second = rule(native.CORRUPT, probability=0.3, random=99)
    frames = [frame(n) for n in range(100)]
    alone = through(Injector([copy(second)]), frames)
    changed = {n for _, n, payload in alone if payload != frames[n].payload}
    both = through(Injector([rule(native.DROP, probability=0.5), copy(second)]), frames)
    assert {n for _, n, payload in both if payload != frames[n].payload} == changed & set(
        numbers(both)
    )


def test_bits_flipped_back_are_no_corruption():
    """Two rules that flip the same bits leave the frame as it was: not counted as corrupted."""
    rules = [rule(native.CORRUPT, count=64), rule(native.CORRUPT, count=64)]
    injector = Injector(rules)
    sent = frame(1)
    ((_, _, payload),) = through(injector, [sent])
    assert payload == sent.payload
    assert (injector.struct.corrupted, injector.hits()) == (0, (1, 1))


def test_too_many_that_wait_are_counted():
    injector = Injector([rule(native.DELAY, a=1.0, b=1.0)], 16)
    for n in range(40):
        injector.put(frame(n), START)
    assert (injector.struct.overflow, injector.struct.n_waiting) == (24, 16)
    assert numbers(through(injector, [])) == list(range(16))


def test_a_full_record_counts_and_goes_on(tmp_path):
    with Journal.create(tmp_path / "injected", INJECTED, 5) as journal:
        injector = Injector([rule(native.DROP)], journal=journal.address)
        for n in range(9):
            injector.put(frame(n), START)
        assert (len(journal), journal.dropped, injector.struct.dropped) == (5, 4, 9)


def test_the_generator_is_splitmix64():
    """The state after n questions: seed + n times the golden gamma (Steele et al., 2014)."""
    injector = Injector([rule(native.DROP, random=1234567, probability=0.5)])
    for n in range(5):
        injector.put(frame(n), START)
    assert injector.rules[0].random == (1234567 + 5 * 0x9E3779B97F4A7C15) % 2**64
    first = [6457827717110365317, 3203168211198807973, 9817491932198370423]
    expected = [n for n, z in enumerate(first) if z >> 63]  # at 0.5 the upper half stays
    assert [n for n in numbers(through(injector, [])) if n < 3] == expected
