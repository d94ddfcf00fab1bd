"""Foreign drives in a deployment: their frames, values at the joint in SI."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.drives.profile_files import load_profile
from bridge.native.message import Decoded
from bridge.native.safety import LifeState, Why
from bridge.replay import replay
from cosim.base.errors import ScenarioError
from tests.bridge.deployments import CONFIGS, document, named, run_twin, signal, system_of

DRIVES = CONFIGS / "drives"


def damiao(**changes):
    """can-damiao.toml with changes to the message of the master's first torque."""
    found = document("can-damiao")
    for table in (*found["messages"].values(), found["nodes"]["master"]["drive"],
                  found["nodes"]["slave"]["drive"]):  # fmt: skip
        if "profile" in table:
            table["profile"] = str(DRIVES / "damiao.toml")
    found["messages"]["master_tau_1"] |= changes
    return found


def test_messages_are_those_of_the_profile():
    system = named("can-damiao")
    codecs = {name: m.encoding for name, m in system.messages.items()}
    assert codecs["master_tau_2"].message.id == 2
    assert codecs["slave_state_1"].message.id == 0x11
    assert [s.name for s in codecs["slave_state_1"].signals] == ["q", "dq"]
    assert [s.scale for s in codecs["master_tau_1"].signals] == pytest.approx([20 / 4095])


def test_a_bus_of_drives_carries_no_services():
    system = named("can-damiao")
    heard = {one.name: one.accept.id for one in system.subscriptions("master")}
    assert heard == {"master_tau_1": 1, "master_tau_2": 2}
    assert "HEARTBEAT_4" in {one.name for one in system.subscriptions("master_control")}


@settings(max_examples=12)
@given(
    gear=st.floats(0.1, 100), direction=st.sampled_from([1, -1]),
    zero=st.floats(-3, 3).map(lambda x: round(x, 9)),
    turns=st.floats(-5, 5), tau=st.floats(-0.5, 0.5),
)  # fmt: skip
def test_gear_direction_zero_and_units_are_in_the_codec(
    gear, direction, zero, turns, tau, tmp_path_factory
):
    """ODrive: turns of the motor, behind a gear: q = direction 2 pi turns / gear + zero."""
    found = damiao()
    between = {"gear": gear, "direction": direction, "drive": 3}
    odrive = {"profile": str(DRIVES / "odrive.toml"), **between}
    found["messages"]["master_state_1"] |= odrive | {"zero": zero}
    found["messages"]["master_tau_1"] |= odrive
    system = system_of(found, tmp_path_factory.mktemp("odrive"))
    plain = load_profile(DRIVES / "odrive.toml")
    encoder = system.messages["master_state_1"].encoding
    part = next(p for p in plain.feedback if p.q)
    data = plain.codec(part, 3).encode([turns, 0.0])
    _, values, _ = encoder.decode(data)
    assert values[0] == pytest.approx(direction * 2 * np.pi * turns / gear + zero, abs=1e-5)
    torque = system.messages["master_tau_1"].encoding
    data = torque.encode([tau * gear])
    _, raw, _ = plain.codec(plain.command, 3).decode(data)
    assert raw[0] == pytest.approx(direction * tau, abs=1e-6)


def test_a_reversed_drive_takes_a_torque_of_zero(tmp_path):
    """A torque of 0 behind a gear of direction -1 is -0.0 in the frame."""
    found = damiao()
    found["messages"]["master_tau_1"] |= {
        "profile": str(DRIVES / "odrive.toml"), "gear": 3.7, "direction": -1, "drive": 3,
    }  # fmt: skip
    torque = system_of(found, tmp_path).messages["master_tau_1"].encoding
    plain = load_profile(DRIVES / "odrive.toml")
    said, values, _ = plain.codec(plain.command, 3).decode(torque.encode([0.0]))
    assert said is Decoded.OK and values[0] == 0.0


def test_the_twin_reaches_q_h_within_the_drives_torque_and_replays(tmp_path):
    system = named("can-damiao")
    rows = run_twin(system, tmp_path / "twin")
    for arm in ("master", "slave"):
        assert set(rows[arm]["state"].tolist()) == {LifeState.ACTIVE}
        assert np.abs(signal(system, rows, arm, f"{arm}.q")[-1] - [3.5, 3.0]).max() < 0.02
        sent = rows[f"{arm}_control"]["sent"]
        assert np.abs(sent[:, :2]).max() <= 7.0
    found = replay.replay(system, rows, replay.received_by_life(tmp_path / "twin"), tmp_path)
    assert found.first is None and found.greatest == 0.0
    assert "master_tau_1" in found.alone and "XI_2" not in found.alone  # no counter: as recorded


def test_a_drive_that_hears_too_little_is_lost_alone_and_its_node_stops(tmp_path):
    """Its watchdog is 50 ms; the other drive of the arm goes on until it is disabled."""
    found = damiao(period="100 ms")
    rows = run_twin(system_of(found, tmp_path, "run.stop=1"), tmp_path / "twin")
    power = rows["master"]["inlets"]["requests"]
    first = int(np.flatnonzero(power[:, 0] & 2)[0])
    assert 50 <= first <= 54 and not (power[first] & 1)[0] and (power[first] & 1)[1]
    control = rows["master_control"]
    assert control["reasons"][-1] & Why.DRIVE and control["state"][-1] == LifeState.FAULT
    stopped = int(np.flatnonzero(control["reasons"])[0])
    assert control["slot"][stopped] * 5 <= first + 105  # it tells its state with its next answer
    assert rows["master"]["state"][-1] != LifeState.FAULT  # the plant is none of its drives


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (
            {"carries": ["master_control.tau[0]", "master_control.s[0]"]},
            "port 's' is none of tau, q, dq",
        ),
        ({"carries": ["master_control.tau"]}, "has no message for tau, tau; it has COMMAND: 1 tau"),
        ({"signals": ["tau"]}, "the profile defines name and signals"),
        ({"profile": "none.toml"}, "none.toml"),
        ({"bus": "none"}, "no bus 'none'"),
    ],
)
def test_what_does_not_fit_is_said_with_its_place(changes, sentence, tmp_path):
    found = damiao(**changes)
    if changes.get("carries") == ["master_control.tau"]:
        del found["messages"]["master_tau_2"]
    with pytest.raises(ScenarioError) as error:
        system_of(found, tmp_path)
    assert sentence in str(error.value)
