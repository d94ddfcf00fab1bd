"""Drives are fed at half of their watchdog at the latest, in every phase, or the check fails."""

from __future__ import annotations

import pytest

from bridge.deployment.drive_sequences import commanded_drives
from bridge.preflight.deployment import check
from bridge.preflight.feeding import feeding_periods, slow_states, torques_until
from tests.bridge.deployments import CONFIGS, SIX_AXIS, document, named, system_of

NAMES = ("can-damiao", "can-cia402", "six_axis", "openarm", "openarm-grippers")


@pytest.mark.parametrize("name", NAMES)
def test_shipped_deployments_feed_their_drives_in_time(name):
    system = named(name)
    for node, plan in system.nodes.items():
        for drive in commanded_drives(system.deployment, plan):
            periods = feeding_periods(system, node, drive)
            assert set(periods) == {"before the start", "in the run"}
            assert max(periods.values()) <= drive.profile.timeout / 2
    assert not [f for f in check(system) if f.severity == "error"]


@pytest.mark.parametrize(
    ("watchdog", "phase"), [("9 ms", "before the start"), ("8 ms", "in the run")]
)
def test_a_watchdog_that_is_too_short_is_an_error(watchdog, phase, tmp_path):
    profile = tmp_path / "short.toml"
    profile.write_text(
        f'title = "short"\nbase = "{CONFIGS}/drives/damiao.toml"\n'
        f'dbc = "{CONFIGS}/drives/damiao.dbc"\n'
        f'[drive]\ntau_max = "7 N.m"\nwatchdog = "{watchdog}"'
    )
    found = document("can-damiao")
    for message in [*found["messages"].values(), *found["nodes"].values()]:
        if "profile" in message:
            message["profile"] = str(profile)
        if "drive" in message and isinstance(message["drive"], dict):
            message["drive"]["profile"] = str(profile)
    errors = [f for f in check(system_of(found, tmp_path)) if f.severity == "error"]
    said = [f.reason for f in errors if "drive 1 on bus left" in f.where]
    assert any(phase in text and "its watchdog trips after" in text for text in said)


def test_a_drive_that_tells_its_state_seldom_is_named_with_the_torques_it_is_sent(tmp_path):
    assert not list(slow_states(named("six_axis")))
    profile = tmp_path / "seldom.toml"
    text = (CONFIGS / "drives" / "odrive.toml").read_text("utf-8")
    text = text.replace('every = "10 ms"', 'every = "100 ms"')
    profile.write_text(text.replace('"odrive.dbc"', f'"{CONFIGS}/drives/odrive.dbc"'), "utf-8")
    found = document("six_axis")
    for message in found["messages"].values():
        if "profile" in message:
            message["profile"] = str(profile)
    for node in found["nodes"].values():
        if "drive" in node:
            node["drive"]["profile"] = str(profile)
    told = list(slow_states(system_of(found, tmp_path, scenario=SIX_AXIS)))
    assert told and {f.severity for f in told} == {"warning"}
    assert all("every 100 ms" in f.reason and "up to 26 torques" in f.reason for f in told)
    assert all("heartbeat_msg_rate_ms to at most 25 ms" in f.advice for f in told)


@pytest.mark.parametrize(
    ("every", "period", "torques"), [(0.01, 0.01, 2), (0.01, 0.004, 4), (0.1, 0.004, 26)]
)
def test_torques_until_a_state_is_obeyed(every, period, torques):
    assert torques_until(every, period) == torques
