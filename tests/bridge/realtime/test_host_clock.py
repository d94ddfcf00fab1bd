"""Hosts with the same number in EPOCH are told apart by their identities."""

from __future__ import annotations

from itertools import combinations

from bridge.realtime.host_clock import HostClock, host_clock


def test_hosts_with_one_number_have_different_identities() -> None:
    """600 hosts share 255 numbers; all their identities and all reports differ."""
    hosts = [HostClock(f"boot-{i}", kept=False) for i in range(600)]
    assert any(a.number == b.number for a, b in combinations(hosts, 2))
    assert len({h.identity for h in hosts}) == len({h.identity_text for h in hosts}) == 600
    assert len({h.describe() for h in hosts}) == 600
    assert all(0.0 <= x < 2**32 and x == int(x) for h in hosts for x in h.identity)


def test_the_text_of_an_identity_is_a_hash_of_the_boot() -> None:
    """SHA-256 of "abc", by FIPS 180-4, begins so."""
    assert HostClock("abc", kept=False).identity_text == "ba7816bf8f01cfea414140de5dae2223"
    assert host_clock().identity_text == host_clock().identity_text
