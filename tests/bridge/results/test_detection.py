"""Every fault is held against what the report shows of it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from bridge.deployment.system import load_system
from bridge.native import faults as native
from bridge.native.bus import Accept
from bridge.native.faults import INJECTED
from bridge.native.frame import Flags, Frame, frame_dtype
from bridge.native.journal import Journal
from bridge.native.safety import LifeState, Status
from bridge.records.node_lives import ByLife, Life
from bridge.records.records import Done, Missed, Refused
from bridge.rehearsal import injector
from bridge.relay.router import PACKET, TCP, UDP
from bridge.results.detection import find
from bridge.results.detection_links import RecordedNetwork
from bridge.results.findings import Sign
from bridge.results.symptoms import SIGNS, FinishedRun
from bridge.wiring.wiring import row_dtype
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from tests.bridge.faulty import BOTH, SCENARIO, report, script, shown
from tests.bridge.rehearsing import ROOT


@pytest.fixture(scope="module")
def system():
    return load_system(SCENARIO, "zenoh", ["run.step='5 ms'", "run.stop='10 s'"])


def injected(
    system, folder, n, kind, t=2.0, copies=1, changed=False, wait=0.0, state=LifeState.ACTIVE
):
    """The record of `n` frames of xi_slave at the master, 5 ms apart."""
    encoding = system.messages["xi_slave"].encoding
    data = encoding.encode(np.zeros(len(encoding.signals)), int(state) | Status.SIMULATED)
    rows = np.zeros(n, INJECTED)
    rows["data"][:, : len(data)], rows["length"] = list(data), len(data)
    rows["t_ns"] = (t + 0.005 * np.arange(n)) * 1e9
    rows["through_ns"] = rows["t_ns"] + round(wait * 1e9)
    rows["id"] = system.messages["xi_slave"].encoding.message.id
    rows["kinds"], rows["copies"], rows["crc_after"] = 1 << kind, copies, changed
    with Journal.create(folder / "master.faults", INJECTED, max(n, 1)) as journal:
        for row in rows:
            journal.append(*row)


AGAIN = Life("slave", 2)


def done(t, action, target="slave", by=0.0):
    """What a rehearsal notes when an event of a script was carried out."""
    return Done(t=t, action=action, target=target, by=by)


def drop(**more):
    return {"kind": "drop", "node": "master", "message": "xi_slave", "from": 1, "to": 5, **more}


@pytest.mark.parametrize(
    ("frames", "counts", "verdict"),
    [(40, {"lost": 41}, "seen"), (40, {"lost": 3}, "unseen"), (0, {"lost": 9}, "idle")],
)
def test_frames_that_were_dropped_have_to_be_counted_as_lost(
    system, tmp_path, frames, counts, verdict
):
    injected(system, tmp_path, frames, native.DROP, copies=0)
    (found,) = find(script(drop()), shown(system, tmp_path, counts))
    assert (found.verdict, found.done) == (verdict, frames)
    assert found.kind in found.text() and found.facts()["verdict"] == verdict


@pytest.mark.parametrize(
    ("state", "verdict"), [(LifeState.INACTIVE, "idle"), (LifeState.ACTIVE, "unseen")]
)
def test_a_preview_is_no_sample_that_a_fault_could_take(system, tmp_path, state, verdict):
    """A node that was started again repeats its first values until it joins; nobody counts them."""
    injected(system, tmp_path, 9, native.DROP, copies=0, state=state)
    (found,) = find(script(drop()), shown(system, tmp_path))
    assert found.verdict == verdict


@pytest.mark.parametrize(
    ("kind", "number", "counts", "done"),
    [
        ("corrupt", native.CORRUPT, {"crc": 20}, {"changed": True}),
        ("corrupt", native.CORRUPT, {"length": 1, "crc": 19}, {"changed": True}),
        ("duplicate", native.DUPLICATE, {"repeated": 12, "reordered": 8}, {"copies": 2}),
        ("reorder", native.REORDER, {"reordered": 18}, {}),
        ("burst", native.BURST, {"lost": 20}, {"copies": 0}),
    ],
)
def test_each_kind_has_counters_of_its_own(system, tmp_path, kind, number, counts, done):
    injected(system, tmp_path, 20, number, **done)
    more = {"probability": 0.5}
    given = script(drop(kind=kind, **more))
    assert find(given, shown(system, tmp_path, counts))[0].verdict == "seen"
    others = {"ok": 99, "simulated": 5}
    assert find(given, shown(system, tmp_path, others))[0].verdict == "unseen"


def test_a_delay_shows_in_the_time_on_the_way(system, tmp_path):
    injected(system, tmp_path, 20, native.DELAY, wait=0.3)
    given, run = script(drop(kind="delay", by=0.3)), shown(system, tmp_path)
    assert find(given, run)[0].verdict == "unseen"
    run.rows["master"]["inlets"]["transit_ns"][450:460, 0] = 301_000_000
    assert find(given, run)[0].shown == ("master xi_slave: up to 301 ms on the way",)


def test_a_delay_shows_as_silence_where_what_was_held_up_came_with_what_was_sent_later(
    system, tmp_path
):
    injected(system, tmp_path, 20, native.DELAY, wait=0.3)  # the last from 2.095 s to 2.395 s
    given, run = script(drop(kind="delay", by=0.3)), shown(system, tmp_path)
    newest = run.rows["master"]["inlets"]["newest"]
    newest[440:479, 0] = 439
    assert find(given, run)[0].verdict == "unseen"
    newest[424:479, 0] = 423
    assert find(given, run)[0].verdict == "seen"


def test_a_frame_that_another_fault_has_hidden_is_none_of_this_one(system, tmp_path):
    injected(system, tmp_path, 20, native.DUPLICATE, copies=0)  # dropped by a later rule
    (found,) = find(script(drop(kind="duplicate")), shown(system, tmp_path))
    assert found.verdict == "idle"


def test_a_frozen_node_is_late(system, tmp_path):
    given = script({"kind": "freeze", "node": "slave", "at": 2, "for": 0.5})
    run = shown(system, tmp_path, notes=[done(2.011, "freeze"), done(2.512, "thaw")])
    assert find(given, run)[0].verdict == "unseen"
    run.rows["slave"]["woke_ns"][400:402] = 480_000_000
    assert find(given, run)[0].shown == ("slave: 0.48 s late",)


def test_a_fault_lasts_as_long_as_it_was_done_not_as_long_as_it_was_planned(system, tmp_path):
    """A busy machine carries out both of its ends late, and not equally so."""
    given = script({"kind": "freeze", "node": "slave", "at": 2, "for": 0.5})
    run = shown(system, tmp_path, notes=[done(2.2, "freeze"), done(2.502, "thaw")])
    run.rows["slave"]["woke_ns"][440:442] = 290_000_000
    assert find(given, run)[0].verdict == "seen"


@pytest.mark.parametrize(("t", "verdict"), [(9.9, "unseen"), (10.2, "idle")])
def test_a_kill_that_comes_when_its_node_is_over_has_nothing_to_act_on(
    system, tmp_path, t, verdict
):
    given = script({"kind": "kill", "node": "slave", "at": 9.5})
    run = shown(system, tmp_path, notes=[done(t, "kill")])
    assert find(given, run)[0].verdict == verdict


@pytest.mark.parametrize("by", [0.5, -0.5])
def test_a_clock_that_was_set_shows_as_lateness_a_stop_or_silence(system, tmp_path, by):
    given = script({"kind": "clock-jump", "node": "slave", "at": 2, "by": by})
    run = shown(system, tmp_path, notes=[done(2.0, "clock-jump")])
    assert find(given, run)[0].verdict == "unseen"
    run.rows["slave"]["woke_ns"][400] = 480_000_000
    assert find(given, run)[0].shown == ("slave: 0.48 s late",)
    run.rows["slave"]["woke_ns"][400] = 0
    run.rows["master"]["inlets"]["newest"][400:500, 0] = 399
    assert find(given, run)[0].shown == ("slave: nothing for 0.50 s",)
    stopped = replace(run, reports=[report(Life("slave"), "fault")])
    assert find(given, stopped)[0].shown == ("slave: slave has stopped",)


def test_a_second_life_is_seen_and_an_event_that_never_came_is_idle(system, tmp_path):
    given = script({"kind": "restart", "node": "slave", "at": 2, "for": 0.5})
    assert find(given, shown(system, tmp_path))[0].verdict == "idle"
    run = shown(system, tmp_path, notes=[done(2.001, "kill"), done(2.502, "start")])
    assert find(given, run)[0].verdict == "unseen"
    for note in (Missed(t=10.1, life=AGAIN), Refused(t=3.0, life=AGAIN, reasons=("apart",))):
        late = replace(run, notes=[*run.notes, note])
        assert find(given, late)[0].places[0].signs == (
            Sign(what="refusal", life=AGAIN, note=note),
        )
    both = {**run.rows, AGAIN: run.rows["slave"][600:]}
    assert find(given, replace(run, rows=both))[0].shown == ("slave: slave@2 began",)


def packets(n, lost=0, delay=0.0, protocol=UDP):
    """Of xi_slave on its way to the master, from 2 s on; the first are lost."""
    rows = np.zeros(n, PACKET)
    rows["t_ns"] = (2.0 + 0.005 * np.arange(n)) * 1e9
    rows["delay_ns"], rows["length"] = round(delay * 1e9), 98
    rows["protocol"] = protocol
    rows["left_ns"] = rows["t_ns"] + rows["delay_ns"]
    rows["delay_ns"][:lost] = rows["left_ns"][:lost] = -1
    there = {"slave>master": rows, "master>slave": rows[:0]}
    recorded = SimpleNamespace(names=BOTH, of=there.__getitem__)
    return RecordedNetwork(recorded, {n: (n,) for n in ("master", "slave")}, 0)


def test_faults_of_a_network_show_at_the_far_end(system, tmp_path):
    def judged(table, network, counts=None, change=lambda inlets: None):
        run = shown(system, tmp_path, counts, notes=[done(2.0, table["kind"], "slave>master")])
        change(run.rows["master"]["inlets"][:, 0])
        given = script({"link": "slave>master", "at": 2, "for": 1, **table})
        return find(given, run, network)[0].verdict

    def silent(inlets):
        inlets["newest"][400:600] = 399

    def overtaken(inlets):
        """What was held up comes when faster samples have: only that nothing came is seen."""
        inlets["newest"][400:438] = 399

    def by_a_clock_ahead(inlets):
        inlets["transit_ns"] = -350_000_000
        inlets["transit_ns"][430:440] = -160_000_000

    def late(inlets):
        inlets["transit_ns"][430:440] = 200_000_000

    down = {"kind": "net-down"}
    assert judged(down, packets(200, lost=200)) == "unseen"
    assert judged(down, packets(200, lost=200), change=silent) == "seen"
    assert judged(down, packets(3, lost=3)) == "idle"
    slow = {"kind": "net-delay", "by": 0.2}
    assert judged(slow, packets(200, delay=0.2)) == "unseen"
    assert judged(slow, packets(200, delay=0.2), change=late) == "seen"
    assert judged(slow, packets(200, delay=0.2), change=overtaken) == "seen"
    assert judged(slow, packets(200, delay=0.2), change=by_a_clock_ahead) == "seen"
    loss = {"kind": "net-loss", "probability": 0.3}
    assert judged(loss, packets(200, lost=60)) == "unseen"
    assert judged(loss, packets(200, lost=60), {"lost": 60}) == "seen"
    assert judged(loss, packets(200, lost=60, protocol=TCP)) == "idle"  # it repeats them


def test_a_link_is_silent_from_when_the_last_packet_on_its_way_has_come(system, tmp_path):
    run = shown(system, tmp_path, notes=[done(2.0, "net-down", "slave>master")])
    given = script({"kind": "net-down", "link": "slave>master", "at": 2, "for": 1})
    network = packets(220, lost=220)
    rows = network.packets.of("slave>master")
    rows["t_ns"][:20] -= 200_000_000  # before the fault; held up for 0.5 s
    rows["delay_ns"][:20] = 500_000_000
    rows["left_ns"][:20] = rows["t_ns"][:20] + 500_000_000
    run.rows[Life("master")]["inlets"]["newest"][480:600, 0] = 479  # silent from 2.4 s on
    assert find(given, run, network)[0].verdict == "seen"
    rows["left_ns"][:20] = rows["t_ns"][:20]
    assert find(given, run, network)[0].verdict == "unseen"


@pytest.mark.parametrize("by", [0.0, 0.35, -0.35])
def test_the_times_of_a_node_whose_clock_was_set_are_those_of_the_run(system, tmp_path, by):
    """The network is down from 2 s to 2.3 s; who hears nothing says so by a clock of its own."""
    notes = [done(1.0, "clock-jump", "master", by), done(2.0, "net-down", "slave>master")]
    run = shown(system, tmp_path, notes=notes)
    first = round((2.0 + by) / 0.005)
    run.rows[Life("master")]["inlets"]["newest"][first : first + 60, 0] = first - 1
    given = script({"kind": "net-down", "link": "slave>master", "at": 2, "for": 0.3})
    assert find(given, run, packets(60, lost=60))[0].verdict == "seen"


@pytest.mark.parametrize(
    ("target", "transit", "verdict"),
    [("slave", -0.14, "seen"), ("slave", -0.30, "unseen"), ("master", 0.36, "unseen"),
     ("master", 0.55, "seen"), ("nobody", -0.14, "unseen")],
)  # fmt: skip
def test_an_age_is_that_of_clocks_that_were_not_set(system, tmp_path, target, transit, verdict):
    """The network holds up samples by 0.2 s, and a clock is ahead by 0.35 s."""
    notes = [done(1.0, "clock-jump", target, 0.35), done(2.5, "net-delay", "slave>master")]
    run = shown(system, tmp_path, notes=notes)
    undisturbed = {"slave": -349_000_000, "master": 351_000_000, "nobody": 1_000_000}[target]
    run.rows["master"]["inlets"]["transit_ns"][:, 0] = undisturbed
    run.rows["master"]["inlets"]["transit_ns"][500:700, 0] = round(transit * 1e9)
    given = script({"kind": "net-delay", "link": "slave>master", "at": 2.5, "for": 1, "by": 0.2})
    network = packets(300, delay=0.2)
    network.packets.of("slave>master")["t_ns"] += 500_000_000
    network.packets.of("slave>master")["left_ns"] += 500_000_000
    assert find(given, run, network)[0].verdict == verdict


def test_a_frame_fault_is_looked_for_by_the_clock_of_the_node_that_met_it(system, tmp_path):
    injected(system, tmp_path, 20, native.DELAY, wait=0.3)
    given = script(drop(kind="delay", by=0.3, **{"from": 2, "to": 2.1}))
    run = shown(system, tmp_path, notes=[done(1.0, "clock-jump", "master", 0.35)])
    run.rows["master"]["inlets"]["transit_ns"][402:406, 0] = 301_000_000  # 2.01 s of its own
    assert find(given, run)[0].verdict == "seen"


def test_packets_that_come_when_their_receiver_is_gone_show_nowhere(system, tmp_path):
    """A slow link holds them longer and longer; the master is killed when the first have come."""
    run = shown(system, tmp_path, notes=[done(2.0, "net-rate", "slave>master")])
    given = script({"kind": "net-rate", "link": "slave>master", "at": 2, "for": 1, "rate": 1e5})
    network = packets(200)
    rows = network.packets.of("slave>master")
    rows["left_ns"] = rows["t_ns"] + np.linspace(0, 1_000_000_000, 200).astype(np.int64)
    transit = run.rows[Life("master")]["inlets"]["transit_ns"]
    transit[400:600, 0] = np.linspace(0, 500_000_000, 200)
    run.rows[Life("master")]["inlets"]["newest"][400:600, 0] = np.arange(400, 600)
    assert find(given, run, network)[0].verdict == "seen"
    transit[400:600, 0] = np.linspace(0, 200_000_000, 200)  # not as late as packets were
    assert find(given, run, network)[0].verdict == "unseen"
    run.rows[Life("master")] = run.rows[Life("master")][:480]  # gone at 2.4 s
    transit = run.rows[Life("master")]["inlets"]["transit_ns"]
    transit[400:480, 0] = np.linspace(0, 200_000_000, 80)
    assert find(given, run, network)[0].verdict == "seen"


def test_packets_of_a_sender_that_does_not_run_carry_no_sample(system, tmp_path):
    run = shown(system, tmp_path, notes=[done(2.0, "net-loss", "slave>master")])
    given = script(
        {"kind": "net-loss", "link": "slave>master", "at": 2, "for": 1, "probability": 0.3}
    )
    network = packets(200, lost=60)
    assert find(given, run, network)[0].verdict == "unseen"
    run.rows[Life("slave")] = run.rows[Life("slave")][:390]  # killed before the loss
    assert find(given, run, network)[0].verdict == "idle"


def test_what_shows_a_fault_is_on_the_page():
    page = (ROOT / "docs" / "faults.md").read_text()
    for kind in SIGNS:
        assert f"\n| {kind} | " in page, kind


def test_a_message_of_zenoh_is_hit_by_its_name(system):
    """Its number is above all 11-bit identifiers, and yet no 29-bit one."""
    rules = script(drop()).frames_for("master", system.subscriptions("master"), {"net": 0})
    number = system.messages["xi_slave"].encoding.message.id
    rules.injector.put(Frame.of(number, bytes(40), 0, 2_000_000_000 + 1), 1)
    assert rules.hits() == {0: 1}


@pytest.mark.parametrize(
    ("health", "verdict"),
    [({"restarts": 1}, "unseen"), ({"restarts": 2}, "seen"), ({"send_failed": 9}, "unseen")],
)
def test_a_bus_that_was_down_twice_has_to_come_back_twice(tmp_path, health, verdict):
    system = load_system(SCENARIO, "can", ["run.step='5 ms'", "run.stop='10 s'"])
    down = {"kind": "bus-down", "bus": "right", "for": 0.3}
    notes = [done(1.0, "bus-down", "right"), done(3.0, "bus-down", "right")]
    run = shown(system, tmp_path, notes=notes)
    run = replace(run, reports=[report(Life("slave"), buses={"right": health})])
    found = find(script({**down, "at": 1}, {**down, "at": 3}), run)
    assert [evidence.verdict for evidence in found] == [verdict] * 2


def test_a_bus_that_went_down_behind_the_end_of_the_run_had_nothing_to_act_on(tmp_path):
    system = load_system(SCENARIO, "can", ["run.step='5 ms'", "run.stop='10 s'"])
    down = script({"kind": "bus-down", "bus": "right", "for": 0.3, "at": 9.9})
    for begun, verdict in ((9.9, "unseen"), (10.05, "idle")):
        run = shown(system, tmp_path, notes=[done(begun, "bus-down", "right")])
        run = replace(run, reports=[report(Life("slave"), buses={"right": {}})])
        (found,) = find(down, run)
        assert found.verdict == verdict


BABBLE = {"kind": "babble", "bus": "right", "id": 0x21, "rate": 100, "from": 1, "to": 2}


def logged(folder, life, *frames):
    """The log of a life on its right bus: (identifier, flags) of each frame."""
    with Journal.create(folder / Life(life).frames("right"), frame_dtype(), 16) as journal:
        for identifier, flags in frames:
            journal.append(0, identifier, flags, 0, 8, 0, 0, np.zeros(64, np.uint8))


def babbled(tmp_path, *, heard):
    """What is found of a babbling peer, of which the slave heard so many frames."""
    system = load_system(SCENARIO, "can", ["run.step='5 ms'", "run.stop='10 s'"])
    one = system.messages["STATE_3"].encoding.message.id
    logged(tmp_path, "slave", (one, Flags.SENT), *[(0x21, 0)] * heard, (0x21, Flags.EXTENDED))
    logged(tmp_path, "slave_control", (one, 0), *[(0x21, 0)] * heard)
    notes = [done(1.0, "babble", "right")]
    (found,) = find(script(BABBLE), shown(system, tmp_path, notes=notes))
    return found


def test_a_babbling_peer_is_seen_by_frames_that_no_node_has_sent(tmp_path):
    found = babbled(tmp_path, heard=3)
    assert found.verdict == "seen" and found.places[0].signs == (Sign(what="frames", number=3),)


def test_frames_for_other_nodes_are_no_sign_of_a_babbling_peer(tmp_path):
    assert babbled(tmp_path, heard=0).verdict == "unseen"


def test_what_another_node_has_sent_is_no_sign_of_a_babbling_peer(tmp_path):
    system = load_system(SCENARIO, "can", ["run.step='5 ms'", "run.stop='10 s'"])
    one = system.messages["STATE_3"].encoding.message
    logged(tmp_path, "slave", *[(one.id, Flags.SENT | one.flags)] * 4)
    logged(tmp_path, "slave_control", *[(one.id, one.flags)] * 5)
    told = shown(system, tmp_path)
    assert told.foreign_frames("right", Accept.of(one)) == 1
    assert told.foreign_frames("left", Accept.of(one)) == 0


class Told:
    """A network that keeps what it was told."""

    names = BOTH

    def __init__(self):
        self.links = {}

    def set(self, link, **spec):
        self.links[link] = spec


def test_faults_of_one_link_add_up_and_end_one_by_one(system):
    network = Told()
    given = script(
        {"kind": "net-rate", "at": 1, "for": 3, "rate": 1e5},
        {"kind": "net-down", "at": 2, "for": 1, "link": "master>slave"},
    )
    told = []
    for event in injector.events(given, system, network):
        event.action(None)
        told.append(dict(network.links))
    rate, both = {"rate": 1e5}, {"rate": 1e5, "down": True}
    assert told[0] == dict.fromkeys(BOTH, rate)
    assert told[1] == {"master>slave": both, "slave>master": rate}
    assert told[2] == told[0] and told[3] == {link: {} for link in BOTH}


def test_a_network_that_is_not_there_is_an_error(system):
    given = script({"kind": "net-down", "at": 1, "for": 1, "link": "slave>x"})
    with pytest.raises(
        ScenarioError, match=r"fault\.0\.kind: net-down needs nodes on separate hosts"
    ):
        injector.events(given, system)
    with pytest.raises(ScenarioError, match=r"fault\.0\.link: no link 'slave>x'; there are: mas"):
        injector.events(given, system, Told())
    with pytest.raises(ScenarioError, match='expected "FROM>TO"'):
        script({"kind": "net-down", "at": 1, "for": 1, "link": "slave"})


@pytest.mark.parametrize(("gone", "seen"), [("", True), ("left_gateway", False), ("slave", True)])
def test_an_age_at_a_gateway_is_seen_where_what_it_forwards_arrives(tmp_path, gone, seen):
    """LINK_4 goes from right_gateway over left_gateway to master_control, as XI_4."""
    gateways = load_system(SCENARIO, "gateway", ["run.stop='10 s'"])
    rows = ByLife()
    for name, plan in gateways.nodes.items():
        rows[Life(name)] = np.zeros(
            plan.slots if name != gone else plan.slots // 2, row_dtype(plan)
        )
        rows[Life(name)]["slot"] = np.arange(len(rows[Life(name)]))
    run = FinishedRun(gateways, rows, [], tmp_path, [])
    assert run.arrives(Life("right_gateway"), "LINK_4", 6.0, 6.5) is seen
