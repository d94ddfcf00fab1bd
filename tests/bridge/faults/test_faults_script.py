"""Fault scripts: read, refused with a place, and turned into rules and events."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from msgspec import structs

from bridge.campaign.spec import load_campaign
from bridge.deployment import spec
from bridge.deployment.carried import Subscription
from bridge.faults.load import SPECS, SyncLossSpec, build, load
from bridge.faults.script import FaultEvent
from bridge.native import faults as native
from bridge.native.bus import ALL_BITS, FORMAT, KIND, Accept
from bridge.native.frame import Flags, Frame
from cosim.base.errors import ScenarioError

FOLDER = Path(__file__).parents[3] / "configs" / "faults"
FD = {"flags": Flags.FD, "flag_mask": FORMAT}
IDS = [
    Subscription("left", "SYNC", Accept(0x80, flag_mask=FORMAT)),
    Subscription("left", "LINK_1", Accept(0x3A1, **FD)),
    Subscription("left", "LINK_2", Accept(0x3A2, **FD)),
    Subscription("left", "STATE_1", Accept(0x4A1, **FD)),
    Subscription("left", "FAR", Accept(0x123, flags=Flags.EXTENDED, flag_mask=FORMAT)),
    Subscription("right", "NMT", Accept(0x3A1, flag_mask=FORMAT)),
]


def script(text, seed=1):
    return build(tomllib.loads(f"seed = {seed}\n{text}"), Path("x.toml"))


def fault(**said):
    return build({"fault": [said]}, Path("x.toml"))


def said(accept):
    return accept.id, accept.mask, accept.flags, accept.flag_mask


def rules(found):
    assert found is not None
    return list(found.injector.rules)


# ---- frames ----


def test_the_example_of_the_docs():
    s = script(
        """
        [[fault]]
        kind = "jitter"
        node = ["slave_control", "master"]
        message = "LINK_1"
        from = "5 s"
        to = "10 s"
        probability = "20 %"
        by = ["5 ms", "20 ms"]
        """
    )
    (r,) = rules(s.frames_for("slave_control", IDS))
    assert (r.kind, said(r.accept)) == (native.JITTER, (0x3A1, ALL_BITS, Flags.FD, FORMAT))
    assert (r.t0_ns, r.t1_ns, r.probability) == (5 * 10**9, 10 * 10**9, 0.2)
    assert (r.a, r.b, r.bus, r.count) == (0.005, 0.02, -1, 1)
    assert s.frames_for("slave", IDS) is None


@pytest.mark.parametrize(
    "message, expected",
    [
        ("*", [(0, 0, 0, 0)]),
        ("LINK_*", [(0x3A1, ALL_BITS, Flags.FD, FORMAT), (0x3A2, ALL_BITS, Flags.FD, FORMAT)]),
        (["LINK_2", "LINK_2*", 0x3A2], [(0x3A2, ALL_BITS, Flags.FD, FORMAT)]),
        (0x3A1, [(0x3A1, ALL_BITS, 0, FORMAT), (0x3A1, ALL_BITS, Flags.FD, FORMAT)]),
        (0x3A3, [(0x3A3, ALL_BITS, 0, KIND)]),
        (0x80000080, [(0x80, ALL_BITS, Flags.EXTENDED, KIND)]),  # not SYNC
        (0x12345, [(0x12345, ALL_BITS, Flags.EXTENDED, KIND)]),
        (0x80000123, [(0x123, ALL_BITS, Flags.EXTENDED, FORMAT)]),  # FAR
        (0x123, [(0x123, ALL_BITS, 0, KIND)]),  # not FAR
        ("FAR", [(0x123, ALL_BITS, Flags.EXTENDED, FORMAT)]),
        ("NOTHING", []),
    ],
)
def test_messages_are_named_by_name_pattern_or_identifier(message, expected):
    found = fault(kind="drop", message=message).frames_for("n", IDS)
    assert sorted([] if found is None else [said(r.accept) for r in rules(found)]) == expected


def test_a_name_is_hit_on_its_bus_only():
    """On two buses a name may have two identifiers, and another message the same one."""
    both = [*IDS, Subscription("right", "SYNC", Accept(0x3A2, flag_mask=FORMAT))]
    found = rules(fault(kind="sync-loss").frames_for("n", both, {"left": 0, "right": 1}))
    assert [(r.accept.id, r.bus) for r in found] == [(0x80, 0), (0x3A2, 1)]
    assert found[0].random != found[1].random
    (nmt,) = rules(
        fault(kind="drop", message=0x3A1, bus="right").frames_for("n", IDS, {"right": 1})
    )
    assert (said(nmt.accept), nmt.bus) == ((0x3A1, ALL_BITS, 0, FORMAT), 1)


def test_sync_loss_drops_sync():
    (r,) = rules(fault(kind="sync-loss", node="a").frames_for("a", IDS))
    assert (r.kind, r.accept.id, r.t1_ns) == (native.DROP, 0x80, native.FOREVER)


def test_a_fault_of_one_bus():
    s = fault(kind="drop", bus="left")
    assert rules(s.frames_for("n", IDS, {"right": 0, "left": 1}))[0].bus == 1
    assert s.frames_for("n", IDS, {"right": 0}) is None


def test_generators_differ_by_seed_table_node_and_message():
    text = '[[fault]]\nkind = "drop"\nmessage = "LINK_*"\n' * 2
    states = [
        r.random
        for seed in (1, 2)
        for node in ("a", "b")
        for r in rules(script(text, seed).frames_for(node, IDS))
    ]
    assert len(states) == len(set(states)) == 16
    again = [r.random for r in rules(script(text).frames_for("a", IDS))]
    assert again == states[:4]


def test_hits_are_counted_by_table():
    s = script(
        '[[fault]]\nkind = "kill"\nnode = "a"\nat = 1\n[[fault]]\nkind = "drop"\nmessage = "LINK_*"'
    )
    found = s.frames_for("a", IDS)
    assert found is not None and found.hits() == {1: 0}
    for identifier in (0x3A1, 0x3A2, 0x4A1):
        found.injector.put(Frame.of(identifier, b"x", Flags.FD, 10), 5)
    assert found.hits() == {1: 2}


@pytest.mark.parametrize("strange", [0, *Flags])
def test_a_rule_is_for_frames_in_the_format_of_its_message(strange):
    """LINK_1 is a CAN FD frame; how fast it was sent, and by whom, does not matter."""
    found = fault(kind="drop", message="LINK_1").frames_for("a", IDS)
    found.injector.put(Frame.of(0x3A1, b"x", Flags.FD ^ strange, 10), 5)
    assert found.hits() == {0: 1 - bool(strange & FORMAT)}


# ---- events ----


@pytest.mark.parametrize(
    "said, expected",
    [
        ({"kind": "kill", "node": "a", "at": "2 s"}, [(2, "kill", "a")]),
        (
            {"kind": "restart", "node": ["a", "b"], "at": 2, "for": "500 ms"},
            [(2, "kill", "a"), (2, "kill", "b"), (2.5, "start", "a"), (2.5, "start", "b")],
        ),
        ({"kind": "restart", "node": "a", "at": 2}, [(2, "kill", "a"), (2, "start", "a")]),
        (
            {"kind": "freeze", "node": "*", "at": 1, "for": 1},
            [(1, "freeze", "a"), (1, "freeze", "b"), (2, "thaw", "a"), (2, "thaw", "b")],
        ),
        (
            {"kind": "bus-down", "bus": "*", "at": 1, "for": 1},
            [(1, "bus-down", "left"), (2, "bus-up", "left")],
        ),
    ],
)
def test_events_are_in_the_order_of_time(said, expected):
    events = fault(**said).process_events(["a", "b"], ["left"])
    assert [(e.t, e.action, e.target) for e in events] == expected


def test_a_babbling_peer_ends_or_does_not():
    said = {"kind": "babble", "bus": "left", "id": 0x10, "rate": "2 kHz", "from": 1}
    babble = FaultEvent(1.0, "babble", "left", 0, id=0x10, rate=2000.0, length=8)
    assert fault(**said).process_events() == (babble,)
    assert fault(**said, to=3).process_events() == (babble, FaultEvent(3.0, "hush", "left", 0))


def test_a_clock_may_jump_back():
    (event,) = fault(kind="clock-jump", node="a", at=1, by="-20 ms").process_events()
    assert (event.action, event.by) == ("clock-jump", -0.02)


# ---- refused ----


@pytest.mark.parametrize(
    "said, key, message",
    [
        ({}, "kind", "no kind; expected one of drop"),
        ({"kind": "dorp"}, "kind", "unknown kind 'dorp'; expected one of drop"),
        ({"kind": "drop", "by": 1}, "", "no key 'by' (there are: bus, from, kind"),
        ({"kind": "kill", "node": "a", "at": 1, "for": 2}, "", "no key 'for'"),
        ({"kind": "kill", "node": "a"}, "", "the key 'at' is missing"),
        ({"kind": "delay"}, "", "the key 'by' is missing"),
        ({"kind": "drop", "probability": 1.5}, "probability", "is 1.5; expected 0 to 1"),
        ({"kind": "drop", "from": -1}, "from", "is -1; expected 0 or more"),
        ({"kind": "drop", "from": "5 s", "to": "5 s"}, "to", "is 5 s; expected more than from"),
        ({"kind": "drop", "from": "5 m"}, "from", "cannot feed"),
        ({"kind": "jitter", "by": ["2 ms", "1 ms"]}, "by", "expected [least, greatest]"),
        ({"kind": "jitter", "by": -1}, "by", "is -1; expected 0 or more"),
        ({"kind": "corrupt", "count": 0}, "count", ">= 1"),
        ({"kind": "babble", "bus": "l", "id": 1, "rate": 0}, "rate", "is 0; expected 0.001 to"),
        ({"kind": "drop", "from": float("nan")}, "from", "is nan"),
    ],
)
def test_what_cannot_be_is_refused_with_its_place(said, key, message):
    with pytest.raises(ScenarioError) as caught:
        fault(**said)
    assert str(caught.value).startswith(f"x.toml at fault.0{'.' if key else ''}{key}")
    assert message in str(caught.value)


def test_unknown_tables_are_refused():
    with pytest.raises(ScenarioError, match="unknown key 'faults'; expected title, seed or fault"):
        build({"faults": []}, Path("x.toml"))
    with pytest.raises(ScenarioError, match=r"expected an array of tables, \[\[fault\]\]"):
        build({"fault": {}}, Path("x.toml"))


@pytest.mark.parametrize(
    "said, message",
    [
        (
            {"kind": "drop", "node": "slav"},
            "fault.0.node: no node 'slav'; did you mean 'slave'? (there are: master",
        ),
        ({"kind": "drop", "message": "LINK_9"}, "fault.0.message: no message 'LINK_9'"),
        ({"kind": "drop", "message": "X_*"}, "no message 'X_*'"),
        ({"kind": "drop", "bus": "up"}, "fault.0.bus: no bus 'up' (there are: left"),
        ({"kind": "kill", "node": "x", "at": 1}, "fault.0.node: no node 'x'"),
        ({"kind": "bus-down", "bus": "x", "at": 1, "for": 1}, "fault.0.bus: no bus 'x'"),
    ],
)
def test_names_that_are_not_there_are_refused(said, message):
    with pytest.raises(ScenarioError) as caught:
        fault(**said).check(["master", "slave"], ["left"], [one.name for one in IDS])
    assert message in str(caught.value)


# ---- the scripts that come along ----


def test_there_is_a_script_of_every_kind():
    campaign = load_campaign(FOLDER / "campaign.toml")
    here = {kind for kind in SPECS if not kind.startswith("net-")}  # those need hosts: cosim soak
    here -= {"noise"}  # needs an image
    assert {run.script.removesuffix(".toml") for run, _ in campaign.runs} == here
    others = {"campaign.toml", "many.toml", "soak.toml", "soak-can.toml", "soak-mixed.toml"}
    others |= {"buses.toml", "buses-campaign.toml"}
    files = {p.name for p in FOLDER.glob("*.toml")} - others
    assert {run.script for run, _ in campaign.runs} == files
    assert campaign.scenario.resolve().is_file()
    for run, found in campaign.runs:
        kinds = {f.kind for f in found.frames} or {run.script.removesuffix(".toml")}
        assert kinds == {run.script.removesuffix(".toml")}
        assert found.frames or found.events or found.drives
        assert found.title and load(FOLDER / run.script) == found


def test_the_scripts_name_what_the_deployment_has():
    campaign = load_campaign(FOLDER / "campaign.toml")
    d = spec.load(spec.find(campaign.scenario, campaign.deploy))
    for _, found in campaign.runs:
        found.check(list(d.nodes), list(d.buses), [*d.messages, "SYNC"])


@pytest.mark.parametrize(
    "run, message",
    [
        ('script = "drop.toml"\nends = "sometime"', "run[0].ends"),
        (
            'script = "drop.toml"\nsees = ["ghosts"]',
            "run.0.sees: unknown 'ghosts'; expected one of",
        ),
        ('script = "drop.toml"\nends = "stopped"\nbecause = ["x"]', "run.0.because: unknown 'x'"),
        ('script = "drop.toml"\nnode = "a"', "run.0.ends: node and because describe a stop"),
        ('script = "none.toml"', "none.toml: no such file"),
    ],
)
def test_a_campaign_that_cannot_be_is_refused(tmp_path, run, message):
    (tmp_path / "drop.toml").write_text('[[fault]]\nkind = "drop"\n')
    path = tmp_path / "c.toml"
    path.write_text(f'scenario = "x.toml"\ndeploy = "can"\n[[run]]\n{run}\n')
    with pytest.raises(ScenarioError) as caught:
        load_campaign(path)
    assert message in str(caught.value)


# ---- the page ----

PAGE = (Path(__file__).parents[3] / "docs" / "faults.md").read_text(encoding="utf-8")


def test_the_example_on_the_page_is_read():
    example = PAGE.partition("```toml\n")[2].partition("```")[0]
    found = build(tomllib.loads(example), Path("faults.md"))
    assert [f.kind for f in found.frames] == ["drop"]
    assert [e.action for e in found.events] == ["freeze", "thaw"]


@pytest.mark.parametrize("kind", SPECS)
def test_the_page_has_every_kind_and_its_keys(kind):
    (row,) = (line for line in PAGE.splitlines() if line.startswith(f"| `{kind}` |"))
    common = {"kind", "node", "message", "bus", "from", "to", "probability"}
    process = {"kind"}
    for field in structs.fields(SPECS[kind]):
        known = common if issubclass(SPECS[kind], SyncLossSpec) else process
        assert field.encode_name in known or f"`{field.encode_name}`" in row
