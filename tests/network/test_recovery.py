"""Two arms on two hosts: what breaks, what the other side does meanwhile, and how it heals."""

from collections.abc import Callable, Sequence

import pytest

from bridge.cli.diff import lines
from bridge.native.safety import LifeState
from bridge.records.node_lives import Life
from bridge.rehearsal.settings import ScheduledEvent
from bridge.rehearsal.supervisor import Rehearsal
from tests.network.hosts import (
    ARMS,
    SHORT,
    TCP,
    Case,
    Events,
    Found,
    Router,
    Site,
    bounded,
    exact,
    in_order,
    rehearse,
    settled,
)

pytestmark = pytest.mark.slow


def down(begin: float, end: float) -> Events:
    """Nothing goes through from `begin` to `end` (s)."""

    def events(site: Site) -> Sequence[ScheduledEvent]:
        return (
            ScheduledEvent(begin, "partition", lambda r: site.network.set("*", down=True)),
            ScheduledEvent(end, "healed", lambda r: site.network.set("*", delay=SHORT)),
        )

    return events


def done(begin: float, first: str, end: float, then: str) -> Events:
    """What a rehearsal does to the slave's process."""

    def do(what: str) -> Callable[[Rehearsal], None]:
        return lambda running: getattr(running, what)("slave")

    return lambda site: (
        ScheduledEvent(begin, first, do(first)),
        ScheduledEvent(end, then, do(then)),
    )


def away(begin: float, end: float) -> Events:
    """The router is killed, and started again."""

    def router(site: Site) -> Router:
        assert site.router is not None
        return site.router

    return lambda site: (
        ScheduledEvent(begin, "router killed", lambda r: router(site).kill()),
        ScheduledEvent(end, "router again", lambda r: router(site).start()),
    )


#: Where processes have to start, which takes a loaded machine seconds: arms that need less time.
NEAR = ("components.master.start.q=[3.1, 3.3]", "components.slave.start.q=[3.8, 2.8]")
CASES = {
    "partition": Case(16.0, down(4.0, 6.0)),
    "killed": Case(20.0, done(3.0, "kill", 3.5, "restart"), NEAR),
    "frozen": Case(14.0, done(4.0, "freeze", 5.0, "thaw")),
    "too long": Case(
        14.0, done(4.0, "freeze", 5.0, "thaw"), ('deploy.nodes.slave.overrun="500 ms"',)
    ),
    "stale": Case(18.0, down(4.0, 7.0), ("deploy.messages.xi_master.max_age=0",), endpoints=TCP),
    "router": Case(18.0, away(3.0, 4.0), NEAR, router=True),
}

#: What an offline run has not: a life that begins in the middle of a run, and a node in FAULT,
#: whose guard puts the torque of its arm to 0.
WHOLE = [name for name in CASES if name not in ("killed", "too long")]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Found]:
    return rehearse(CASES, tmp_path_factory.mktemp("recovery"))


@pytest.mark.parametrize("case", CASES)
def test_arms_end_where_the_hand_wants_them_and_everything_replays(
    case: str, runs: dict[str, Found]
):
    found = runs[case]
    exact(found)
    if case != "too long":  # its slave ends in FAULT, and swings
        settled(found, within=0.1)
    bounded(found)
    in_order(found)
    for node in ARMS:
        assert found.silence(node, found.last_life(node))[-1000:].max() < 0.5


@pytest.mark.parametrize("case", WHOLE)
def test_one_offline_run_over_the_recorded_tables_is_the_same(case: str, runs: dict[str, Found]):
    """What controllers were told of silence included: edges fade offline as they did."""
    found = runs[case].offline()
    assert found.verdict == "identical", lines(found)


def test_a_partition_is_silence_and_loss_and_stops_nobody(runs: dict[str, Found]):
    found = runs["partition"]
    for node in ARMS:
        silence = found.silence(node)
        assert silence[:3900].max() < 0.5
        assert 1.8 < silence[5900] < 2.2
        assert 350 <= found.counts(node)["lost"] < 500
        assert {int(s) for s in found.rows[node]["state"]} == {LifeState.ACTIVE}
    assert (found.packets("master>slave")["delay_ns"] < 0).sum() > 350


def test_a_node_that_was_killed_joins_again(runs: dict[str, Found]):
    found = runs["killed"]
    assert set(found.rows) == {Life("master"), Life("slave"), Life("slave", 2)}
    assert found.rows["slave"]["slot"][-1] < 3500 < found.rows["slave@2"]["slot"][0]
    assert found.rows["slave@2"]["inlets"]["newest"][-1, 0] > 3500
    alone = found.silence("master")[: found.rows["slave@2"]["slot"][0]]
    assert alone.max() > 0.5  # and its edge faded; no torque of its arm depends on the other
    assert found.counts("master")["ok"] > 1000


def test_a_frozen_node_does_late_what_it_missed(runs: dict[str, Found]):
    found = runs["frozen"]
    assert found.reports["slave"]["end"] == "finished"
    assert found.reports["slave"]["missed"] > 900
    for node in ARMS:
        assert len(found.rows[node]) == 14000  # every slot, some of them late
        assert 0.8 < found.silence(node).max() < 1.5
    assert found.counts("master")["ok"] > 2600  # what it sent late has come


def test_one_that_was_frozen_for_longer_than_it_may_says_so(runs: dict[str, Found]):
    found = runs["too long"]
    assert found.reports["slave"]["end"] == "fault"
    assert found.reports["slave"]["reasons"] == ["overrun"]
    assert found.reports["master"]["end"] == "finished"
    assert LifeState.FAULT in found.rows["slave"]["state"]


def test_what_a_connection_held_back_is_dropped_by_its_age(runs: dict[str, Found]):
    """TCP gives seconds-old samples after an outage. The slave takes them: it has no max_age."""
    found = runs["stale"]
    assert found.taken_at("slave").max() > 2.0
    assert found.taken_at("master").max() <= 1.5
    assert found.counts("master")["stale"] > 20 and found.counts("slave")["stale"] == 0


def test_a_router_goes_away_and_comes_back(runs: dict[str, Found]):
    found = runs["router"]
    assert len(found.packets("master>slave")) == 0  # all of it went through the router
    for node in ARMS:
        counts = found.counts(node)
        assert counts["lost"] > 150 and counts["ok"] > 1000
        assert found.silence(node).max() > 1.0
        assert {int(s) for s in found.rows[node]["state"]} == {LifeState.ACTIVE}
