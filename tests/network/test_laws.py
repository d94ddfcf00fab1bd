"""Two arms on two hosts: what the network does to packets, and what the controllers make of it."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from bridge.cli.diff import lines
from bridge.rehearsal.settings import ScheduledEvent
from bridge.relay.router import UDP
from cosim.record import Run
from fmus.paper import teleoperation as paper
from fmus.paper.measure import norm
from tests.network.hosts import (
    ARMS,
    PATIENT,
    SHORT,
    Case,
    Events,
    Found,
    Site,
    bounded,
    exact,
    in_order,
    rehearse,
    settled,
)

DELAY = {"law": "uniform", "low": "300 ms", "high": "1200 ms", "hold": "30 ms"}
OVERTAKING = {"law": "uniform", "low": "20 ms", "high": "60 ms"}
BURSTS = {"law": "gilbert-elliott", "p": 0.02, "r": 0.1, "1-h": 0.9, "1-k": 0.001}
NARROW = 200e3  # bit/s
pytestmark = pytest.mark.slow


def constant(delay: str) -> dict[str, str]:
    return {"law": "constant", "delay": delay}


def during(stop: float, specs: Mapping[str, Mapping[str, Any]]) -> Events:
    """Links by their names, from before the run to its end: to connect and to part is no test."""

    def events(site: Site) -> Sequence[ScheduledEvent]:
        def begin(link: str) -> ScheduledEvent:
            return ScheduledEvent(-0.3, link, lambda r: site.network.set(link, **specs[link]))

        end = ScheduledEvent(stop, "end", lambda r: site.network.set("*", delay=SHORT))
        return [*(begin(link) for link in specs), end]

    return events


APART = {
    "master>slave": {"delay": constant("50 ms")},
    "slave>master": {"delay": constant("400 ms")},
}
CASES = {
    "paper": Case(18.0, during(18.0, {"*": {"delay": DELAY, "ordered": False}}), PATIENT),
    # the slave's t = 0 is 80 ms earlier than the master's
    "apart": Case(18.0, during(18.0, APART), PATIENT, ahead={"slave": 80_000_000}),
    "bursts": Case(15.0, during(15.0, {"*": {"delay": SHORT, "loss": BURSTS}}), PATIENT),
    "narrow": Case(15.0, during(15.0, {"*": {"delay": SHORT, "rate": NARROW}}), PATIENT),
    "overtaking": Case(15.0, during(15.0, {"*": {"delay": OVERTAKING, "ordered": False}}), PATIENT),
}


def sent_samples(found: Found, link: str) -> np.ndarray:
    """Its packets that carried xi: over UDP, of the length most of them have."""
    packets = found.packets(link)
    packets = packets[packets["protocol"] == UDP]
    lengths, counts = np.unique(packets["length"], return_counts=True)
    return packets[packets["length"] == lengths[np.argmax(counts)]]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Found]:
    return rehearse(CASES, tmp_path_factory.mktemp("laws"))


@pytest.mark.parametrize("case", CASES)
def test_arms_end_where_the_hand_wants_them_and_everything_replays(
    case: str, runs: dict[str, Found]
):
    found = runs[case]
    exact(found)
    settled(found)
    bounded(found)
    in_order(found)
    for node in ARMS:
        counts = found.counts(node)
        assert counts["crc"] == counts["length"] == counts["invalid"] == 0


@pytest.mark.parametrize("case", CASES)
def test_one_offline_run_over_the_recorded_tables_is_the_same(case: str, runs: dict[str, Found]):
    """Only xi crosses, as it is: neither lateness nor phases nor processes change a bit."""
    found = runs[case].offline()
    assert found.verdict == "identical", lines(found)


def test_the_papers_delay(runs: dict[str, Found]):
    """Settle time and effort are those of the law offline: packets, the newest stamp wins."""
    found = runs["paper"]
    claim = next(c for c in paper.CLAIMS if c.name == "link-10-newest")
    value = claim.measure(Run.open(found.folder))
    assert claim.expected.holds(value), value
    assert norm(Run.open(found.folder), "master.tau_h") == pytest.approx(47.3, rel=0.02)
    for node in ARMS:
        taken = found.transit(node)
        assert taken.min() >= 0.3 and taken.max() < 1.25
        assert found.silence(node).max() < 1.2


def test_what_was_overtaken_is_lost_not_used(runs: dict[str, Found]):
    for case, link in (("paper", "master>slave"), ("overtaking", "slave>master")):
        found, node = runs[case], link.rpartition(">")[2]
        samples = sent_samples(found, link)
        left = samples["left_ns"][samples["left_ns"] > 0]
        overtaken = np.maximum.accumulate(left) > left
        counts = found.counts(node)
        assert counts["lost"] / (counts["ok"] + counts["lost"]) == pytest.approx(
            overtaken.mean(), abs=0.1
        )
        assert overtaken.mean() > 0.4
        assert counts["repeated"] == counts["reordered"] == 0


def test_clocks_that_differ_show_in_transit_and_not_in_silence(runs: dict[str, Found]):
    found = runs["apart"]
    assert np.median(found.transit("slave")) == pytest.approx(0.050 + 0.080, abs=0.02)
    assert np.median(found.transit("master")) == pytest.approx(0.400 - 0.080, abs=0.02)
    for node in ARMS:
        assert np.median(found.silence(node)) < 0.02
        assert found.counts(node)["lost"] < 200


def test_bursts_of_loss_are_counted(runs: dict[str, Found]):
    found = runs["bursts"]
    for link, node in (("master>slave", "slave"), ("slave>master", "master")):
        share = (sent_samples(found, link)["delay_ns"] < 0).mean()
        counts = found.counts(node)
        assert counts["lost"] / (counts["ok"] + counts["lost"]) == pytest.approx(share, abs=0.1)
        assert counts["lost"] > 50
        assert found.silence(node).max() > 0.02  # more than one in a row


def test_a_narrow_link_is_nearly_full_and_lets_samples_wait(runs: dict[str, Found]):
    found = runs["narrow"]
    for link, node in (("master>slave", "slave"), ("slave>master", "master")):
        packets = found.packets(link)
        seconds = (packets["t_ns"][-1] - packets["t_ns"][0]) * 1e-9
        assert 0.7 * NARROW < 8 * packets["length"].sum() / seconds < NARROW
        shortest = 8 * sent_samples(found, link)["length"].min() / NARROW
        taken = found.transit(node)
        assert taken.min() >= shortest  # the time its own bits take
        assert np.percentile(taken, 99) > 1.5 * shortest  # some wait for others
        assert found.counts(node)["lost"] < 200
