"""The robot's side in a process of its own, over Zenoh on loopback."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

from lerobot_robot_cosim import LinkRobot, LinkRobotConfig, operate

from tests.integrations.lerobot.conftest import HERE
from tests.integrations.lerobot.devices import JOINTS, Leader

FAR = """
import json, sys
import tests.integrations.lerobot.conftest
from lerobot_robot_cosim import LinkTeleoperator, LinkTeleoperatorConfig, serve
from tests.integrations.lerobot.devices import JOINTS, Follower
keys = dict(joints=list(JOINTS), fps=100, connection="far/arm", connect=sys.argv[1])
teleoperator, follower = LinkTeleoperator(LinkTeleoperatorConfig(**keys)), Follower()
teleoperator.connect()
print("ready", flush=True)
rows = list(serve(follower, teleoperator, int(sys.argv[2])))
teleoperator.disconnect()
print(json.dumps(rows))
"""


def free_port() -> int:
    """A port of this machine that was free."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def test_two_processes_exchange_actions_and_torques() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    keys = {"joints": list(JOINTS), "fps": 100, "connection": "far/arm", "listen": endpoint}
    robot, leader = LinkRobot(LinkRobotConfig(**keys)), Leader()
    robot.connect()
    far = subprocess.Popen(
        [sys.executable, "-c", FAR, endpoint, "400"], stdout=subprocess.PIPE, text=True,
        cwd=Path(HERE).parents[2], env=os.environ,
    )  # fmt: skip
    assert far.stdout is not None
    try:
        assert far.stdout.readline() == "ready\n"
        near = list(operate(leader, robot, 200))
        theirs = json.loads(far.stdout.readline())
    finally:
        far.kill()
        far.wait()
        robot.disconnect()
    sent = {row["action.elbow.pos"] for row in near}
    moved = [row for row in theirs if row["observation.link.age"] == row["observation.link.age"]]
    assert moved and all(row["action.elbow.pos"] in sent for row in moved)
    assert len({row["action.elbow.pos"] for row in moved}) > 20
    torques = {row["observation.elbow.torque"] for row in theirs}
    felt = [row for row in near if row["observation.link.age"] == row["observation.link.age"]]
    assert felt and all(row["observation.elbow.torque"] in torques for row in felt)
    assert all(row["observation.link.age"] >= row["observation.link.delay"] for row in felt)
