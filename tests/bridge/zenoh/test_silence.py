"""Who is there and silent."""

from bridge.zenoh.names import Names
from bridge.zenoh.silence import Silence

S = 1_000_000_000
SENDERS = {"p/a/c/m": "a", "p/a/heartbeat": "a", "p/b/heartbeat": "b"}


def test_who_was_heard_and_is_heard_no_more_is_named_less_and_less_often():
    found = Silence(SENDERS, lease=1.0)
    found.counts["p/a/heartbeat"] += 1
    named = [t for t in range(40) if found.silent({"a", "b"}, t * S)]
    assert named == [6, 17, 38]  # b was never heard
    found.counts["p/a/c/m"] += 1
    assert [t for t in range(40, 50) if found.silent({"a"}, t * S)] == [46]


def test_who_has_gone_is_not_silent():
    found = Silence(SENDERS, lease=1.0)
    found.counts["p/a/c/m"] += 1
    assert not found.silent({"a"}, 0)
    assert not found.silent((), 10 * S)
    assert not found.silent({"a"}, 11 * S)
    assert found.silent({"a"}, 17 * S) == ["a"]


def test_long_leases_make_it_wait():
    found = Silence(SENDERS, lease=20.0)
    found.counts["p/a/c/m"] += 1
    found.silent({"a"}, 0)
    assert not found.silent({"a"}, 30 * S)
    assert found.silent({"a"}, 31 * S) == ["a"]


def test_keys_and_who_says_them():
    keys = ("net/1/a/c/m", "net/1/b/heartbeat", "net/1/estop", "net/1/nmt")
    assert Names("net/1").senders(keys) == {"net/1/a/c/m": "a", "net/1/b/heartbeat": "b"}
