"""Paths between two nodes of a deployment: their ends, and what the scenario does there."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from bridge.cli.paths.ping import ping
from bridge.cli.paths.pong import pong
from bridge.deployment.latency import delays_for, network_delays
from bridge.deployment.system import System, load_system
from bridge.ping.measure import PingResponder
from bridge.ping.prediction import PathTrace, predict
from bridge.ping.zenoh import node_responder, pinged_nodes
from bridge.zenoh.exchange import asking, node_session
from cosim.base.errors import RunError, ScenarioError
from cosim.cli.options import flat
from cosim.links.traces import read_trace, write_trace
from tests.bridge.ping.test_paths import answering
from tests.bridge.zenoh.rehearsed import CONFIGS, sockets

ARMS = ("master", "slave")
SCENARIO = CONFIGS / "teleoperation.toml"


def loaded(*settings: str) -> System:
    return load_system(SCENARIO, "zenoh", ["run.stop='2 s'", *settings])


@contextmanager
def answered(settings: list[str]) -> Iterator[None]:
    nodes = pinged_nodes(load_system(SCENARIO, "zenoh", settings))
    with node_responder(nodes) as far, answering(PingResponder(far)):
        yield


def called(*arguments: str) -> str:
    app = typer.Typer()
    app.command()(flat(ping))
    done = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output


def test_a_trace_is_one_that_links_take(tmp_path: Path) -> None:
    path = tmp_path / "there.csv"
    write_trace(path, np.array([0.0, 0.005, 0.01]), np.array([0.002, np.nan, -1e-5]))
    trace = read_trace(path)
    assert trace.t_send.tolist() == [0.0, 0.005, 0.01]
    assert trace.delay[0] == 0.002 and np.isnan(trace.delay[1]) and trace.delay[2] == 1e-6


def test_links_get_the_way_they_go() -> None:
    assert pinged_nodes(loaded()).ways() == {0: False, 1: True}
    assert pinged_nodes(loaded(), "slave").ways() == {0: True, 1: False}


def test_nodes_are_those_of_the_zenoh_bus() -> None:
    nodes = pinged_nodes(loaded(), there="master")
    assert (nodes.bus, nodes.here, nodes.there) == ("net", "slave", "master")
    with pytest.raises(ScenarioError, match="no node 'c' on net; there are: master, slave"):
        pinged_nodes(loaded(), "c")
    with pytest.raises(ScenarioError, match="no Zenoh bus to measure"):
        pinged_nodes(load_system(SCENARIO, "can"))


def test_a_path_between_nodes_is_measured_and_predicted(tmp_path: Path) -> None:
    settings = [*sockets(ARMS, tmp_path), "run.stop='1 s'"]
    words = [word for text in settings for word in ("--set", text)]
    with answered(settings):
        called(
            str(SCENARIO), "--rate", "500", "--duration", "0.2", "--json",
            str(tmp_path / "said.json"), *words, "--out", str(tmp_path / "ping"),
        )  # fmt: skip
    found = json.loads((tmp_path / "said.json").read_text("utf-8"))
    assert set(found["links"]) == {"there", "back"}
    assert found["prediction"]["numbers"] and len(found["prediction"]["links"]) == 2
    assert (tmp_path / "ping" / "there.csv").is_file()


def test_nobody_answers_for_a_node_that_is_not_there(tmp_path: Path) -> None:
    nodes = pinged_nodes(loaded(*sockets(ARMS, tmp_path)))
    with (
        node_session(nodes.system, nodes.bus, "master") as (session, how),
        pytest.raises(RunError, match=r"expected `cosim pong .*teleoperation.toml slave`"),
        asking(session, "master", lambda *_: None, nodes.keys, how, 0.05),
    ):
        pass


def test_the_other_end_of_a_scenario_is_one_of_its_nodes() -> None:
    app = typer.Typer()
    app.command()(flat(pong))
    with pytest.raises(ScenarioError, match="no node 'c' on net"):
        CliRunner().invoke(app, [str(SCENARIO), "c"], catch_exceptions=False)


def test_a_law_of_the_deployment_is_added_to_what_was_measured() -> None:
    system = loaded()
    link = system.plan.links[0]
    sent, delay = np.arange(10) * 0.1, np.full(10, 0.25)
    delay[3] = np.nan  # lost
    t, total = network_delays(link, system.plan.ticks, sent, delay)
    law = delays_for(link, system.plan.ticks).delays
    n = min(len(law), len(total))
    assert t[0] == 0.0 and t[-1] >= 2.0 and not np.isnan(total).any()
    assert np.allclose(total[:n] - law[:n], 0.25)


@pytest.mark.parametrize("latency", ["true", "false"])
def test_laws_stay_where_the_deployment_adds_them(latency: str) -> None:
    """A path without delay leaves the numbers of the scenario, or takes its delays away."""
    nodes = pinged_nodes(loaded(f"deploy.latency={latency}"))
    none = np.full(100, 1e-6)
    trace = PathTrace(np.arange(100) * 0.005, none, none, "last-arrival")
    found = predict(SCENARIO, trace, settings=["run.stop='2 s'"], nodes=nodes)
    assert not found.failures and found.numbers
    away = all(n.value == pytest.approx(n.ideal, rel=1e-9) for n in found.numbers)
    assert away == (latency == "false")
