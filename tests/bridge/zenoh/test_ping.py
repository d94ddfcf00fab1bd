"""Round trips over Zenoh, and what is made of them."""

from pathlib import Path

import numpy as np
import pytest

from bridge.cli.ping import histogram, lines, links, links_with_laws
from bridge.deployment.latency import delays_for, network_delays
from bridge.deployment.system import load_system
from bridge.deployment.zenoh_keys import Names
from bridge.zenoh.options import ZenohOptions
from bridge.zenoh.ping import Echo, PingResult, evaluate_stamps, ping
from bridge.zenoh.session import configure, open_session
from cosim.base.errors import RunError
from cosim.links.traces import read_trace, write_trace
from tests.bridge.zenoh.ends import endpoint
from tests.bridge.zenoh.rehearsed import CONFIGS

NAMES = Names("test")


def test_clocks_that_differ_do_not_matter():
    """The other's clock is 3 s ahead; there takes 2 ms, back 2 ms and sometimes more."""
    rng = np.random.default_rng(0)
    sent = np.arange(100) * 5e6
    back = 2e6 + np.where(np.arange(100) % 10, rng.exponential(1e6, 100), 0.0)
    stamps = np.stack([sent, sent + 3e9 + 2e6, sent + 2e6 + back], axis=1)
    stamps[7] = np.nan
    found = evaluate_stamps(sent, stamps)
    assert found.offset == pytest.approx(3.0)
    assert found.loss == pytest.approx(0.01)
    np.testing.assert_allclose(np.delete(found.there, 7), 2e-3)
    np.testing.assert_allclose(np.delete(found.back, 7), np.delete(back, 7) * 1e-9)
    assert "100 pings, 1.00% lost" in lines(found)[0]


def test_nothing_came_back():
    with pytest.raises(RunError, match="none of 3 pings came back"):
        evaluate_stamps([0, 1, 2], np.full((3, 3), np.nan))


def test_a_trace_is_one_that_links_take(tmp_path: Path):
    path = tmp_path / "there.csv"
    write_trace(path, np.array([0.0, 0.005, 0.01]), np.array([0.002, np.nan, -1e-5]))
    trace = read_trace(path)
    assert trace.t_send.tolist() == [0.0, 0.005, 0.01]
    assert trace.delay[0] == 0.002 and np.isnan(trace.delay[1]) and trace.delay[2] == 1e-6


def test_links_get_the_way_they_go():
    system = load_system(CONFIGS / "teleoperation.toml", "zenoh")
    said = links(system, "master", [Path("/there"), Path("/back")])
    assert [s for s in said if "delay" in s] == [
        'links.0.delay={law="trace", file="/there", repeat=true}',
        'links.1.delay={law="trace", file="/back", repeat=true}',
    ]


def test_a_histogram_has_everything():
    values = np.array([1e-4, 2e-4, 1e-3, np.nan, 0.5])
    assert sum(int(line.split()[-1]) for line in histogram(values)) == 4


def test_there_and_back(tmp_path: Path):
    where = endpoint(tmp_path)
    far = open_session(configure(ZenohOptions("test", listen=(where,)), "b"), "net")
    echo = Echo(far, NAMES, "b", "a", "reliable")
    near = open_session(configure(ZenohOptions("test", connect=(where,)), "a"), "net")
    found = ping(near, NAMES, "a", "b", n=50, period=0.002, reliability="reliable")
    back = found.rtt[~np.isnan(found.rtt)]  # Zenoh drops what it cannot send at once
    assert len(back) > 0 and found.loss == pytest.approx(1 - len(back) / 50)
    assert len(back) <= echo.answered <= 50
    assert (back > 0).all() and abs(found.offset) < back.min()  # both clocks are one
    echo.close()
    near.put("test/a/ping", b"no ping of ours")
    with pytest.raises(RunError, match=r"no node listens to test/c/ping after 0.05 s"):
        ping(near, NAMES, "c", "b", n=1, patience=0.05)
    near.close()
    far.close()


def test_a_law_of_the_deployment_is_added_to_what_was_measured(tmp_path):
    system = load_system(CONFIGS / "teleoperation.toml", "zenoh", ["run.stop='2 s'"])
    link = system.plan.links[0]
    sent, delay = np.arange(10) * 0.1, np.full(10, 0.25)
    delay[3] = np.nan  # lost
    t, total = network_delays(link, system.plan.ticks, sent, delay)
    law = delays_for(link, system.plan.ticks).delays
    n = min(len(law), len(total))
    assert t[0] == 0.0 and t[-1] >= 2.0 and not np.isnan(total).any()
    assert np.allclose(total[:n] - law[:n], 0.25)
    found = PingResult(sent, 2 * delay, delay, delay, 0.0)
    said = links_with_laws(system, "master", found, tmp_path)
    assert len(said) == 2 and all("law=" in s for s in said)
    assert load_system(CONFIGS / "teleoperation.toml", "zenoh", ["run.stop='2 s'", *said])
    first = np.loadtxt(tmp_path / "link0.csv", delimiter=",", skiprows=1)
    assert np.allclose(first[:, 1], total, atol=1e-8)
