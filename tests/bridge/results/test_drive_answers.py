"""Real drives that were off, or did not answer their torques, are named; others never are."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from bridge.deployment.drive_messages import feedback_codec
from bridge.deployment.system import System, load_system
from bridge.native.frame import frame_dtype
from bridge.native.journal import Journal
from bridge.native.safety import LifeState
from bridge.realtime.lateness import journal_lateness
from bridge.records.node_lives import Life
from bridge.records.records import LifeEnd, Statement
from bridge.replay import replay, twin
from bridge.results.drive_answers import silent_ends, unanswered
from bridge.results.drive_motion import TorqueAnswer, heard, motions, sent_torques
from bridge.results.report import NodeReport
from bridge.wiring.wiring import Rows
from tests.bridge.rehearsing import ROOT

CONFIGS = ROOT / "configs"
CONTROLLERS = ("master_control", "slave_control")
START = 10**9  # ns, of t = 0 on the clock of the logs
DEPLOYMENTS = {
    "can": "teleoperation",
    "can-damiao": "teleoperation",
    "can-cia402": "teleoperation",
    "six_axis": "six_axis",
    "openarm": "openarm",
}
Lives = Mapping[Life, Rows]


def simulated(
    folder: Path, deploy: str, settings: tuple[str, ...] = ()
) -> tuple[System, dict[Life, Rows]]:
    """A deployment and what its controllers recorded, with emulated drives."""
    scenario = CONFIGS / f"{DEPLOYMENTS[deploy]}.toml"
    system = load_system(scenario, deploy, ["run.stop=3.0", *settings])
    folder.mkdir(exist_ok=True)
    twin.simulate(system, folder)
    rows = replay.load(folder)
    found = {life: _serving(np.copy(rows[life])) for life in rows if life.node in CONTROLLERS}
    for path in folder.iterdir():
        path.unlink()
    return system, found


def _serving(rows: Rows) -> Rows:
    """Rows in which all drives are enabled."""
    if "serving" in (rows.dtype.names or ()):
        rows["serving"] = 0xFFFF
    return rows


def said(system: System, rows: Lives, nodes: Path) -> list[str]:
    """The sentences on these lives."""
    reports = [
        NodeReport(
            life, len(r), journal_lateness(r, 5_000_000), "finished", (),
            Statement(life=life, end=LifeEnd.FINISHED, start_ns=START),
        )
        for life, r in rows.items()
    ]  # fmt: skip
    return [*unanswered(system, rows, reports, nodes), *silent_ends(system, rows, reports)]


@pytest.mark.parametrize("deploy", DEPLOYMENTS)
def test_drives_that_follow_are_not_named(deploy: str, tmp_path: Path) -> None:
    system, rows = simulated(tmp_path / "nodes", deploy)
    assert said(system, rows, tmp_path / "nodes") == []
    slave = Life("slave_control")
    found = list(motions(system, system.nodes["slave_control"], rows[slave]))
    judged = [m.answer.slope for m in found if m.answer.judged]
    assert len(found) == 2 if DEPLOYMENTS[deploy] == "teleoperation" else len(found) > 5
    assert judged and min(judged) > 0.3 and max(judged) < 1.7


class Changed:
    """The teleoperator on Damiao drives; what the slave's controller heard is changed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.system, self.rows = simulated(folder, "can-damiao")
        self.life = Life("slave_control")
        self.plan = self.system.nodes["slave_control"]
        self.own = self.rows[self.life]

    def column(self, port: str, joint: int) -> Rows:
        """A view of what was heard."""
        inlets = [i for i in self.plan.inlets if i.source.name == f"slave.{port}[{joint}]"]
        return self.own["signals"][:, inlets[0].target.start]

    @property
    def said(self) -> list[str]:
        return said(self.system, self.rows, self.folder)


@pytest.fixture
def changed(tmp_path: Path) -> Changed:
    return Changed(tmp_path / "nodes")


def test_what_is_heard_and_sent(changed: Changed) -> None:
    found = heard(changed.system, changed.plan, "slave.q", changed.own)
    assert found is not None and found.shape == (600, 2)
    assert np.array_equal(found[:, 1], changed.column("q", 1))
    assert changed.said == []


def test_a_joint_that_stands_still_is_named(changed: Changed) -> None:
    for port in ("q", "dq"):
        changed.column(port, 0)[:] = changed.column(port, 0)[0]
    (text,) = changed.said
    assert text.startswith("slave_control: drive 1 on bus right or its encoder is stuck")


def test_a_drive_that_turns_the_wrong_way_is_named(changed: Changed) -> None:
    changed.own["sent"][:] *= -1
    texts = changed.said
    assert len(texts) == 2 and all("turns the wrong way" in text for text in texts)


