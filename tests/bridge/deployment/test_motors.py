"""``[motors.NAME]``: the messages of an arm's motors from one table; and two OpenArms with it."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from bridge.deployment.gateways import numbered
from bridge.deployment.motors import expand
from bridge.deployment.spec import MessageSpec, find, load
from bridge.drives.profile_files import load_profile
from bridge.native.frame import Flags
from bridge.replay import replay
from cosim.base.errors import ScenarioError
from cosim.schedule.parts import Slot
from tests.bridge.deployments import CONFIGS, named, run_twin

DRIVES = CONFIGS / "drives"
TYPES = {"damiao_8009": (54, 45, 40), "damiao_4340": (28, 10, 27), "damiao": (10, 30, 7)}


def table(**changes: Any) -> dict[str, Any]:
    """A deployment with the motors of one arm."""
    motors = {
        "bus": "left", "drives": [5, 9], "profile": ["a.toml", "b.toml"], "direction": [1, -1],
        "messages": {
            "tau": {"carries": ["control.tau"]},
            "state": {"carries": ["arm.q", "arm.dq"], "period": "4 ms"},
        },
    }  # fmt: skip
    return {"motors": {"arm": motors | changes}, "messages": {"XI": {"bus": "link"}}}


def test_motors_become_a_message_for_each_joint_and_kind() -> None:
    found = table()
    expand(found, Path("d.toml"))
    assert "motors" not in found
    assert list(found["messages"]) == [
        "arm_tau_1", "arm_state_1", "arm_tau_2", "arm_state_2", "XI",
    ]  # fmt: skip
    assert found["messages"]["arm_state_2"] == {
        "bus": "left", "drive": 9, "profile": "b.toml", "gear": 1.0, "direction": -1, "zero": 0.0,
        "period": "4 ms", "carries": ["arm.q[1]", "arm.dq[1]"], "joint": 1,
    }  # fmt: skip


@pytest.mark.parametrize(("base", "names"), [(0, ("[0]", "[1]")), (1, ("[1]", "[2]"))])
def test_motors_have_the_numbers_that_the_plant_counts_by(
    base: int, names: tuple[str, ...]
) -> None:
    """Arrays of Modelica tools count from 1; nothing changes when it is done once more."""
    slots = [Slot(f"{c}.{p}", c, p, 0, (2,), "1", base) for c, p in (
        ("arm", "q"), ("arm", "dq"), ("control", "tau"),
    )]  # fmt: skip
    plan: Any = SimpleNamespace(components=[SimpleNamespace(outputs=slots)])
    found = table()
    expand(found, Path("d.toml"))
    own = {"a": "arm_state_1", "b": "arm_state_2", "c": "arm_tau_2"}
    messages = {
        key: msgspec.convert({**found["messages"][name], "carries": tuple(
            found["messages"][name]["carries"])}, MessageSpec)
        for key, name in own.items()
    }  # fmt: skip
    d = msgspec.structs.replace(
        load(find(CONFIGS / "teleoperation.toml", "can")), messages=messages
    )
    for _ in range(2):
        d = numbered(d, plan)
        assert d.messages["a"].carries == (f"arm.q{names[0]}", f"arm.dq{names[0]}")
        assert d.messages["b"].carries == (f"arm.q{names[1]}", f"arm.dq{names[1]}")
        assert d.messages["c"].carries == (f"control.tau{names[1]}",)


def test_a_message_of_the_file_comes_before_the_table() -> None:
    found = table()
    found["messages"]["arm_tau_2"] = {"zero": 0.5}
    expand(found, Path("d.toml"))
    assert found["messages"]["arm_tau_2"]["zero"] == 0.5
    assert found["messages"]["arm_tau_2"]["carries"] == ["control.tau[1]"]
    assert found["messages"]["arm_tau_1"]["zero"] == 0.0


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"profile": ["a.toml"]}, r"d\.toml at motors\.arm\.profile: has 1 entries, expected 2"),
        ({"messages": {"tau": {}}}, "carries is .*, expected an array of ports"),
        ({"wheels": 2}, r"no key 'wheels' .there are: bus, direction, drives"),
        ({"direction": 2}, "motors.arm.direction"),
    ],
)
def test_mistakes_name_their_place(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ScenarioError, match=text):
        expand(table(**changes), Path("d.toml"))


def test_the_profiles_of_a_protocol_share_their_base(tmp_path: Path) -> None:
    base = load_profile(DRIVES / "damiao.toml")
    for kind, (tau, dq, peak) in TYPES.items():
        profile = load_profile(DRIVES / f"{kind}.toml").with_format(True)
        assert profile.protocol == base.protocol == base.path
        assert profile.watchdog == base.watchdog and profile.sequences == base.sequences
        assert profile.format == Flags.FD | Flags.BRS and not base.format
        signals = {s.name: s for s in profile.codec(profile.command, 1).layout.signals}
        assert signals["tau"].scale == pytest.approx(2 * tau / 4095)
        assert signals["dq_des"].scale == pytest.approx(2 * dq / 4095)
        assert profile.limits["tau_max"] == peak
    (tmp_path / "own.toml").write_text(f'base = "{DRIVES / "damiao_4340.toml"}"\n')
    with pytest.raises(ScenarioError, match="has a base itself, expected none"):
        load_profile(tmp_path / "own.toml")


def test_the_files_of_damiao_drives_are_as_generated() -> None:
    spec = importlib.util.spec_from_file_location("generate", DRIVES / "generate.py")
    assert spec and spec.loader
    generate = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generate)
    for name, text in generate.files().items():
        assert (DRIVES / name).read_text() == text, f"{name}: run configs/drives/generate.py"


def test_two_openarms_have_fourteen_drives_of_three_types_on_can_fd() -> None:
    system = named("openarm")
    left = [m for m in system.messages.values() if m.bus == "left"]
    assert sorted(m.encoding.message.id for m in left) == [*range(0x01, 0x08), *range(0x11, 0x18)]
    assert all(Flags(m.encoding.message.flags) == Flags.FD | Flags.BRS for m in left)
    scales = [system.messages[f"slave_tau_{n}"].encoding.signals[0].scale for n in range(1, 8)]
    assert scales == pytest.approx([2 * t / 4095 for t in (54, 54, 28, 28, 10, 10, 10)])


def test_a_deployment_is_found_by_the_name_of_its_scenario() -> None:
    found = [find(CONFIGS / f"{name}.toml", "").stem for name in ("openarm", "six_axis")]
    assert found == ["openarm", "six_axis"]
    assert find(CONFIGS / "teleoperation.toml", "").stem == "can"


@pytest.mark.parametrize(("name", "slots"), [("openarm", 400), ("six_axis", 200)])
def test_twins_of_arms_with_many_drives_replay_exactly(
    name: str, slots: int, tmp_path: Path
) -> None:
    system = named(name, "run.stop=0.2")
    rows = run_twin(system, tmp_path / "twin")
    found = replay.replay(system, rows, replay.received_by_life(tmp_path / "twin"), tmp_path)
    assert found.first is None and sum(found.slots.values()) == slots
