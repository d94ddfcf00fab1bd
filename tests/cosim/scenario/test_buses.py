"""Links on simulated CAN buses: exact delays, priority, losses, errors, and what is refused."""

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import ScenarioError
from cosim.bus.frames import BusEvent
from cosim.bus.traffic import RandomSource
from cosim.checks.preflight import check
from cosim.cli.show import BusAccountOptions, show
from cosim.engine.simulate import simulate
from cosim.links.traces import BusDelays
from cosim.loading.files import load
from cosim.record import Run
from cosim.scenario.assemble import assemble, scenario_components
from cosim.scenario.buses import bus_history
from cosim.scenario.connect_links import frames_on_buses
from cosim.scenario.spec import as_data, build

ROOT = Path(__file__).parents[3]

HEAD = """
title = "Two senders on one bus"
[run]
step = "1 ms"
stop = "2 s"
[components.plant]
model = "tests.cosim.blocks:Integrator"
[components.a]
model = "tests.cosim.blocks:Gain"
[components.b]
model = "tests.cosim.blocks:Gain"
[components.a.inputs]
u = "plant.y"
[bus.can0]
bitrate = 500e3
"""
LINKS = """
[[links]]
name = "urgent"
from = "a.y"
to = "plant.u"
bus = "can0"
frame = { id = 0x101, bytes = 8, data = "zeros" }
[[links]]
name = "other"
from = "plant.y"
to = "b.u"
bus = "can0"
frame = { id = 0x102, bytes = 8, data = "zeros" }
"""


def plan_of(tmp_path, bus="", links=LINKS, settings=()):
    path = tmp_path / "two.toml"
    path.write_text(HEAD + bus + links)
    loaded = load(path, list(settings))
    return loaded, assemble(loaded)


def delays(plan):
    return {x.name: x.table.law.delay for x in plan.links}


def test_the_urgent_frame_goes_first_and_the_other_waits_for_exactly_its_length(tmp_path):
    from cosim.bus.frames import BusFrame
    from cosim.bus.timing import frame_bits

    _, plan = plan_of(tmp_path)
    first, second = (frame_bits(i, bytes(8)).nominal for i in (0x101, 0x102))
    assert BusFrame(0x101, bytes(8)).length == 8
    found = delays(plan)
    np.testing.assert_allclose(found["urgent"], (first - 3) * 2e-6, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found["other"], (first + second - 3) * 2e-6, rtol=0, atol=1e-15)


def test_the_clock_of_a_sender_times_its_frames_and_a_receiver_too_far_off_gets_none(tmp_path):
    fast = "[bus.can0.nodes.a]\nclock_ppm = 1000\n"
    found, nominal = (delays(plan_of(tmp_path, bus)[1])["urgent"] for bus in (fast, ""))
    np.testing.assert_allclose(found, nominal / 1.001, rtol=1e-6, atol=0)
    with pytest.raises(ScenarioError, match="found no frame 0x101 that arrives"):
        plan_of(tmp_path, fast.replace("1000", "30000"))


def test_simulated_worst_stays_within_the_analysis_and_show_facts_say_how(tmp_path):
    _, plan = plan_of(tmp_path, links=LINKS.replace(', data = "zeros"', ""))
    for link in plan.links:
        facts = link.table.facts()["delay"]
        assert facts["computed"] == "ahead of the run"
        assert 0 < facts["simulated_worst"] <= facts["analysed_worst"]
        assert facts["lost"] == 0


LOAD = '[[bus.can0.traffic]]\nkind = "random"\nshare = 0.6\n'


def test_the_same_seed_gives_the_same_tables_and_another_does_not(tmp_path):
    first, again, other = (
        delays(plan_of(tmp_path, LOAD, settings=[f"run.seed={seed}"])[1]) for seed in (1, 1, 2)
    )
    for name in first:
        assert first[name].tobytes() == again[name].tobytes()
        assert first[name].tobytes() != other[name].tobytes()


