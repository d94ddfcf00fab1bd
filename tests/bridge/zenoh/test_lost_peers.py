"""Peers that are present but silent."""

from bridge.deployment.zenoh_keys import Names
from bridge.zenoh.lost_peers import LostPeers

S = 1_000_000_000
SENDERS = {"p/a/c/m": "a", "p/a/heartbeat": "a", "p/b/heartbeat": "b"}


def test_who_was_heard_and_is_heard_no_more_is_named_less_and_less_often():
    found = LostPeers({"p/a/c/m": "a"}, lease=1.0)
    found.counts["p/a/c/m"] += 1
    assert [t for t in range(40) if found.silent({"a"}, t * S)] == [6, 17, 38]
    found.counts["p/a/c/m"] += 1
    assert [t for t in range(40, 50) if found.silent({"a"}, t * S)] == [46]


def test_one_key_that_was_lost_is_missed_beside_another_that_is_heard():
    found = LostPeers(SENDERS, lease=1.0)
    for t in range(7):
        found.counts["p/a/heartbeat"] += 1
        assert found.silent({"a"}, t * S) == (["a"] if t == 6 else [])


def test_who_is_there_and_was_never_heard_is_silent_and_who_never_was_there_is_not():
    found = LostPeers(SENDERS, lease=1.0)
    assert [t for t in range(10) if found.silent({"b"}, t * S)] == [6]
    assert found.silent({"b"}, 7 * S) == []


def test_who_was_there_and_went_before_it_was_heard_is_silent():
    """As when a machine that starts many processes pauses one before its first message."""
    found = LostPeers(SENDERS, lease=1.0, udp=True)
    assert not found.silent({"b"}, 0)
    assert found.silent((), S) == ["b"]


def test_a_peer_whose_token_has_gone_is_not_forgotten():
    found = LostPeers(SENDERS, lease=1.0)
    found.counts["p/a/c/m"] += 1
    assert not found.silent({"a"}, 0)
    assert not found.silent((), 5 * S)
    assert found.silent((), 6 * S) == ["a"]


def test_an_end_that_listens_over_udp_does_not_wait_where_the_token_has_gone():
    found = LostPeers({"p/a/c/m": "a"}, lease=1.0, udp=True)
    found.counts["p/a/c/m"] += 1
    half = S // 2
    assert not found.silent({"a"}, 0)
    assert [k for k in range(1, 16) if found.silent((), k * half)] == [2, 5, 10]
    found.counts["p/a/c/m"] += 1
    assert [k for k in range(20, 40) if found.silent({"a"}, k * half)] == [31]


def test_a_message_that_comes_rarely_is_waited_for():
    found = LostPeers({"p/a/c/m": "a"}, lease=1.0, period=10.0)
    found.counts["p/a/c/m"] += 1
    assert [t for t in range(50) if found.silent({"a"}, t * S)] == [41]


def test_long_leases_make_it_wait():
    found = LostPeers(SENDERS, lease=20.0)
    found.counts["p/a/c/m"] += 1
    found.silent({"a"}, 0)
    assert not found.silent({"a"}, 30 * S)
    assert found.silent({"a"}, 31 * S) == ["a"]


def test_keys_and_who_says_them():
    keys = ("net/1/a/c/m", "net/1/b/heartbeat", "net/1/estop", "net/1/nmt")
    assert Names("net/1").senders(keys) == {"net/1/a/c/m": "a", "net/1/b/heartbeat": "b"}
