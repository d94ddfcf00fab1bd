"""A rehearsal in lock-step that is killed and resumed is the twin, to the bit; what is refused."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random

import pytest
from typer.testing import CliRunner

from bridge.deployment.system import System, load_system
from bridge.node.checkpoints import numbers, place
from bridge.records.node_lives import Life
from bridge.records.records import Remark
from bridge.rehearsal.checkpoints import last_number
from bridge.rehearsal.kept_run import KeptRun
from bridge.rehearsal.replacement import ReplacingRun
from bridge.rehearsal.settings import Settings
from bridge.rehearsal.supervisor import NODES, Rehearsal
from bridge.replay import replay
from cosim.base.copies import replace
from cosim.base.errors import CosimError, Interrupted, ScenarioError
from cosim.cli.commands import app
from tests.bridge.deployments import CONFIGS, run_twin
from tests.bridge.zenoh.rehearsed import sockets

SCENARIO, DEPLOYMENT = CONFIGS / "teleoperation.toml", CONFIGS / "deploy/zenoh.toml"
ARMS = ("master", "slave")
FILE = str(SCENARIO)
LOCKSTEP = "deploy.buses.net.options.lockstep=true"


def changes_in(folder: Path, stop: float) -> tuple[str, ...]:
    wait = 'deploy.buses.net.options.wait="20 s"'
    return (LOCKSTEP, wait, f"run.stop={stop}", *sockets(ARMS, folder))


def prepared(tmp_path: Path, stop: float) -> tuple[System, Path, tuple[str, ...]]:
    """The teleoperation in lock-step, its new run folder, and the changes that make it so."""
    changes = changes_in(tmp_path, stop)
    (tmp_path / "run").mkdir()
    return load_system(SCENARIO, str(DEPLOYMENT), changes), tmp_path / "run", changes


def settings_of(
    kept: KeptRun,
    system: System,
    folder: Path,
    changes: Sequence[str],
    files: tuple[Path, Path] = (SCENARIO, DEPLOYMENT),
) -> Settings:
    kept.check(system)
    found = Settings(*files, tuple(changes), warm_up=0.0)
    return replace(found, keeping=kept.begin(system, folder))


def run(system: System, settings: Settings, folder: Path, kill_at: float = 1e9) -> list[str]:
    """The run until its end; all nodes are killed at a time of the run (s). Its notes."""
    with Rehearsal(system, settings, folder) as running:

        def progress(t: float, end: float) -> None:
            if t >= kill_at:
                for node in running.current.values():
                    node.send_signal(signal.SIGKILL)

        return [str(note) for note in running.run(progress).notes]


def is_the_twin(system: System, folder: Path) -> None:
    expected, found = run_twin(system, folder / "alone"), replay.load(folder / NODES)
    assert set(expected) == set(found)
    for life, rows in expected.items():
        assert rows.tobytes() == found[life].tobytes(), life


@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2))])
def test_a_run_that_is_killed_is_resumed_to_the_bits_of_the_twin(seed: int, tmp_path: Path) -> None:
    random, (system, folder, changes) = Random(seed), prepared(tmp_path, 20.0)
    kept = KeptRun(0.0, {"place": os.getcwd()})
    for kill_at in sorted(random.uniform(0.0, 19.0) for _ in range(1 + seed)):
        settings = settings_of(kept, system, folder, changes)
        assert "killed by SIGKILL" in "".join(run(system, settings, folder, kill_at))
        number, t_ns = last_number(system, folder / NODES) or (-1, -1)
        assert number > 0 and 0 < t_ns < 20e9
        kept = KeptRun.open(folder, None)
        with pytest.raises(ScenarioError, match=r"run\.stop was 20\.0 and is 31"):
            kept.check(load_system(SCENARIO, str(DEPLOYMENT), [*changes, "run.stop=31"]))
    assert run(system, settings_of(kept, system, folder, changes), folder) == []
    is_the_twin(system, folder)


@pytest.mark.slow
def test_a_run_that_is_interrupted_saves_its_state_first(tmp_path: Path) -> None:
    system, folder, changes = prepared(tmp_path, 20.0)
    kept = KeptRun(1e3, {"place": os.getcwd()})
    settings = settings_of(kept, system, folder, changes)

    def interrupt(t: float, end: float) -> None:
        if t >= 1.0:
            os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(Interrupted), Rehearsal(system, settings, folder) as running:
        running.run(interrupt)
    number, t_ns = last_number(system, folder / NODES) or (-1, -1)
    assert number == 1 and t_ns >= 1e9  # the first one is of the start
    kept = KeptRun.open(folder, None)
    assert run(system, settings_of(kept, system, folder, changes), folder) == []
    is_the_twin(system, folder)


@pytest.mark.slow
def test_a_damaged_state_is_recognised_and_the_one_before_it_is_used(tmp_path: Path) -> None:
    system, folder, changes = prepared(tmp_path, 12.0)
    kept = KeptRun(0.0, {"place": os.getcwd()})
    run(system, settings_of(kept, system, folder, changes), folder, 5.0)
    number, _ = last_number(system, folder / NODES) or (-1, -1)
    states = place(folder / NODES, Life("slave"))
    latest = next(name for n, name in numbers(states).items() if n == number)
    data = bytearray((states / latest).read_bytes())
    data[len(data) // 2] ^= 1
    (states / latest).write_bytes(data)
    before = last_number(system, folder / NODES)
    assert before is not None and before[0] == number - 1
    kept = KeptRun.open(folder, None)
    assert run(system, settings_of(kept, system, folder, changes), folder) == []
    is_the_twin(system, folder)


BLOCKS = "tests.cosim.checkpoint.blocks"
#: A hand at the slave follows the mean of random numbers: two components in Python in one node.
PYTHON = (
    f'components.noise={{model="{BLOCKS}:Noise", period="5 ms"}}',
    f'components.mean={{model="{BLOCKS}:Mean", period="5 ms", inputs={{u="noise.y"}}}}',
    'components.slave.inputs.q_h="mean.y"',
    "components.slave.parameters={k_p=10.0, k_d=5.0}",
    'deploy.nodes.slave.components=["slave", "slave_control", "noise", "mean"]',
)
#: Six robots whose graph is drawn again every 150 ms.
SWITCHING = CONFIGS / "network.toml", CONFIGS / "deploy/network.toml"
ROBOTS = tuple(f"robot{i}" for i in range(1, 7))
KINDS = {
    "python": ((SCENARIO, DEPLOYMENT), ARMS, PYTHON),
    "switching": (SWITCHING, ROBOTS, ()),
}


@pytest.mark.parametrize("kind", ["python", pytest.param("switching", marks=pytest.mark.slow)])
def test_python_components_and_switching_graphs_are_resumed_as_the_twin(
    kind: str, tmp_path: Path
) -> None:
    files, names, own = KINDS[kind]
    wait = 'deploy.buses.net.options.wait="20 s"'
    changes = (LOCKSTEP, wait, "run.stop=6", *own, *sockets(names, tmp_path))
    system, folder = load_system(files[0], str(files[1]), changes), tmp_path / "run"
    folder.mkdir()
    kept = KeptRun(0.0, {"place": os.getcwd()})
    settings = settings_of(kept, system, folder, changes, files)
    assert "killed by SIGKILL" in "".join(run(system, settings, folder, 2.0))
    number, t_ns = last_number(system, folder / NODES) or (-1, -1)
    assert number > 0 and 0 < t_ns < 6e9
    kept = KeptRun.open(folder, None)
    assert run(system, settings_of(kept, system, folder, changes, files), folder) == []
    is_the_twin(system, folder)


class Killer:
    """Kills a process of a run at each of some times (s); `pid` gives it by the number of kills."""

    def __init__(self, times: Sequence[float], pid: Callable[[int], int]) -> None:
        self.times, self._pid, self.killed, self.said = sorted(times), pid, 0, list[str]()

    def progress(self, t: float, end: float) -> None:
        if self.killed > len(self.said) or self.killed == len(self.times):
            return  # until the last one is replaced
        if t >= self.times[self.killed]:
            os.kill(self._pid(self.killed), signal.SIGKILL)
            self.killed += 1

    def tell(self, sentence: str) -> None:
        self.said.append(sentence)


def pid_of(folder: Path, node: str) -> int:
    """The process of a node that runs now."""
    return int(json.loads((folder / "rehearsal.json").read_text())["nodes"][node])


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in range(1, 5))]
)
def test_nodes_that_are_killed_are_replaced_and_the_run_is_the_twin(
    seed: int, tmp_path: Path
) -> None:
    random, (system, folder, changes) = Random(seed), prepared(tmp_path, 20.0)
    kept = KeptRun(random.choice((0.0, 0.2)), {"place": os.getcwd()})
    killer = Killer(
        [random.uniform(0.0, 19.0) for _ in range(1 + seed % 3)],
        lambda number: pid_of(folder, random.choice(ARMS)),
    )
    running = ReplacingRun(kept, system, settings_of(kept, system, folder, changes), folder)
    ended = running.run(killer.progress, killer.tell)
    assert [type(note) for note in ended.notes] == [Remark] * len(killer.said)
    assert len(killer.said) == len(killer.times)
    for sentence in killer.said:
        assert re.fullmatch(
            r"node (master|slave) has ended: killed by SIGKILL; all nodes begin again at "
            r"t = [0-9.]+ s \(replacement [123] of 3 before the next checkpoint\)",
            sentence,
        )
    is_the_twin(system, folder)


@pytest.mark.slow
def test_a_node_that_dies_again_and_again_ends_the_run(tmp_path: Path) -> None:
    system, folder, changes = prepared(tmp_path, 20.0)
    kept = KeptRun(1e3, {"place": os.getcwd()})  # without a checkpoint after that at the start
    killer = Killer([2.0] * 9, lambda number: pid_of(folder, "slave"))
    settings = settings_of(kept, system, folder, changes)
    running = ReplacingRun(kept, system, settings, folder, most=2)
    ended = running.run(killer.progress, killer.tell)
    assert [sentence.partition("(")[2] for sentence in killer.said] == [
        "replacement 1 of 2 before the next checkpoint)",
        "replacement 2 of 2 before the next checkpoint)",
    ]
    assert str(ended.notes[-1]).endswith("node slave has ended: killed by SIGKILL")


BAD: list[tuple[list[str], str]] = [
    ([FILE, "--checkpoint", "1s"],
     "--checkpoint: found checkpoints on a clock, expected them in lock-step: --clock lockstep"),
    ([FILE, "--clock", "lockstep", "--checkpoint", "1s", "--set", "components.slave.isolate=true"],
     "node slave: --checkpoint: found what a checkpoint cannot save: slave is isolated"),
    ([FILE, "--clock", "lockstep", "--checkpoint", "1s",
      "--set", f'components.other={{model="{BLOCKS}:Silent", period="5 ms"}}',
      "--set", 'deploy.nodes.slave.components=["slave", "slave_control", "other"]'],
     "node slave: --checkpoint: found what a checkpoint cannot save: other "),
    ([FILE, "--clock", "lockstep", "--checkpoint", "1s", "--deploy", f"{CONFIGS}/deploy/can.toml"],
     "is CAN, which may lose frames; expected a deployment over Zenoh alone"),
    ([FILE, "--clock", "lockstep", "--checkpoint", "1s", "--nodes", "master"],
     "found --nodes with --checkpoint"),
    ([FILE, "--clock", "lockstep", "--checkpoint", "1s", "--outside", "master"],
     "found --outside with --checkpoint"),
    ([FILE, "--clock", "lockstep", "--checkpoint", "soon"], "--checkpoint: found 'soon'"),
    (["--resume", "run", FILE, "--set", "run.stop=1"], "found a scenario, --set with --resume"),
    (["--resume", "run", "--clock", "lockstep"], "found --clock with --resume"),
    (["--resume", "nowhere"], "nowhere: there is no such run folder"),
    (["--resume", "run"], "run: has no checkpoint"),
    ([], "found no scenario"),
]  # fmt: skip


@pytest.mark.parametrize(("words", "sentence"), BAD)
def test_what_cannot_be_kept_is_refused_before_the_run(
    words: list[str], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").mkdir()
    own = {"--resume", "--deploy"}.isdisjoint(words)
    deploy = ["--deploy", str(DEPLOYMENT)] if FILE in words and own else []
    found = CliRunner().invoke(app, ["rehearse", *words, *deploy])
    error = found.exception
    code = error.exit_code if isinstance(error, CosimError) else found.exit_code
    assert code == 2
    assert sentence in " ".join(f"{found.output} {error}".split())
    assert not (tmp_path / "runs").exists()