def test_a_babbling_node_shuts_the_links_out_while_it_babbles(tmp_path):
    babbler = '[[bus.can0.traffic]]\nkind = "babbling"\nid = 1\nstart = 0.5\nstop = 1.0\n'
    _, plan = plan_of(tmp_path, babbler)
    late = delays(plan)["urgent"]
    assert np.isfinite(late[:490]).all()
    assert late[:490].max() < 1e-3
    worst = late[np.isfinite(late)].max()
    assert worst > 0.4


def test_a_fifo_queue_of_the_sender_inverts_priorities(tmp_path):
    """Behind a low-priority frame in the same queue, the urgent one waits for foreign traffic."""
    links = LINKS.replace('from = "plant.y"', 'from = "a.y"').replace("id = 0x102", "id = 0x702")
    links += '[[bus.can0.traffic]]\nkind = "periodic"\nid = 0x300\nperiod = "0.26 ms"\n'
    worst = {}
    for queue in ("sorted", "fifo"):
        node = f'[bus.can0.nodes.a]\nqueue = "{queue}"\n'
        _, plan = plan_of(tmp_path, node, links)
        arrived = delays(plan)["urgent"]
        worst[queue] = arrived[np.isfinite(arrived)].max()
    assert worst["fifo"] > worst["sorted"]


def test_a_sender_whose_bits_are_destroyed_goes_off_the_bus_and_comes_back(tmp_path):
    off = (
        '[[bus.can0.errors]]\nkind = "interruption"\nstart = 0.5\nstop = 0.52\n'
        'level = "recessive"\nnode = "a"\n'
    )
    loaded, plan = plan_of(tmp_path, off)
    late = delays(plan)["urgent"]
    assert late[:499].max() < 1e-3
    assert late[500] > 5e-3
    assert late[1500:].max() < 1e-3
    outcome = simulate(loaded, tmp_path / "run", plan=plan)
    assert outcome.ended is None
    assert Run.open(tmp_path / "run")


def test_links_of_one_channel_share_a_frame(tmp_path):
    links = LINKS.replace('name = "urgent"', 'name = "urgent"\nchannel = "x"')
    links = links.replace('name = "other"', 'name = "other"\nchannel = "x"')
    links = links.replace('from = "plant.y"', 'from = "a.y"')
    links = links.replace('frame = { id = 0x102, bytes = 8, data = "zeros" }', "")
    found = delays(plan_of(tmp_path, links=links)[1])
    assert found["urgent"].tobytes() == found["other"].tobytes()


def test_times_of_a_log_may_count_from_1970(tmp_path):
    found = []
    for first in (0, 1_436_509_052):
        lines = (f"({first + k // 1000}.{k % 1000:03}100) can0 050#00\n" for k in range(1900))
        (tmp_path / "bus.log").write_text("".join(lines))
        load = '[[bus.can0.traffic]]\nkind = "log"\nfile = "bus.log"\nstart = "0.1 ms"\n'
        found.append(delays(plan_of(tmp_path, load)[1])["urgent"])
    assert found[0].max() > found[0].min()
    assert found[0].tobytes() == found[1].tobytes()


def test_a_log_is_load(tmp_path):
    (tmp_path / "bus.log").write_text("(100.000000) can0 050#00\n(101.000500) can0 050##1AA55\n")
    log = 'fd = true\n[[bus.can0.traffic]]\nkind = "log"\nfile = "bus.log"\nstart = "1.00005 s"\n'
    quiet = delays(plan_of(tmp_path)[1])["other"]
    loaded = delays(plan_of(tmp_path, log)[1])["other"]
    assert (quiet != loaded).sum() == 1
    assert loaded[1000] > quiet[1000]


