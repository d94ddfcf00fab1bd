"""``cosim run --checkpoint`` and ``--resume``: kills, damaged files, other scenarios, refusals."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

import pytest
from typer.testing import CliRunner

from cosim.base.errors import CosimError, RunError
from cosim.checkpoint import CheckpointInterval, CheckpointKeeper, archive
from cosim.cli.commands import app
from cosim.engine import simulate as simulation
from cosim.engine.simulate import Execution, simulate
from cosim.loading.files import load
from cosim.record.folder import read_metadata
from tests.bridge.zenoh.rehearsed import CONFIGS
from tests.cosim.checkpoint.cuts import contents
from tests.cosim.checkpoint.test_same_bytes import MODEL
from tests.cosim.fmi.exporter import events3, exchange2, export
from tests.cosim.fmi.test_scheduled import scheduled3

FILE = CONFIGS / "teleoperation.toml"
STOP = "3"


@dataclass
class Answer:
    """The exit code of a command, and what it printed."""

    exit_code: int
    output: str


def run(*arguments: object) -> Answer:
    found = CliRunner().invoke(app, ["run", *map(str, arguments)])
    if isinstance(found.exception, CosimError):
        return Answer(found.exception.exit_code, f"{found.output}{found.exception}")
    return Answer(found.exit_code, found.output)


@pytest.fixture
def cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder as the command leaves it when it is killed after about half of the ticks."""
    monkeypatch.setattr(simulation, "CHUNK_TICKS", 64)
    monkeypatch.chdir(tmp_path)
    folder, cut = tmp_path / "kept", tmp_path / "cut"

    def copy(done: int, _: int) -> None:
        if done > 1500 and not cut.exists():
            shutil.copytree(folder, cut)

    given = {
        "command": "cosim run", "place": os.getcwd(), "scenario": str(FILE),
        "settings": [f"run.stop={STOP}"], "threads": 1, "fmu_log": False, "table": None,
        "links": None,
    }  # fmt: skip
    scenario = load(FILE, [f"run.stop={STOP}"])
    keeper = CheckpointKeeper(CheckpointInterval(0.0), given)
    further = {"command": "cosim run"}
    simulate(scenario, folder, copy, further=further, execution=Execution(1, keeper))
    keeper.end()
    return cut


def test_a_run_of_the_command_is_resumed(cut: Path) -> None:
    whole = cut.with_name("whole")
    assert run(FILE, "--stop", STOP, "--no-plot", "--out", whole).exit_code == 0
    found = run("--resume", cut, "--no-plot")
    assert found.exit_code == 0, found.output
    assert "resumed at t = 1.5" in found.output
    one, other = contents(whole), contents(cut)
    facts = [json.loads(x.pop("run.json")) for x in (one, other)]
    for x in facts:
        del x["command"]
    assert one == other and {**facts[1], **facts[0]} == facts[0]
    again = run("--resume", cut)
    assert again.exit_code == 2 and "the run is finished" in again.output


