"""The lines of a rehearsal on its nodes and on the ages of signals: each number with its unit."""

from bridge.realtime.lateness import lateness
from bridge.records.node_lives import Life
from bridge.results.report import NodeReport, SignalAge

MS = 1_000_000


def report(*late_us, state="active"):
    deadline = [k * MS for k in range(len(late_us))]
    woke = [d + us * 1000 for d, us in zip(deadline, late_us, strict=True)]
    received = [t + 2000 for t in woke]
    stepped = [t + 30_000 for t in received]
    sent = [t + 1_500 for t in stepped]
    times = {"received": received, "stepped": stepped, "sent": sent}
    found = lateness(deadline, woke, MS, **times)
    return NodeReport(Life("master"), len(late_us), found, state, ["stale"], None)


def test_a_node_tells_how_late_its_slots_were():
    assert report(10, 10, 10, 250).text() == (
        "late by 10 us (median), 250 us (p99), 250 us (p99.9), 250 us at most, in 4 slots"
    )
    slow = report(0, 0, 1200, state="fault")
    assert "1.2 ms at most, in 3 slots, 1 missed; fault: " in slow.text()


def test_a_node_tells_how_long_each_part_of_a_slot_took():
    assert report(10, 10, 13).parts() == (
        "receive 2 us (p99 2 us), step 30 us (p99 30 us), send 1.5 us (p99 1.5 us), "
        "period 1.0015 ms (1 ms nominal, standard deviation 1.5 us)"
    )


def test_an_age_is_told_by_its_parts():
    age = SignalAge("a.x -> b.x", True, 744.2, 0.07, 0.128, 1.31, 744.5)
    assert age.text == (
        "744 ms on average when used: link 744 ms, "
        "network 70 us (median), 128 us (p99), 1.31 ms at most"
    )
    assert SignalAge("a.x -> b.x", True, p50=0.2, p99=0.2, greatest=0.2, total=0.5).text == (
        "500 us on average when used: network 200 us (median), 200 us (p99), 200 us at most"
    )