def logged_load(tmp_path, capsys, number):
    """The log of two.toml without the frames of its links, as traffic."""
    log = tmp_path / f"{number}.log"
    show(tmp_path / "two.toml", BusAccountOptions("can0", for_=2.2, log=log))
    lines = log.read_text().splitlines(keepends=True)
    assert f"log              {log}: {len(lines)} frames" in capsys.readouterr().out
    others = [x for x in lines if " 101#" not in x and " 102#" not in x]
    assert len(others) > 3000 and len(lines) - len(others) >= 2 * 2000
    log.write_text("".join(others))
    start = others[0].partition(")")[0].strip("(")
    return f'[[bus.can0.traffic]]\nkind = "log"\nfile = "{log.name}"\nstart = "{start} s"\n'


def test_a_run_with_its_recorded_log_as_load_is_the_same_run(tmp_path, capsys):
    """To the nanosecond of the log; a run whose load was a log, to the bit."""
    drawn = delays(plan_of(tmp_path, LOAD)[1])
    once = delays(plan_of(tmp_path, logged_load(tmp_path, capsys, 1))[1])
    twice = delays(plan_of(tmp_path, logged_load(tmp_path, capsys, 2))[1])
    assert len(set(drawn["other"])) > 100
    for name in ("urgent", "other"):
        np.testing.assert_allclose(drawn[name], once[name], rtol=0, atol=1.01e-9)
        assert once[name].tobytes() == twice[name].tobytes()


@pytest.mark.parametrize(
    ("content", "says"),
    [("(1.0) can0 050#0\n", "bus.log, line 1: found the data"), ("", "found no frames"),
     ("(1.0) can0 050##100\n", "CAN FD frames on a classic bus, expected one with fd")],
)  # fmt: skip
def test_a_log_that_is_none_is_refused_with_the_place_of_the_bus(tmp_path, content, says):
    (tmp_path / "bus.log").write_text(content)
    with pytest.raises(ScenarioError, match=says) as error:
        plan_of(tmp_path, '[[bus.can0.traffic]]\nkind = "log"\nfile = "bus.log"\n')
    assert "bus.can0" in str(error.value)


PERIODIC = '[[bus.can0.traffic]]\nkind = "periodic"\nid = 9\nperiod = "1 ms"\n'
ERROR = "[[bus.can0.errors]]\n"


@pytest.mark.parametrize(
    ("bus", "says"),
    [
        ("[bus.can0.nodes.plannt]\nlength = 2\n", "no node of the bus 'plannt'; did you mean"),
        (PERIODIC + "start = 2\nstop = 1\n", "found start = 2 and stop = 1, expected stop behind"),
        ("[bus.can0.nodes.a]\nclock_ppm = 1e6\n", "node a: found clock_ppm = 1000000.0, expected"),
        (PERIODIC + "start = -1\n", "found start = -1 s, expected 0 to"),
        (PERIODIC + "jitter = 1e99\n", r"found jitter = 1e\+99 s, expected 0 to"),
        (PERIODIC.replace("periodic", "babbling").replace("period", "share")
         .replace('"1 ms"', "1e-30"), "none above 50 days"),
        (ERROR + 'kind = "script"\nid = 0x900\nbit = 1\n', "0x900, .* an identifier of 11 bits"),
        (ERROR + 'kind = "rate"\nrate = 2\n', "found a rate of 2 and a length of 1 bits"),
        (ERROR + 'kind = "interruption"\nstart = 2\nstop = 1\n', "an interruption from 2 s to 1 s"),
    ],
)  # fmt: skip
def test_nodes_traffic_and_errors_that_cannot_be_are_refused(tmp_path, bus, says):
    with pytest.raises(ScenarioError, match=says) as error:
        plan_of(tmp_path, bus)
    assert "two.toml at bus.can0" in str(error.value)


