"""`cosim node` over TLS: started by the operator, and what becomes of a stranger."""

import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from bridge.deployment.system import load_system
from bridge.records.node_lives import ByLife, Life
from bridge.replay import replay
from bridge.zenoh.certificates import make_keys
from tests.bridge.zenoh.rehearsed import CONFIGS, sockets
from tests.bridge.zenoh.test_channel import free_ports

ARMS = ("master", "slave")
SCENARIO = CONFIGS / "teleoperation.toml"
CALL = [sys.executable, "-c", "from cosim.cli import main; main()"]
pytestmark = pytest.mark.slow


def settings(keys: Path, *more: str) -> list[str]:
    """Two arms over TLS on this machine."""
    said = "deploy.buses.net"
    ports = dict(zip(ARMS, free_ports(2), strict=True))
    listen = [f'{said}.options.listen.{a}="tls/127.0.0.1:{port}"' for a, port in ports.items()]
    secure = CONFIGS / "zenoh" / "secure.json5"
    return [f'{said}.zenoh="{secure}"', f'{said}.options.keys="{keys}"', *listen, *more]


def command(what: str, changes: Sequence[str], *words: str) -> "subprocess.Popen[str]":
    said = [word for change in changes for word in ("--set", change)]
    return subprocess.Popen(
        [*CALL, what, str(SCENARIO), *words[:1], "--deploy", "zenoh", *said, *words[1:]],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def node(arm: str, changes: Sequence[str], folder: Path) -> "subprocess.Popen[str]":
    return command("node", changes, f"--node={arm}", "--out", str(folder / arm))


def wait_until_ready(nodes: "Sequence[subprocess.Popen[str]]") -> None:
    for process in nodes:
        assert process.stdout is not None
        ready = any("waiting for NMT start" in s for s in iter(process.stdout.readline, ""))
        assert ready, process.communicate()


def test_the_operator_starts_nodes_with_certificates(tmp_path: Path):
    make_keys(tmp_path / "keys", [*ARMS, "operator"])
    changes = settings(tmp_path / "keys", 'run.stop="1 s"')
    nodes = [node(arm, changes, tmp_path) for arm in ARMS]
    wait_until_ready(nodes)
    for process in (command("tell", changes, "start"), *nodes):
        said, errors = process.communicate(timeout=60.0)
        assert process.returncode == 0, said + errors
    system = load_system(SCENARIO, "zenoh", changes)
    rows, heard = (
        ByLife({Life(arm): read(tmp_path / arm / "nodes")[arm] for arm in ARMS})
        for read in (replay.load, replay.received_by_life)
    )
    found = replay.replay(system, rows, heard, tmp_path)
    assert (found.greatest, found.first, found.alone) == (0.0, None, ())


def test_the_operator_starts_nodes_in_lock_step(tmp_path: Path):
    (tmp_path / "at").mkdir()
    lockstep = "deploy.buses.net.options.lockstep=true"
    changes = ['run.stop="1 s"', lockstep, *sockets(ARMS, tmp_path / "at")]
    nodes = [node(arm, changes, tmp_path) for arm in ARMS]
    wait_until_ready(nodes)
    for process in (command("tell", changes, "start"), *nodes):
        said, errors = process.communicate(timeout=60.0)
        assert process.returncode == 0, said + errors
    rows = [replay.load(tmp_path / arm / "nodes")[Life(arm)] for arm in ARMS]
    assert [len(r) for r in rows] == [1000, 1000]


def stranger(folder: Path) -> Path:
    """Keys of an authority of its own."""
    make_keys(folder / "other", ["slave"])
    return folder / "other"


def nobody(folder: Path) -> Path:
    """A certificate of the right authority, of no node, under a node's name."""
    make_keys(folder / "keys", ["thief"])
    (folder / "names").mkdir()
    for name, file in (
        ("ca.pem", "ca.pem"),
        ("thief.pem", "slave.pem"),
        ("thief.key", "slave.key"),
    ):
        shutil.copy(folder / "keys" / name, folder / "names" / file)
    return folder / "names"


def test_a_node_with_the_wrong_certificate_ends_with_a_sentence(tmp_path: Path):
    """So does the one that waits for it; nothing was run."""
    make_keys(tmp_path / "keys", ["master"])
    waiting = 'deploy.buses.net.options.wait="3 s"'
    ended = []
    for name, keys in (("stranger", stranger(tmp_path)), ("nobody", nobody(tmp_path))):
        changes = settings(tmp_path / "keys", waiting)
        wrong = [*changes, f'deploy.buses.net.options.keys="{keys}"']
        ended += [node("master", changes, tmp_path / name), node("slave", wrong, tmp_path / name)]
    for process, other in zip(ended, ("slave", "master") * 2, strict=True):
        _, errors = process.communicate(timeout=60.0)
        assert process.returncode != 0
        assert errors.splitlines()[-1].startswith("error: ") and "Traceback" not in errors
        assert f"not there: {other}" in errors and "certificates" in errors
    assert not list(tmp_path.glob("**/*.journal"))
