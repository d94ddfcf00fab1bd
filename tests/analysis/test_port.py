"""Selection of the port from [analysis], --port and the held arm; messages if it is ambiguous."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cosim.analysis.analyzed_port import find_port
from cosim.base.errors import ScenarioError
from cosim.predict.port import PortSignals
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from tests.analysis.cases import DOCUMENTS, pointmass


def port(document: dict[str, Any], chosen: str = "") -> PortSignals:
    scenario = build(document, Path("test.toml"))
    return find_port(scenario, assemble(scenario), chosen)[1]


def test_the_arm_that_is_held_is_the_port() -> None:
    found = port(DOCUMENTS["pair-10"])
    assert (found.arm, found.force, found.response) == ("master", "master.tau_h", "master.q")
    assert (found.rate, found.inject) == ("master.dq", "master.tau_ext")
    assert (found.far_force, found.far_rate) == ("slave.tau_e", "slave.dq")
    assert (
        found.estimates == ("master_control.theta_hat", "slave_control.theta_hat")
        and found.collocated
    )


def test_another_arm_may_be_chosen() -> None:
    found = port(DOCUMENTS["pair-10"], "slave")
    assert (found.force, found.far, found.far_force) == ("slave.tau_h", "master", "master.tau_e")


def test_a_table_names_the_signals_of_any_component() -> None:
    found = port(pointmass(1.0))
    assert (found.force, found.response, found.inject) == ("push.f", "mass.x", "mass.f")
    assert found.signals() == ("push.f", "mass.x", "mass.dx")


def test_a_velocity_as_response_has_no_power() -> None:
    assert not port(DOCUMENTS["velocity"]).collocated


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"force": "master.tau_x"}, "no signal 'master.tau_x'; did you mean 'master.tau"),
        ({"inject": "slave.qq"}, "no signal 'slave.qq'"),
    ],
)
def test_a_signal_that_is_not_there_is_refused(change: dict[str, str], message: str) -> None:
    with pytest.raises(ScenarioError, match=message) as caught:
        port(DOCUMENTS["pair-10"] | {"analysis": change})
    assert "test.toml at analysis" in str(caught.value)


def test_which_port_is_asked_where_nobody_holds() -> None:
    document = {**DOCUMENTS["pair-10"], "components": dict(DOCUMENTS["pair-10"]["components"])}
    master = document["components"]["master"]
    document["components"]["master"] = master | {"start": master["start"] | {"k_p": 0, "k_d": 0}}
    with pytest.raises(
        ScenarioError, match=r"no arm is held .* --port NAME.*\(arms: master, slave\)"
    ):
        port(document)
    assert port(document, "master").arm == "master"


def test_a_component_that_is_not_there_is_refused_with_the_nearest() -> None:
    with pytest.raises(
        ScenarioError, match="no component with signals 'mastr'; did you mean 'master'"
    ):
        port(DOCUMENTS["pair-10"], "mastr")


def test_a_key_that_is_not_known_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"analysis: no key 'forc'; did you mean 'force'"):
        port(DOCUMENTS["pair-10"] | {"analysis": {"forc": "master.tau_h"}})
