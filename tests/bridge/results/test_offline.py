"""A recorded run as one offline run: the cut into nodes changes nothing where no bus rounds."""

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.cli.diff import lines
from bridge.deployment.system import System
from bridge.recording.run_folder import write_tables, write_trajectories
from bridge.records.node_lives import ByLife
from bridge.replay import replay
from bridge.replay.diff import RunDifference, compare_runs
from bridge.results.offline import recorded_inputs, run_offline
from bridge.results.outcome import deployment_facts
from bridge.wiring.wiring import Rows
from cosim.base.errors import ScenarioError
from cosim.engine.simulate import metadata
from cosim.record import Run, seal, write_metadata
from tests.bridge.deployments import named, run_twin
from tests.cli.command import Command

ARMS = ("master", "slave")
#: Every second hit of a controller brings nothing new,
RARE = tuple(f'deploy.messages.xi_{arm}.period="10 ms"' for arm in ARMS)
#: and its edge fades then.
FADING = (*RARE, *(f"components.{arm}_control.parameters.age_max=0.001" for arm in ARMS))


def recorded(system: System, folder: Path) -> Path:
    """A run folder with the journals of a twin, as a rehearsal leaves it."""
    (folder / "run").mkdir()
    rows = run_twin(system, folder / "run" / "nodes")
    write_trajectories(system, rows, folder / "run")
    write_tables(system, rows, folder / "run")
    facts = metadata(system.scenario, system.plan) | deployment_facts(system, {"settings": []})
    write_metadata(folder / "run", facts)
    seal(folder / "run")
    return folder / "run"


def compared(system: System, folder: Path) -> RunDifference:
    run = recorded(system, folder)
    return compare_runs(run, run_offline(system, run, replay.load(run / "nodes")))


#: The slave takes one sample of two, so that its queue grows until it is full.
QUEUES = (
    "components.slave_control.period=0.01",
    *(f'links.{i}.semantics="queue"' for i in (0, 1)),
    "links.0.depth=80",
    "links.1.depth=1000",
)
CASES = {
    "two arms": lambda: named("zenoh", "run.stop=4"),
    "edges that fade": lambda: named("zenoh", "run.stop=4", *FADING),
    "queues": lambda: named("zenoh", "run.stop=4", *QUEUES),
    "switching graph": lambda: named("network", "run.stop=4"),
}


@pytest.mark.parametrize("case", sorted(CASES))
def test_what_is_sent_as_it_is_leaves_the_same_bits(case: str, tmp_path: Path):
    found = compared(CASES[case](), tmp_path)
    assert found.verdict == "identical", lines(found)


def test_edges_did_fade(tmp_path: Path):
    """Else the case above would show nothing."""
    ends = []
    for name, settings in (("rare", RARE), ("fading", FADING)):
        (tmp_path / name).mkdir()
        run = recorded(named("zenoh", "run.stop=1", *settings), tmp_path / name)
        ends.append(Run.open(run).column("master.q[0]")[-1])
    assert ends[0] != ends[1]


def names(inputs) -> set[str]:
    return {inlet.target.name.partition("[")[0] for _, inlet in inputs}


def test_what_drives_and_rounding_on_can_have_made_of_an_input_it_is_fed_with(tmp_path: Path):
    system = named("can", "run.stop=4")
    found = compared(system, tmp_path)
    assert found.verdict == "identical", lines(found)
    rows = replay.load(tmp_path / "run" / "nodes")
    given = {f"{arm}.tau" for arm in ARMS}
    given |= {f"{arm}_control.{port}" for arm in ARMS for port in ("q", "dq", "xi_in")}
    assert names(recorded_inputs(system, rows)) == given


def test_links_that_are_held_as_sent_run_over_their_tables(tmp_path: Path):
    system = named("zenoh", "run.stop=2")
    recorded(system, tmp_path)
    rows = replay.load(tmp_path / "run" / "nodes")
    assert recorded_inputs(system, rows) == []
    arms = ByLife({life: r.copy() for life, r in rows.items()})
    slot = system.nodes["slave"].plan.slots()["slave_control.xi_in"]
    arms["slave"]["signals"][1500, slot.start + 1] += 1e-12  # a stranger's sample
    assert names(recorded_inputs(system, arms)) == {"slave_control.xi_in"}


def test_a_recording_that_was_altered_is_different(tmp_path: Path):
    """Of an output, which is computed and not fed."""
    system = named("can", "run.stop=2")
    run = recorded(system, tmp_path)
    rows = ByLife({life: r.copy() for life, r in replay.load(run / "nodes").items()})
    slot = system.nodes["slave_control"].plan.slots()["slave_control.tau"]
    rows["slave_control"]["signals"][200:, slot.start] += 1.0
    altered = tmp_path / "altered"
    write_trajectories(system, rows, altered)
    assert compare_runs(altered, run_offline(system, run, rows)).verdict == "different"


def test_as_a_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
):
    run, cosim = recorded(named("zenoh"), tmp_path), Command(monkeypatch, capsys)
    done = cosim("replay", str(run), "--offline")
    assert (done.code, done.err) == (0, "")
    assert "verdict: identical to the bit" in done.out
    assert cosim("replay", str(run), "--offline").code == 0  # again, over what was there


def test_a_run_without_its_tables(tmp_path: Path):
    system = named("zenoh", "run.stop=1")
    run = recorded(system, tmp_path)
    for path in (run / "links").iterdir():
        path.unlink()
    with pytest.raises(ScenarioError, match=r"no table of the link 'master_control\.xi->"):
        run_offline(system, run, replay.load(run / "nodes"))


@pytest.fixture
def newest(tmp_path: Path) -> tuple[System, Path, ByLife[Rows]]:
    """Two arms on a network that takes next to nothing, and copies of what they have recorded."""
    system = named("zenoh", "deploy.latency=false", "run.stop=1")
    run = recorded(system, tmp_path)
    return system, run, ByLife({n: r.copy() for n, r in replay.load(run / "nodes").items()})


def test_clocks_that_differ(newest: tuple[System, Path, ByLife[Rows]]):
    """A receiver whose clock is behind has samples before they were sent: by its clock."""
    system, run, rows = newest
    rows["slave"]["inlets"]["held"] += 16
    ages = write_tables(system, rows, run)
    assert ages["master_control.xi->slave_control.xi_in[0]"].age_maximum == 0.0
    assert names(recorded_inputs(system, rows)) == {"slave_control.xi_in"}
    assert compare_runs(run, run_offline(system, run, rows)).verdict == "identical"


def test_samples_of_the_very_tick_at_both_ends(
    newest: tuple[System, Path, ByLife[Rows]], monkeypatch: pytest.MonkeyPatch
):
    """No order of one offline run gives that: then all inputs are fed."""
    system, run, rows = newest
    rows["master"]["inlets"]["held"][100:] += 1  # as the slave does: it comes after the master
    write_tables(system, rows, run)
    monkeypatch.setattr("bridge.results.offline.recorded_inputs", lambda system, rows: [])
    assert compare_runs(run, run_offline(system, run, rows)).verdict == "identical"