def test_check_says_how_the_bus_was_computed_and_warns_of_losses(tmp_path):
    rules = {f.rule: f for f in check(*plan_of(tmp_path))}
    assert "ahead of the run" in rules["bus-response"].reason
    assert "analysis" in rules["bus-response"].reason
    short = '[bus.can0.nodes.a]\nlength = 1\n[[bus.can0.traffic]]\nkind = "babbling"\nid = 1\n'
    short += "start = 0.5\nstop = 1.0\n"
    rules = {f.rule: f for f in check(*plan_of(tmp_path, short))}
    assert rules["bus-loss"].severity == "warning"


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('bus = "can0"', 'bus = "can1"', "can1"),
        ('bus = "can0"', 'bus = "can0"\ndelay = { law = "constant", delay = 1 }', "expected no "),
        ("0x102", "0x101", "one identifier in two frames"),
        ("0x102", "0x902", "11 bits"),
        ("bytes = 8", 'bytes = 8, offset = "-1 ms"', "found offset = -0.001 s, expected 0 to"),
        ("bytes = 8", "bytes = 9", "9 bytes"),
        ('frame = { id = 0x101, bytes = 8, data = "zeros" }', "", "without frame"),
        ('bus = "can0"', "", "either delay, or bus"),
    ],
)
def test_what_is_no_bus_is_refused_with_its_place(tmp_path, old, new, says):
    with pytest.raises(ScenarioError, match=says) as error:
        plan_of(tmp_path, links=LINKS.replace(old, new))
    assert "two.toml at " in str(error.value)


def test_a_test_longer_than_the_run_meets_the_delays_again() -> None:
    law = BusDelays(np.array([0.1, np.inf, 0.3]))
    taken = law.stream(Fraction(1, 200), np.random.default_rng(0))
    found = np.concatenate([taken.take(2), taken.take(3)])
    assert found.tolist() == [0.1, np.inf, 0.3, 0.1, np.inf]


def test_a_run_keeps_its_buses() -> None:
    """What ``run.json`` has of a scenario is read again as that scenario."""
    path = ROOT / "configs" / "can" / "teleoperation-bus.toml"
    scenario = load(path, ["run.stop='0.1 s'"])
    written = json.loads(json.dumps(as_data(scenario)))
    again = build({k: v for k, v in written.items() if k != "path"}, path)
    assert again == scenario and again.buses


def test_receivers_that_take_only_their_frames_have_them_when_all_frames_are_taken(tmp_path):
    noise = '[[bus.can0.errors]]\nkind = "rate"\nrate = 2e-4\n'
    loaded, plan = plan_of(tmp_path, LOAD + noise)
    frames = frames_on_buses(scenario_components(loaded))["can0"]
    history = bus_history(loaded, "can0", frames, 2 * 10**12)
    heard = history.events[history.events["kind"] == BusEvent.RECEIVED]
    receivers = {f.name: f.receivers[0] for f in frames}
    identifiers = {f.name: f.frame.identifier for f in frames}
    for name, late in delays(plan).items():
        mine = np.flatnonzero(history.requests["frame"]["id"] == identifiers[name])
        node = history.names.index(receivers[name])
        for k, request in enumerate(mine[:1990]):
            times = heard["time"][(heard["node"] == node) & (heard["request"] == request)]
            assert times.min() - history.requests["at"][request] == round(late[k] * 1e12)


def test_random_traffic_has_the_distribution_that_it_says():
    """Counts of 0.1 s are Poisson distributed: variance and mean are equal."""
    rows = RandomSource((0, 1), 500.0, seed=4).requests(0, 400 * 10**12)
    counts = np.bincount(rows["at"] // 10**11, minlength=4000)
    assert counts.mean() == pytest.approx(50, rel=0.01)
    assert counts.var() == pytest.approx(50, rel=0.08)
    within = rows["at"] % 10**11 / 10**11
    assert np.histogram(within, 10, (0, 1))[0] == pytest.approx(20_000, rel=0.03)
    assert np.bincount(rows["frame"]["data"][:, 5]).min() > 600
