"""Deployment files: read as written, and a sentence with its place for whatever is wrong."""

from __future__ import annotations

import re
import tomllib

import msgspec
import pytest

from bridge.deployment.spec import find, load
from cosim.base.errors import ScenarioError
from cosim.loading.files import load as load_scenario
from tests.bridge.deployments import CONFIGS, TELEOPERATION, document, toml, written

NAMES = sorted(path.stem for path in (CONFIGS / "deploy").glob("*.toml"))


@pytest.mark.parametrize("name", NAMES)
def test_every_deployment_of_the_project_is_read(name):
    found = load(find(TELEOPERATION, name))
    assert found.name == name
    assert found.nodes and found.messages
    assert all(found.file(bus.dbc).is_file() for bus in found.buses.values() if bus.dbc)


def test_a_file_that_is_no_text_is_named_with_what_was_expected(tmp_path):
    (tmp_path / "plant.fmu").write_bytes(b"PK\x03\x04\xff\xfe")
    with pytest.raises(
        ScenarioError,
        match=r"plant\.fmu: cannot be read: not UTF-8 text \(byte 4\); expected a file",
    ):
        load(tmp_path / "plant.fmu")


def test_a_deployment_is_read_as_written():
    found = load(find(TELEOPERATION, "can"))
    assert found.title == "Two arms on two CAN FD buses"
    assert found.seconds(found.nodes["master_control"].phase, "x") == 0.5e-3
    assert found.nodes["master"].drive.watchdog == "100 ms"
    assert found.messages["LINK_2"].carries == ("master_control.tau", "master_control.xi")
    assert found.place("nodes", "master", 3).endswith("can.toml at nodes.master.3")


def test_its_changes_to_the_scenario_are_settings_the_scenario_takes():
    found = load(find(TELEOPERATION, "can"))
    scenario = load_scenario(TELEOPERATION, found.settings())
    assert scenario.components["master_control"].parameters["age_max"] == "10 ms"


@pytest.mark.parametrize(
    "value",
    ['a "b" \\ c', [1, 2.5, True], False, 1e-9, {"law": "constant", "delay": ["5 ms", {"a b": 1}]}],
)
def test_a_change_of_any_kind_survives_being_a_setting(value):
    found = msgspec.structs.replace(load(find(TELEOPERATION, "can")), set={"a.b": value})
    path, _, text = found.settings()[0].partition("=")
    assert path == "a.b"
    assert tomllib.loads(f"value = {text}")["value"] == value


def test_settings_change_it():
    path = find(TELEOPERATION, "can")
    found = load(path, ["latency=false", "buses.left.channel=can3", 'nodes.slave.phase="1 ms"'])
    assert not found.latency
    assert found.buses["left"].channel == "can3"
    assert found.nodes["slave"].phase == "1 ms"


@pytest.mark.parametrize("given", ["can", str(CONFIGS / "deploy" / "can.toml")])
def test_a_deployment_is_found_by_name_or_as_a_file(given):
    assert find(TELEOPERATION, given) == CONFIGS / "deploy" / "can.toml"


def test_one_that_is_not_there_is_answered_with_those_that_are(tmp_path):
    with pytest.raises(
        ScenarioError,
        match=r"no deployment 'cna'; did you mean 'can'.*can-classic, ",
    ):
        find(TELEOPERATION, "cna")
    (tmp_path / "x.toml").touch()
    with pytest.raises(ScenarioError, match=r"there are: none.*cosim new"):
        find(tmp_path / "x.toml", "can")
    with pytest.raises(ScenarioError, match=r"y.toml: no such file; expected a scenario"):
        find(tmp_path / "y.toml", "can")


# ---- what is wrong, and where -------------------------------------------------------------------

NODE = {"components": ["x"], "number": 9}


@pytest.mark.parametrize(
    ("path", "value", "sentence", "place"),
    [
        ("nodse", {}, "unknown key 'nodse'; expected one of title, clock", ""),
        ("buses", [], "no [buses.NAME] table", ""),
        ("nodes", 1, "no [nodes.NAME] table", ""),
        ("clock", "sundial", "Invalid enum value 'sundial'", "clock"),
        ("latency", "yes", "expected true or false, found 'yes'", "latency"),
        ("sync", "mastre", "no node 'mastre'; there are: master, ", "sync"),
        ("set", 3, "expected a table, found 3", "set"),
        ("buses.left.kind", "lin", "Invalid enum value 'lin'", "buses.left.kind"),
        ("buses.left.bitrate", 0, "expected a whole number >= 1, found 0", "buses.left.bitrate"),
        ("buses.left.baud", 1, "no key 'baud' (there are: bitrate, ", "buses.left"),
        ("nodes.slave.number", 1, "number 1 is master's already", "nodes.slave.number"),
        ("nodes.slave.number", 0, "expected a whole number >= 1, found 0", "nodes.slave.number"),
        ("nodes.slave.number", 32, "found 32; expected 1 to 31, because left is CAN",
         "nodes.slave.number"),
        ("nodes.slave.number", 2001, "a whole number <= 2000, found 2001", "nodes.slave.number"),
        ("nodes.slave.count", 0, "found 0; expected 1 to 2000", "nodes.slave.count"),
        ("nodes.slave.priority", 99, "a whole number <= 98, found 99", "nodes.slave.priority"),
        ("nodes.other", NODE | {"components": ["slave"]}, "slave lives in slave already",
         "nodes.other.components"),
        ("nodes.slave.requires", ["x"], "no node 'x'; there are: ", "nodes.slave.requires"),
        ("nodes.slave.guard", {"tau": 1}, "no key 'tau'", "nodes.slave.guard"),
        ("nodes.slave.stale", {"a.b": {"stop": []}}, "found a list", "nodes.slave.stale.a.b.stop"),
        ("messages.STATE_1.bus", "up", "no bus 'up'; there are: left, right",
         "messages.STATE_1.bus"),
        ("messages.STATE_1.carries", "master.q", "a list, found", "messages.STATE_1.carries"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_with_its_place(path, value, sentence, place, tmp_path):
    found = document()
    *parents, last = path.split(".")
    table = found
    for part in parents:
        table = table[part]
    table[last] = value
    file = written(found, tmp_path)
    with pytest.raises(ScenarioError, match=re.escape(sentence)) as error:
        load(file)
    assert f"{file}" + (f" at {place}" if place else "") in str(error.value)


def test_a_duration_says_what_is_no_duration(tmp_path):
    found = load(written(document(), tmp_path))
    with pytest.raises(ScenarioError, match=r"test\.toml at nodes\.slave\.phase"):
        found.seconds("5 N.m", "nodes", "slave", "phase")


def test_missing_tables_and_files_are_said(tmp_path):
    found = document()
    del found["messages"]
    with pytest.raises(ScenarioError, match=r"no \[messages.NAME\] table"):
        load(written(found, tmp_path))
    with pytest.raises(ScenarioError, match="no such file"):
        load(tmp_path / "none.toml")
    assert toml({"a": [1, "b"]}) == '{"a" = [1, "b"]}'
