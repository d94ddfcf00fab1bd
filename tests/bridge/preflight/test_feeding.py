"""Drives are fed at half of their watchdog at the latest, in every phase, or the check fails."""

from __future__ import annotations

import pytest

from bridge.deployment.drive_sequences import commanded_drives
from bridge.preflight.deployment import check
from bridge.preflight.feeding import feeding_periods
from tests.bridge.deployments import CONFIGS, document, named, system_of

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
