"""A LeRobot pair in one process: as late as its table, the same bits every time, torques felt."""

from __future__ import annotations

import csv
from math import isnan
from pathlib import Path

import numpy as np
import pytest
from lerobot.robots import Robot, RobotConfig
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from lerobot_robot_cosim import (
    LinkRobot,
    LinkRobotConfig,
    LinkTeleoperator,
    LinkTeleoperatorConfig,
    pair,
)

from cosim.base.errors import CosimError
from cosim.links.storage import load_table
from tests.integrations.lerobot.devices import JOINTS, Follower, Leader

CYCLES = 300
GAMMA = '{ law = "gamma", shift = "40 ms", shape = 2, scale = "30 ms", maximum = "400 ms" }'


class Pair:
    """Both plug-ins between a leader and a follower, connected."""

    def __init__(self, **keys: object) -> None:
        given = {"joints": list(JOINTS)} | keys
        self.robot = LinkRobot(LinkRobotConfig(id="far", **given))
        self.teleoperator = LinkTeleoperator(LinkTeleoperatorConfig(id="near", **given))
        self.leader, self.follower = Leader(), Follower()
        self.robot.connect()
        self.teleoperator.connect()

    def run(self, cycles: int = CYCLES) -> list[dict[str, float]]:
        """The rows of so many cycles; both ends are closed."""
        try:
            ends = self.leader, self.robot, self.follower, self.teleoperator
            return list(pair(*ends, cycles))
        finally:
            self.robot.disconnect()
            self.teleoperator.disconnect()


def same(a: list[dict[str, float]], b: list[dict[str, float]]) -> bool:
    """True if the rows have the same names and bits."""
    arrays = [np.array([list(row.values()) for row in rows]) for rows in (a, b)]
    return list(a[0]) == list(b[0]) and arrays[0].tobytes() == arrays[1].tobytes()


def test_the_plug_ins_are_lerobots_and_found_by_their_type() -> None:
    assert issubclass(LinkRobot, Robot) and issubclass(LinkTeleoperator, Teleoperator)
    assert isinstance(LinkRobotConfig(joints=["a"]), RobotConfig)
    assert isinstance(LinkTeleoperatorConfig(joints=["a"]), TeleoperatorConfig)
    for kind, config in (
        (RobotConfig, LinkRobotConfig),
        (TeleoperatorConfig, LinkTeleoperatorConfig),
    ):
        choices = kind.get_known_choices() if hasattr(kind, "get_known_choices") else kind.known
        assert choices["cosim_link"] is config


def test_two_plug_ins_repeat_to_the_bit_by_law_and_by_what_was_saved(tmp_path: Path) -> None:
    first = Pair(there=GAMMA, back="60 ms", seed=4)
    files = {way: tmp_path / f"{way}.parquet" for way in ("there", "back")}
    connection = first.robot.connection
    rows = first.run()
    assert connection is not None
    for way, file in files.items():
        getattr(connection, way).save(file)
    assert same(rows, Pair(there=GAMMA, back="60 ms", seed=4).run())
    assert not same(rows, Pair(there=GAMMA, back="60 ms", seed=5).run())
    replayed = Pair(there=str(files["there"]), back=str(files["back"]))
    assert same(rows, replayed.run())


def test_actions_are_as_late_as_measured(tmp_path: Path) -> None:
    delays = [0.1, 0.2, 0.05] * 200
    trace = tmp_path / "measured.csv"
    with trace.open("w", newline="") as file:
        csv.writer(file).writerows(
            [("t_send", "delay"), *((k / 20, d) for k, d in enumerate(delays))]
        )
    done = Pair(there=str(trace), fps=20)
    rows = done.run(100)
    arrivals = [k + round(d * 20) for k, d in enumerate(delays)]
    for look, row in enumerate(rows):
        come = [k for k in range(look + 1) if arrivals[k] <= look]
        if not come:
            assert isnan(row["far.observation.link.age"])
            assert row["far.action.shoulder.pos"] == 0.0
            continue
        newest = max(come)
        assert row["far.observation.link.age"] == pytest.approx((look - newest) / 20)
        assert row["far.action.shoulder.pos"] == rows[newest]["near.action.shoulder.pos"]


def test_torques_come_back_late_and_are_felt() -> None:
    done = Pair(back="100 ms", there="50 ms")
    rows = done.run()
    assert len(done.leader.felt) == CYCLES
    for look in range(10, CYCLES):
        felt = done.leader.felt[look]["elbow.torque"]
        assert felt == rows[look - 3]["far.observation.elbow.torque"]
        assert rows[look]["near.observation.link.age"] == pytest.approx(0.1)
        assert rows[look]["near.observation.link.delay"] == pytest.approx(0.1)
    assert max(abs(row["near.observation.elbow.torque"]) for row in rows) > 1.0
    assert not same(rows, Pair(there="50 ms", back="400 ms").run())


def test_lost_samples_are_held_and_get_older(tmp_path: Path) -> None:
    done = Pair(there="40 ms", there_loss='{ law = "independent", p = 0.3 }')
    connection = done.robot.connection
    rows = done.run()
    assert connection is not None
    connection.there.save(tmp_path / "there.parquet")
    _, table = load_table(tmp_path / "there.parquet")
    ages = [row["far.observation.link.age"] for row in rows[10:]]
    assert max(ages) > 0.14 and min(ages) == pytest.approx(2 / 30)
    assert len(set(table.tolist())) < 0.8 * CYCLES


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"joints": []}, "found no joints"),
        ({"start": [1.0]}, "found 1 positions, expected 2"),
        ({"there": "missing.csv"}, "no such file"),
        ({"there": "soon"}, "pair.there"),
        ({"there": '{ law = "gama" }'}, "gama"),
        ({"there": '{ law = "gamma"'}, "pair.there"),
    ],
)
def test_keys_that_do_not_fit_are_refused(keys: dict[str, object], words: str) -> None:
    with pytest.raises(CosimError, match=words):
        Pair(**keys)


def test_sides_with_other_joints_are_refused() -> None:
    robot = LinkRobot(LinkRobotConfig(joints=["a", "b"]))
    robot.connect()
    with pytest.raises(CosimError, match=r"on one side of the connection pair and a\.pos"):
        LinkTeleoperator(LinkTeleoperatorConfig(joints=["b", "a"])).connect()
    robot.disconnect()


def test_without_a_connection_nothing_is_sent() -> None:
    with pytest.raises(RuntimeError, match="not connected"):
        LinkRobot(LinkRobotConfig(joints=["a"])).send_action({"a.pos": 0.0})
    with pytest.raises(RuntimeError, match="not connected"):
        LinkTeleoperator(LinkTeleoperatorConfig(joints=["a"])).get_action()
