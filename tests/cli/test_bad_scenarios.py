"""Scenarios and options that cannot be: one sentence with its place, exit code 2."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.cli.command import CONFIG, Command, finished

SHORT = ("--set", "run.stop=0.1", "--no-plot", "--quiet")
CONSTANT = '{law="constant", delay=0}'

WRONG = [
    # names
    ('components.master.inputs.torque="master_control.tau"', "no input of master 'torque'"),
    ('components.master.inputs.tau="master_control.taux"', "did you mean 'tau'"),
    ('components.master.inputs.tau="control.tau"', "no component 'control'"),
    ("components.master.parameters.kp=1", "did you mean 'k_p'"),
    ("components.master.preset=SL92", "no preset 'SL92'; did you mean 'SL91'? (there are: "),
    ('run.record.signals=["master.qq"]', "at run.record.signals: no signal 'master.qq'"),
    ('metrics.effort.of=["master.tauh"]', "at metrics.effort: no recorded signal 'master.tauh'"),
    ('figures.positions.panels.0.y=["x"]', "at figures.positions.panels.0: no recorded signal 'x'"),
    ('metrics.effort.of=["master.tau_g"]', "did you mean 'master.tau_h'"),
    ("components.master.model=fmus.models.nothing", "cannot import 'fmus.models.nothing'"),
    ("components.nobody.period=1", "no 'nobody' in components (there are: master, "),
    # keys
    ("components.master.colour=1", "at components.master: no key 'colour'"),
    ("run.colour=1", "(there are: adaptive, algorithm, order, record, seed, start, step, stop)"),
    ("run.record.colour=1", "at run.record: no key 'colour'"),
    ("colour=1", "unknown key 'colour'; expected one of title, run, "),
    ("links.0.colour=1", "at links.0: no key 'colour'"),
    ("links.0.delay.colour=1", "at links.0: delay: no key 'colour'"),
    # shapes, units and numbers
    (
        'components.master.inputs.tau="master_control.theta_hat"',
        "has shape [3], master.tau expects",
    ),
    ('components.master.inputs.tau="master_control.xi"', "is in [rad/s], master.tau expects [N.m]"),
    ("components.master.parameters.k_p=[1, 2, 3]", "expected shape [2], found 3 entries"),
    ('components.master.parameters.k_p="1 m"', "[m] cannot feed [N.m/rad]"),
    ('components.master.parameters.k_p="ten"', "'ten' is not a number with a unit"),
    ("components.master.parameters.substeps=1.5", "substeps is an integer, found [1.5]"),
    ("components.master.parameters.k_p=-1", "master does not start: "),
    ('run.step="1 kg"', "at run.step: [kg] cannot feed [s]"),
    ('run.stop="1"', "'1' has no unit"),
    ("run.stop=-1", "must be positive"),
    ("run.record.every=0", "at run.record.every: expected a whole number >= 1, found 0"),
    ("run.seed=-1", "at run.seed: expected a whole number >= 0, found -1"),
    (
        "run.algorithm=newton",
        "value 'newton'; expected one of sampled, jacobi, gauss-seidel, adaptive",
    ),
    # metrics and figures
    (
        "metrics.tracking_error.target=[1, 2, 3]",
        "at metrics.tracking_error: master.q has size 2, but its target is a list of length 3",
    ),
    ("metrics.sync_error.target=slave.tau_h", "master.q is in [rad] but slave.tau_h is in [N.m]"),
    ('metrics.peak_torque.of=["master.q", "master.tau_h"]', "at metrics.peak_torque: master.q is"),
    ("metrics.effort.kind=taste", "at metrics.effort: unknown kind 'taste'"),
    ("metrics.effort.within=1", "at metrics.effort: kind 'norm' takes no 'within'"),
    ("figures.positions.panels=[]", "at figures.positions.panels: expected a list of length >= 1"),
    # rates
    ('components.master_control.period="1.5 ms"', "not a multiple of the base step 0.001 s"),
    ("run.stop=0.10005", "at run.stop: 0.10005 s is not a multiple"),
    # links
    ("links.0.semantics=carrier-pigeon", "at links.0.semantics: Invalid enum value"),
    ("links.0.delay.law=never", "at links.0: delay.law: no kind 'never'"),
    ("links.0.delay.high=0.1", "at links.0: "),
    ('links.0.delay={law="trace", file="nowhere.csv"}', "nowhere.csv"),
    ('links.0.delay={law="table", file="nowhere.parquet"}', "nowhere.parquet: no such file"),
    ('links.0.to="slave_control.xi_in[1]"', "[1] is outside of slave_control.xi_in"),
    ('links.0.to="slave_control.q"', "units do not fit: master_control.xi is in [rad/s]"),
    ('links.0.to="master_control.xi_in[0]"', "is fed twice: by "),
    # the setting itself
    ("nothing", "--set 'nothing': expected path=value"),
    ("links.7.semantics=fifo", "'7' is not a valid index; expected an integer below 2"),
    ("run.step.more=1", "--set 'run.step.more=1': run.step is not a table"),
]


@pytest.mark.parametrize(("setting", "message"), WRONG, ids=[s for s, _ in WRONG])
def test_what_cannot_be_is_refused_with_its_place(
    cosim: Command, tmp_path: Path, setting: str, message: str
) -> None:
    said = cosim.refused("run", CONFIG, *SHORT, "--set", setting, "--out", "here")
    assert message in said
    assert str(CONFIG) in said or "--set" in said or "does not start" in said
    assert not (tmp_path / "here").exists()


def test_a_loop_is_printed_with_the_ways_out_of_it(cosim: Command) -> None:
    settings = [part for i in (0, 1) for part in ("--set", f"links.{i}.delay={CONSTANT}")]
    said = cosim.refused("run", CONFIG, *SHORT, *settings)
    assert (
        "master_control.xi -> slave_control.xi_in[0], slave_control.xi -> master_control.xi_in[0]"
        in said
    )
    assert "fmus.models.xi" in said and "jacobi" in said
    done = cosim("run", CONFIG, *SHORT, *settings, "--set", "run.algorithm=jacobi", "--out", "here")
    assert done.code == 0


@pytest.mark.parametrize("command", ["run", "show"])
@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("gone.toml", None, "gone.toml: no such file"),
        ("no.toml", "[run\n", "no.toml: not valid TOML: "),
        ("empty.toml", "", "empty.toml: no [run] table"),
        ("few.toml", "[run]\nstep = 1\nstop = 1\n", "few.toml: no [components] table"),
        ("no_step.toml", "[run]\nstop = 1\n[components]\n", "the key 'step' is missing"),
        ("plant.fmu", "PK", "plant.fmu: "),
        ("gone.fmu", None, "gone.fmu: "),
        ("latin.toml", "title = '\udce9'\n", "latin.toml: cannot be read: "),
    ],
)
def test_a_file_that_is_no_scenario_is_refused(
    cosim: Command, command: str, name: str, content: str | None, message: str
) -> None:
    if content is not None:
        Path(name).write_text(content, encoding="utf-8", errors="surrogateescape")
    assert message in cosim.refused(command, name)


def test_a_folder_is_no_scenario(cosim: Command) -> None:
    assert ".: is a folder" in cosim.refused("run", ".")


def test_a_folder_that_cannot_be_made_is_said_before_the_run(
    cosim: Command, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    said = cosim.refused("run", CONFIG, *SHORT, "--out", "file/here")
    assert said == f"{tmp_path}/file/here: cannot use this folder: Not a directory"


def nowhere_to_write(tmp_path: Path) -> Path:
    """A folder in which nobody may make another, root neither where there is /proc."""
    closed = tmp_path / "closed"
    closed.mkdir()
    closed.chmod(0o500)
    return Path("/proc") if os.access(closed, os.W_OK) else closed


def test_a_working_directory_that_cannot_be_written_needs_out(tmp_path: Path) -> None:
    cwd = nowhere_to_write(tmp_path)
    said = finished("run", CONFIG, *SHORT, cwd=cwd)
    assert (said.code, said.out) == (2, "")
    assert said.err.startswith(f"error: {cwd}/runs/teleoperation-")
    assert "cannot use this folder: " in said.err
    done = finished("run", CONFIG, *SHORT, "--out", tmp_path / "here", cwd=cwd)
    assert (done.code, done.err) == (0, "")


@pytest.mark.parametrize(
    "arguments",
    [(), ("frobnicate",), ("run",), ("run", CONFIG, "--seed", "x"), ("run", CONFIG, "--colour")],
)
def test_a_command_that_is_misspelt_is_told_how(
    cosim: Command, arguments: tuple[str | Path, ...]
) -> None:
    done = cosim(*arguments)
    assert done.code == 2
    assert "usage" in (done.out + done.err).lower()
    assert "Traceback" not in done.err