def test_torques_that_friction_could_hold_say_nothing(tmp_path: Path) -> None:
    """Some hundredths of what a motor can do are no measure of the direction in which it turns."""
    strong = "deploy.nodes.slave_control.guard.tau_max=[1000.0, 1000.0]"
    system, rows = simulated(tmp_path / "nodes", "can-damiao", settings=(strong,))
    rows[Life("slave_control")]["sent"][:] *= -1
    assert said(system, rows, tmp_path / "nodes") == []


def test_a_drive_that_follows_nothing_is_named(tmp_path: Path) -> None:
    """The second motor of the slave has no torque; its joint moves with the others."""
    weak = "deploy.nodes.slave.drive.tau_max=[7.0, 1e-6]"
    system, rows = simulated(tmp_path / "nodes", "can-damiao", settings=(weak,))
    (text,) = said(system, rows, tmp_path / "nodes")
    assert text.startswith("slave_control: drive 2 on bus right follows nothing: its joint moves")


def test_a_drive_that_was_off_for_a_while_is_named(changed: Changed) -> None:
    if "serving" not in (changed.own.dtype.names or ()):
        wide = np.dtype([*changed.own.dtype.descr, ("serving", "<u8")])
        rows = np.zeros(len(changed.own), wide)
        for name in changed.own.dtype.names:
            rows[name] = changed.own[name]
        rows["serving"] = 0xFF
        changed.rows[changed.life] = changed.own = rows
    changed.own["serving"][200:210] &= ~np.uint64(2)
    (text,) = changed.said
    assert "drive 2 on bus right was not enabled in 10 of " in text and "t = 1.000 s" in text


@pytest.mark.parametrize(("slots", "named"), [(1, False), (2, True), (20, True)])
def test_a_drive_that_was_silent_at_the_end_is_named(
    changed: Changed, slots: int, named: bool
) -> None:
    inlets = [k for k, i in enumerate(changed.plan.inlets) if i.message == "slave_state_1"]
    age = changed.own["inlets"]["age_ns"]
    age[-slots:, inlets] = age[-slots - 1, inlets] + 5_000_000 * np.arange(1, slots + 1)[:, None]
    assert [text.partition(" for ")[0] for text in changed.said] == [
        "slave_control: drive 1 on bus right may have been off at the end: nothing came from it"
    ] * named


@pytest.mark.parametrize(("on", "named"), [(True, False), (False, True)])
def test_a_drive_that_tells_that_it_is_on_while_its_node_stops_is_not_named(
    changed: Changed, on: bool, named: bool
) -> None:
    """The machine stood still just before the end, and the drive could not tell anything."""
    inlets = [k for k, i in enumerate(changed.plan.inlets) if i.message == "slave_state_1"]
    age = changed.own["inlets"]["age_ns"]
    age[-30:-10, inlets] = age[-31, inlets] + 5_000_000 * np.arange(1, 21)[:, None]
    changed.own["state"][-10:] = LifeState.STOPPING
    if not on:
        changed.own["serving"][-10:] &= ~np.uint64(1)
    assert len(changed.said) == named


@pytest.mark.parametrize(
    ("gain", "expected"), [(1.0, ""), (0.0, "follows nothing"), (-1.0, "turns the wrong way")]
)
def test_the_torque_that_a_drive_reports(changed: Changed, gain: float, expected: str) -> None:
    message = "slave_tau_1"
    codec = feedback_codec(changed.system.deployment, message, "tau")
    assert codec is not None
    active = changed.own[changed.own["state"] == LifeState.ACTIVE]
    path = changed.folder / changed.life.frames("right")
    with Journal.create(path, frame_dtype(), len(active)) as log:
        taus = sent_torques(changed.plan, "slave_control", active)
        assert taus is not None
        for row, tau in zip(active[:-1], taus[:-1, 0], strict=True):
            data = codec.encode([gain * tau])
            frame = np.zeros((), frame_dtype())
            frame["id"], frame["length"] = codec.layout.identifier, len(data)
            frame["t_ns"] = START + row["woke_ns"] + 1_000_000
            frame["data"][: len(data)] = np.frombuffer(data, np.uint8)
            log.append(*frame.item())
    texts = changed.said
    assert [expected in text and "drive 1 on bus right" in text for text in texts] == (
        [True] if expected else []
    )


def test_too_little_torque_says_nothing() -> None:
    rng = np.random.default_rng(1)
    noise = rng.standard_normal(100)
    assert not TorqueAnswer.of(1e-3 * rng.standard_normal(100), noise, 0.0).judged
    assert not TorqueAnswer.of(np.zeros(100), noise, 0.0).judged
    dead = TorqueAnswer.of(rng.standard_normal(100), 0.01 * noise, 0.0)
    assert dead.absent and not dead.reversed
