"""Processes that are killed, freeze, fail and restart: the others stay safe, no data is lost."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from bridge.cli.rehearse import rewrite_report
from bridge.cli.replay import recorded_system
from bridge.native.safety import LifeState, Why
from bridge.results.outcome import reopen
from cosim.record import Run
from tests.bridge.rehearsing import (
    NAMESPACE,
    ROOT,
    Left,
    command,
    environment,
    possible,
    run,
    script,
)

pytestmark = pytest.mark.slow
LAW = 'components.master_control.model="tests.bridge.laws:Law"'


def fault(kind, node, at, **more):
    keys = "".join(f"{k} = {v}\n" for k, v in more.items())
    return f'seed = 1\n[[fault]]\nkind = "{kind}"\nnode = "{node}"\nat = {at}\n{keys}'


def emergency(begin):
    """Frames of an emergency stop on the bus of the slave, from `begin` (s) for 0.2 s."""
    keys = f"rate = 100\nfrom = {begin}\nto = {begin + 0.2}\n"
    return f'[[fault]]\nkind = "babble"\nbus = "right"\nid = 1\nlength = 5\n{keys}'


def before_the_stop(rows):
    """The last row of a life that knows nothing of an emergency stop."""
    return np.flatnonzero((rows["reasons"] & Why.ESTOP) == 0)[-1]


@pytest.mark.live
def test_a_controller_that_is_killed_and_an_emergency_stop_of_the_others(tmp_path):
    faults = script(tmp_path, fault("kill", "master_control", 0.5) + emergency(2.5))
    done = run(tmp_path / "run", *faults, stop=3.5)
    assert done.returncode == 1, done.stderr
    left = Left(tmp_path / "run")
    assert left.end("master_control") == "killed"
    for node in ("master", "slave", "slave_control"):
        assert left.state(node) == LifeState.FAULT, node
        assert left.why(node) & Why.ESTOP, node
    assert left.exact()
    alone = left.rows["slave_control"]
    assert alone["state"][before_the_stop(alone)] == LifeState.ACTIVE
    found = reopen(recorded_system(tmp_path / "run"), tmp_path / "run")
    facts = json.loads((tmp_path / "run" / "run.json").read_text())["rehearsal"]
    for name, records in (("notes", found.notes), ("faults", found.faults)):
        assert json.loads(json.dumps([r.facts() for r in records])) == facts[name] != []
    page = rewrite_report(tmp_path / "run").read_text("utf-8")
    assert "kill on master_control" in page and 'class="verdict failed"' in page
    master = left.rows["master"]
    last = before_the_stop(master)
    assert master["state"][last] == LifeState.FAULT
    assert master["reasons"][last] & Why.WATCHDOG
    dq, tau = (left.column("master", f"master.{x}")[last] for x in ("dq", "tau"))
    assert np.allclose(tau, -2.0 * dq, atol=0.5)  # what is left is the drive's damping


def test_a_controller_that_is_killed_leaves_the_other_arm_running_to_the_end(tmp_path):
    faults = script(tmp_path, fault("kill", "master_control", 1))
    assert run(tmp_path / "run", *faults, stop=2.5).returncode == 1
    left = Left(tmp_path / "run")
    assert left.end("slave_control") == "finished"
    assert left.exact()


def test_the_edge_of_a_neighbour_that_died_fades_and_the_arm_goes_on(tmp_path):
    faults = script(tmp_path, fault("kill", "master_control", 1))
    assert run(tmp_path / "run", *faults, stop=2.5).returncode == 1
    left = Left(tmp_path / "run")
    age = left.column("slave_control", "slave_control.age")[:, 0]
    tau = np.abs(left.column("slave_control", "slave_control.tau")).max(axis=1)
    alone = age > 0.2
    assert alone.any()
    assert np.isfinite(tau).all()
    assert left.why("slave_control") == 0


def test_a_drive_that_is_killed_stops_its_controller_and_comes_back(tmp_path):
    faults = script(tmp_path, fault("restart", "slave", 1, **{"for": 0.3}))
    run(tmp_path / "run", *faults, stop=6.0)
    left = Left(tmp_path / "run")
    assert left.state("slave_control") == LifeState.FAULT
    assert left.why("slave_control") & (Why.STALE | Why.PEER)
    assert len(left.rows["slave@2"]) > 10
    assert left.end("master") == left.end("master_control") == "finished"
    assert left.exact()


def test_a_controller_that_freezes(tmp_path):
    faults = script(tmp_path, fault("freeze", "slave_control", 1, **{"for": 0.8}))
    run(tmp_path / "run", *faults, stop=3.0)
    left = Left(tmp_path / "run")
    assert left.state("slave_control") == LifeState.FAULT
    assert left.why("slave_control") & (Why.OVERRUN | Why.STALE | Why.PEER)
    assert left.state("slave") == LifeState.FAULT
    assert left.end("master_control") == "finished"
    assert left.exact()


def test_an_emergency_stop_stops_everybody(tmp_path):
    faults = script(tmp_path, f"seed = 1\n{emergency(0.3)}")
    run(tmp_path / "run", *faults, stop=1.0)
    left = Left(tmp_path / "run")
    for node in ("master", "slave", "master_control", "slave_control"):
        assert left.state(node) == LifeState.FAULT, node
        assert left.why(node) & Why.ESTOP, node
    (found,) = left.facts["rehearsal"]["faults"]
    assert found["kind"] == "babble" and found["places"][0]["signs"][0]["number"] >= 1
    assert left.exact()


def test_an_exception_in_a_component(tmp_path):
    bad = "components.master_control.parameters.t_bad=1"
    done = run(tmp_path / "run", stop=3.0, settings=(LAW, bad))
    assert done.returncode == 1
    left = Left(tmp_path / "run")
    assert left.end("master_control") == "failed"
    assert "on purpose" in left.nodes["master_control"]["said"]["error"]
    assert left.exact()
    tau = np.abs(left.column("master", "master.tau")).max(axis=1)
    assert tau[-1] < 0.2 * tau.max()


def test_a_component_that_calls_exit_0_in_a_node_fails_the_run(tmp_path):
    """The node is gone without a word; the replay may come to the same component, or just not."""
    ends = tuple(f"components.master_control.parameters.{x}=1" for x in ("t_bad", "ends"))
    done = run(tmp_path / "run", stop=3.0, settings=(LAW, *ends))
    assert done.returncode == 1, done
    recorded = Run.open(tmp_path / "run")
    assert recorded.t[-1] >= 0.9
    if recorded.metadata["status"] == "recovered":
        ended = "error: a component or a library ended the process of this command (exit code 0)"
        assert ended in done.stderr
    else:
        assert Left(tmp_path / "run").end("master_control") == "killed"
        assert (
            "verdict                failed: " in done.stdout
            and "master_control: killed" in done.stdout
        )


def started(folder, **options):
    """A rehearsal in the background, running; its supervisor and its nodes."""
    possible()
    process = subprocess.Popen(
        command(folder, **options), cwd=ROOT, env=environment(), text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    facts = _facts(folder, process)
    while time.clock_gettime_ns(time.CLOCK_MONOTONIC) < facts["start_ns"] + 500_000_000:
        time.sleep(0.05)
    return process, facts


def _facts(folder, process):
    path, end = folder / "rehearsal.json", time.monotonic() + 60
    while time.monotonic() < end and process.poll() is None:
        try:
            return json.loads(path.read_text())
        except (OSError, ValueError):
            time.sleep(0.05)
    raise AssertionError(process.communicate()[1])


def alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def all_gone(facts):
    end = time.monotonic() + 15  # the run is longer
    while any(alive(pid) for pid in facts["nodes"].values()):
        assert time.monotonic() < end, "nodes are left running"
        time.sleep(0.05)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ramps_down_and_leaves_a_run(tmp_path, number):
    process, facts = started(tmp_path / "run", stop=30.0)
    os.kill(facts["pid"], number)
    process.communicate(timeout=60)
    assert process.returncode == 128 + number
    all_gone(facts)
    left = Left(tmp_path / "run")
    assert left.exact()
    scale = left.rows["master_control"]["scale"]
    assert scale[-1] == 0.0
    assert ((scale > 0) & (scale < 1)).sum() >= 10


def test_nodes_stop_by_themselves_when_their_supervisor_is_killed(tmp_path):
    process, facts = started(tmp_path / "run", stop=30.0)
    os.kill(facts["pid"], signal.SIGKILL)
    process.communicate(timeout=60)
    all_gone(facts)
    reports = {
        n: json.loads((tmp_path / f"run/nodes/{n}.json").read_text()) for n in facts["nodes"]
    }
    assert {r["end"] for r in reports.values()} == {"stopped"}


def test_an_arm_comes_back_by_reset_arm_and_start(tmp_path):
    possible()
    words = [sys.executable, "-m", "tests.bridge.recovery_in_namespace", str(tmp_path / "run")]
    done = subprocess.run(
        [*NAMESPACE, *words], capture_output=True, text=True, cwd=ROOT, env=environment()
    )
    assert done.returncode == 0, done.stderr
    left = Left(tmp_path / "run")
    states = left.rows["slave_control"]["state"]
    assert (states == LifeState.FAULT).any()
    assert left.state("slave_control") == left.state("slave@2") == LifeState.ACTIVE
    assert left.end("slave_control") == left.end("slave@2") == "finished"
    assert np.abs(left.column("slave@2", "slave.tau")[-20:]).max() > 0.1
    assert left.exact()