def damage(path: Path, how: str) -> None:
    data = path.read_bytes()
    if how == "cut":
        path.write_bytes(data[: len(data) // 2])
    elif how == "empty":
        path.write_bytes(b"")
    else:
        place = Random(how).randrange(40, len(data))
        path.write_bytes(data[:place] + bytes([data[place] ^ 4]) + data[place + 1 :])


@pytest.mark.parametrize("how", ["cut", "empty", "bit 1", "bit 2", "bit 3"])
def test_of_a_damaged_checkpoint_the_one_before_is_used(cut: Path, how: str) -> None:
    damage(cut / ".checkpoints" / "latest", how)
    found = run("--resume", cut, "--no-plot")
    assert found.exit_code == 0, found.output
    assert found.output.count("the checkpoint before it is used") == 1
    kept = contents(cut.with_name("kept"))
    assert contents(cut)["trajectories.parquet"] == kept["trajectories.parquet"]


def test_without_a_valid_one_it_is_refused_in_a_sentence(cut: Path) -> None:
    for name in ("latest", "previous"):
        damage(cut / ".checkpoints" / name, "bit")
    found = run("--resume", cut)
    assert found.exit_code == 2 and found.output.count("is damaged") == 2
    shutil.rmtree(cut / ".checkpoints")
    assert "has no checkpoint" in run("--resume", cut).output
    assert "no such run folder" in run("--resume", cut / "nowhere").output


def edit(folder: Path, change: Callable[[dict[str, object]], None]) -> None:
    """Change the facts of the latest checkpoint."""
    from cosim.checkpoint import archive

    place = folder / ".checkpoints"
    found = archive.read(place / "latest")
    facts = json.loads(json.dumps(found.facts))
    change(facts)
    archive.write(place, archive.Checkpoint(facts, found.blobs))


CHANGES = {
    "scenario.run.seed": lambda x: x["facts"]["scenario"]["run"].update(seed=8),
    "versions.cosim": lambda x: x["facts"]["versions"].update(cosim="0.1"),
    "fmus.master.sha256": lambda x: x["facts"]["fmus"]["master"].update(sha256="0"),
    "code.engine": lambda x: x["facts"]["code"].update(engine="0"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_another_scenario_version_or_fmu_is_refused_by_name(cut: Path, name: str) -> None:
    edit(cut, CHANGES[name])
    before = {p: p.stat().st_mtime_ns for p in cut.rglob("*")}
    found = run("--resume", cut)
    assert found.exit_code == 2 and f"since {name} was" in found.output
    assert before == {p: p.stat().st_mtime_ns for p in cut.rglob("*")}


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ([FILE], "a scenario with --resume"),
        (["--seed", "3"], "run.seed=3 with --resume"),
        (["--threads", "2", "--force"], "--force, --threads with --resume"),
    ],
)
def test_what_was_given_at_the_start_is_not_given_again(
    cut: Path, arguments: list[object], reason: str
) -> None:
    found = run("--resume", cut, *arguments)
    assert found.exit_code == 2 and reason in found.output


def test_it_is_resumed_where_it_began(cut: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(cut)
    found = run("--resume", ".")
    assert found.exit_code == 2 and "expected --resume to be called there" in found.output


SCENARIO = """
[run]
step = "10 ms"
stop = "1 s"
[components.first]
model = "{0}:{1}"
[components.second]
model = "{0}:{2}"
"""


@pytest.mark.parametrize(
    ("first", "second", "reasons"),
    [
        ("Silent", "Silent", ["first has no get_state and no set_state", "second has no"]),
        ("Noise", "Forgetful", ["second: its state is nothing that can be restored"]),
    ],
)
def test_what_cannot_be_saved_is_named_before_the_run(
    tmp_path: Path, first: str, second: str, reasons: list[str]
) -> None:
    file = tmp_path / "s.toml"
    file.write_text(SCENARIO.format(MODEL, first, second))
    found = run(file, "--checkpoint", "60s", "--out", tmp_path / "run")
    assert found.exit_code == 2 and all(reason in found.output for reason in reasons)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (events3(), "x does not declare canSerializeFMUState; expected an FMU exported with it"),
        (scheduled3(), "x does not declare canSerializeFMUState"),
        (exchange2('canGetAndSetFMUstate="true"'), "x does not declare canSerializeFMUstate"),
    ],
    ids=["events", "scheduled", "only within a run"],
)
def test_an_fmu_that_does_not_serialize_is_named(tmp_path: Path, text: str, reason: str) -> None:
    path = export(text, tmp_path / "x.fmu")
    file = tmp_path / "s.toml"
    file.write_text(f'run = {{ step = 0.01, stop = 1.0 }}\n[components.x]\nmodel = "{path}"\n')
    found = run(file, "--checkpoint", "60s", "--out", tmp_path / "run")
    assert found.exit_code == 2 and reason in found.output
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("text", "found", "such"),
    [("soon", "soon", "60s"), ("-1 s", "-1 s", "60s"), ("60 kg", "60 kg", "60s"),
     ("t=0", "t=0", "t=10s"), ("t=-1 s", "-1 s", "60s"), ("t=", "", "60s")],
)  # fmt: skip
def test_an_interval_is_a_time(tmp_path: Path, text: str, found: str, such: str) -> None:
    answer = run(FILE, "--checkpoint", text, "--out", tmp_path / "run")
    assert answer.exit_code == 2
    assert f"found '{found}', expected a time such as {such}" in answer.output


def test_an_interval_of_the_run_is_kept_at_its_ticks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every 0.35 s, whatever the chunks of the engine are; as it began when it is resumed."""
    monkeypatch.chdir(tmp_path)
    times, keep = [], archive.write

    def note(folder: Path, found: archive.Checkpoint) -> int:
        times.append(found.facts["time"])
        if len(times) == 5:
            raise RunError("the disk is full")
        return keep(folder, found)

    monkeypatch.setattr(archive, "write", note)
    given = [FILE, "--stop", STOP, "--no-plot"]
    assert run(*given, "--out", "kept", "--checkpoint", "t=350 ms").exit_code == 1
    assert run("--resume", "kept", "--no-plot").exit_code == 0
    assert times == pytest.approx([0.35 * k for k in (0, 1, 2, 3, 4, 4, 5, 6, 7, 8)])
    assert run(*given, "--out", "whole").exit_code == 0
    assert (
        contents(tmp_path / "kept")["trajectories.parquet"]
        == (contents(tmp_path / "whole")["trajectories.parquet"])
    )


def test_a_run_that_is_finished_without_a_verdict_is_completed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run folder is as after a kill between the last tick and the requirements."""
    monkeypatch.chdir(tmp_path)
    given = [FILE, "--stop", STOP, "--no-plot"]
    assert run(*given, "--out", "whole").exit_code == 0
    with monkeypatch.context() as patch:
        patch.setattr("cosim.measure.requirements.keep", fail)
        found = run(*given, "--out", "kept", "--checkpoint", "t=0.4 s")
    facts = read_metadata(tmp_path / "kept")
    assert found.exit_code == 1 and facts["status"] == "finished" and "requirements" not in facts
    assert run("--resume", "kept", "--no-plot").exit_code == 0
    one, other = contents(tmp_path / "whole"), contents(tmp_path / "kept")
    found_facts = [json.loads(x.pop("run.json")) for x in (one, other)]
    for x in found_facts:
        del x["command"]
    assert one == other and found_facts[0] == found_facts[1] and found_facts[0]["requirements"]
    assert "the run is finished" in run("--resume", "kept").output


def fail(*_: object) -> None:
    raise RunError("the disk is full")


def test_no_scenario_is_a_sentence() -> None:
    found = run()
    assert found.exit_code == 2 and "expected cosim run SCENARIO, or --resume RUN" in found.output


def test_an_fmu_with_a_limit_of_memory_is_named(tmp_path: Path) -> None:
    keys = ("components.master.isolate=true", "components.master.memory=100")
    settings = [x for key in keys for x in ("--set", key)]
    found = run(FILE, *settings, "--checkpoint", "60s", "--out", tmp_path / "run")
    assert found.exit_code == 2 and "master has a limit of memory" in found.output
