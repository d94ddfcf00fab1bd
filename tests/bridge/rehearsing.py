"""Rehearsals in a separate network namespace, which udp_multicast cannot leave."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from bridge.deployment.system import load_system
from bridge.native.safety import LifeState, Why
from bridge.records.node_lives import Life
from bridge.replay import replay

ROOT = Path(__file__).resolve().parents[2]
SCENARIO = ROOT / "configs" / "teleoperation.toml"
SETUP = 'ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo && exec "$@"'
NAMESPACE = ("unshare", "--user", "--map-root-user", "--net", "sh", "-c", SETUP, "sh")
COSIM = (sys.executable, "-c", "from cosim.cli import main; main()")
NODES = ("master", "slave", "master_control", "slave_control")


def stale(node):
    """Settings of inputs that stop a controller, and of those that only age."""
    return f'"{node}.q"={{stop="400 ms"}},"{node}.xi_in"={{age="age[0]"}}'


#: Machines stand still now and then; what is to trip takes longer than that.
CALM = (
    'run.step="5 ms"',
    *(f'deploy.nodes.{node}.overrun="400 ms"' for node in NODES),
    *(f'deploy.nodes.{node}.drive.watchdog="400 ms"' for node in NODES[:2]),
    *(f'deploy.nodes.{node}.within="400 ms"' for node in NODES[2:]),
    *(f"deploy.nodes.{node}.stale={{{stale(node)}}}" for node in NODES[2:]),
)


def possible():
    """Skips where there are no namespaces."""
    there = shutil.which("unshare") and shutil.which("ip")
    if not there or subprocess.run([*NAMESPACE, "true"], capture_output=True).returncode:
        pytest.skip("no network namespaces here: multicast is not tested outside of one")


def command(folder, *more, stop=3.0, settings=()):
    """``cosim rehearse`` in a namespace; `settings`: as ``--set`` takes them."""
    said = [*CALM, f"run.stop={stop}", *settings]
    sets = [word for setting in said for word in ("--set", setting)]
    words = ("rehearse", SCENARIO, "-i", "udp_multicast", "--no-twin", "--no-plot")
    return [*NAMESPACE, *COSIM, *map(str, words), "--out", str(folder), *sets, *more]


def environment():
    return {**os.environ, "PYTHONPATH": str(ROOT)}


def run(folder, *more, **options):
    """To its end."""
    possible()
    return subprocess.run(
        command(folder, *more, **options),
        capture_output=True, text=True, cwd=ROOT, env=environment(), timeout=120,
    )  # fmt: skip


def script(folder, text):
    """A fault script as an option."""
    path = folder / "script.toml"
    path.write_text(text)
    return "--faults", str(path)


class Left:
    """Results of a rehearsal: rows of each life, and ``run.json``."""

    def __init__(self, folder):
        self.folder = folder
        self.facts = json.loads((folder / "run.json").read_text())
        self.nodes = self.facts["rehearsal"]["nodes"]
        self.rows = replay.load(folder / "nodes")

    def state(self, life):
        return LifeState(int(self.rows[life]["state"][-1]))

    def why(self, life):
        return Why(int(self.rows[life]["reasons"][-1]))

    def end(self, life):
        return self.nodes[life]["said"].get("end", "killed")

    def exact(self):
        """The replay computed every bit again."""
        facts = self.facts["rehearsal"]
        return facts["replay"] == 0.0 and not facts["replay_error"]

    def column(self, life, name):
        """A signal of a life, (rows, size)."""
        settings = self.facts["deployment"]["settings"]
        deploy = self.facts["deployment"]["path"]
        node = Life.parse(life).node
        slot = load_system(SCENARIO, deploy, settings).nodes[node].plan.slots()[name]
        return self.rows[life]["signals"][:, slot.start : slot.start + slot.size]
