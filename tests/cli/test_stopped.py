"""Runs that stop early: a value that is not finite, a component that fails, Ctrl-C."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path
from time import sleep

import numpy as np
import pytest

from cosim.record import Run, held_folder
from tests.cli.command import CONFIG, Command, Done, started
from tests.tiers import first_fast

HALF = """
[run]
step = 0.001
stop = 4
record = {{ signals = ["arm.q"] }}
[components.arm]
model = "fmus.models.planar2r"
inputs.tau = "half.y"
[components.half]
model = "tests.cli.components:Half"
parameters = {{ {} }}
start = {{ u = [1, 2] }}
"""


def half(parameters: str) -> str:
    Path("half.toml").write_text(HALF.format(parameters), encoding="utf-8")
    return "half.toml"


def test_nan_of_a_component_stops_the_run_where_it_appears(cosim: Command, tmp_path: Path) -> None:
    said = cosim.refused("run", half('fails = "2 s"'), "--out", "here", code=1)
    first, second = said.splitlines()
    assert first == "half: not a finite number: half.y[0] = nan at tick 2000 (t = 2 s)"
    assert second.endswith("and the last ticks of every signal: here")
    result = Run.open(tmp_path / "here")
    assert result.names == ("arm.q[0]", "arm.q[1]")
    assert np.array_equal(result.t, np.arange(2001) * 1e-3)
    assert np.isfinite(result.array("arm.q")).all()
    assert result.metadata["error"].endswith("at tick 2000 (t = 2 s)")


def test_the_last_thousand_ticks_of_every_signal_are_kept(cosim: Command, tmp_path: Path) -> None:
    cosim.refused("run", half('fails = "2 s"'), "--out", "here", code=1)
    last = Run.open(tmp_path / "here" / "last.parquet")
    assert np.array_equal(last.t, np.arange(1001, 2001) * 1e-3)
    expected = {"arm.tau", "arm.tau_ext", "arm.q", "arm.dq", "half.u", "half.y"}
    assert expected <= {name.split("[")[0] for name in last.names}
    assert (last.array("half.y")[:-1] == [0.5, 1.0]).all()
    assert np.isnan(last.column("half.y[0]")[-1])  # the row in which it failed
    whole = Run.open(tmp_path / "here").array("arm.q")
    assert np.array_equal(last.array("arm.q"), whole[1001:])


def test_a_run_that_fails_early_keeps_what_there_is(cosim: Command, tmp_path: Path) -> None:
    cosim.refused("run", half('fails = "3 ms"'), "--out", "here", code=1)
    assert len(Run.open(tmp_path / "here" / "last.parquet")) == 4
    assert len(Run.open(tmp_path / "here")) == 4


def test_nan_at_the_start_leaves_nothing_behind(cosim: Command, tmp_path: Path) -> None:
    Path("half.toml").write_text(
        '[run]\nstep = 0.1\nstop = 1\n[components.half]\nmodel = "tests.cli.components:Half"\n'
        "start.u = [0, 0]\nparameters.fails = -1\n",
        encoding="utf-8",
    )
    said = cosim.refused("run", "half.toml", "--out", "here", code=1)
    assert said == "half.y = [nan, 0.0] at the start"
    assert not (tmp_path / "here").exists()


def test_an_unstable_gain_drives_an_fmu_out_of_the_numbers(cosim: Command, tmp_path: Path) -> None:
    """K = 400 N.m.s/rad at 5 ms: K h > 2 lambda_min(M). The FMU refuses, and says why."""
    setting = "components.master_control.parameters.K=400"
    said = cosim.refused("run", CONFIG, "--set", setting, "--out", "here", code=1)
    first, second = said.splitlines()
    assert first.startswith("master: doStep returned discard (")
    assert "diverged" in first
    tick = int(first.split("at tick ")[1].split()[0])
    assert first.endswith(f"at tick {tick} (t = {tick * 1e-3:.6g} s)")
    assert second.endswith("the last ticks of every signal: here")
    last = Run.open(tmp_path / "here" / "last.parquet")
    assert last.t[-1] == pytest.approx((tick + 1) * 1e-3)  # tick itself was recorded before
    assert len(last) == min(1000, tick + 2)
    assert np.abs(last.column("master.dq[0]")).max() > 1e3
    assert "master_control.w[0]" in last.names
    assert not list((tmp_path / "here").glob("*.png"))
    report = (tmp_path / "here" / "report.html").read_text(encoding="utf-8")
    assert "error</span> master: doStep returned discard" in report


def test_what_a_component_raises_is_named_with_its_line(cosim: Command) -> None:
    scenario = Path("raises.toml")
    scenario.write_text(
        '[run]\nstep = 0.001\nstop = 1\n[components.wide]\nmodel = "tests.cosim.blocks:Wide"\n'
        "parameters = { fail_at = 0.5 }\n",
        encoding="utf-8",
    )
    said = cosim.refused("run", scenario, "--out", "here", code=1)
    assert said.startswith("wide: ZeroDivisionError: one over nothing (blocks.py, line ")
    assert "at tick 500 (t = 0.5 s)" in said


@pytest.mark.parametrize("code", [0, 3])
@pytest.mark.parametrize("words", [("run", "--out", "here"), ("linearize", "--at", "0.3")])
def test_a_component_that_exits_in_a_step_does_not_end_the_command(
    cosim: Command, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], code: int
) -> None:
    monkeypatch.delitem(sys.modules, "own", raising=False)
    Path("own.py").write_text(
        "import sys\nfrom tests.cosim.blocks import Integrator\n"
        "class Own(Integrator):\n    def step(self, t, h, u):\n"
        f"        if t > 0.15: sys.exit({code})\n        return super().step(t, h, u)\n",
        encoding="utf-8",
    )
    Path("own.toml").write_text(
        '[run]\nstep = 0.1\nstop = 1\n[components.own]\nmodel = "own:Own"\nstart.u = 1\n',
        encoding="utf-8",
    )
    said = cosim.refused(words[0], "own.toml", *words[1:], code=1)
    assert f"own: sys.exit({code}) (own.py, line 5) at tick 2" in said


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("import nothing_of_this_name", "No module named 'nothing_of_this_name'"),
        ("x = 1 / 0", "ZeroDivisionError: division by zero (own.py, line 1)"),
        ("import sys; sys.exit(0)", "importing 'own': sys.exit(0) (own.py, line 1)"),
        ("import sys\ndef Own(): sys.exit()", "own:Own: sys.exit(None) (own.py, line 2)"),
        (
            "import sys\nfrom tests.cosim.blocks import Gain\n"
            "class Own(Gain):\n    def initialize(self, values): sys.exit(3)",
            "own does not start: sys.exit(3) (own.py, line 4)",
        ),
        ("def f(:", "SyntaxError: invalid syntax (own.py, line 1)"),
        ("class Own: pass", "Own is not a component: it has no kind, inputs, "),
        ("def Own(): return 1 / 0", "ZeroDivisionError: division by zero (own.py, line 1)"),
        ("def Own(n): ...", "missing 1 required positional argument: 'n'"),
        (
            "from tests.cosim.blocks import Gain\nclass Own(Gain): kind = 'sometimes'",
            "Own.kind is 'sometimes'; expected 'sampled' or 'continuous'",
        ),
        (
            "from tests.cosim.blocks import Gain\nclass Own(Gain): inputs = Gain.inputs[0]",
            "expected a tuple of Ports",
        ),
        (
            "from tests.cosim.blocks import Gain\n"
            "class Own(Gain):\n    def initialize(self, values): raise ValueError('no')",
            "own does not start: ValueError: no (own.py, line 3)",
        ),
        (
            "from tests.cosim.blocks import Gain\n"
            "class Own(Gain):\n    def initial(self, u): return {}",
            "own does not start: returned no 'y'",
        ),
        (
            "from tests.cosim.blocks import Gain\n"
            "class Own(Gain):\n    def initial(self, u): return {'y': [1, 2]}",
            "own does not start: returned 'y': ",
        ),
        (
            "from tests.cosim.blocks import Gain\n"
            "class Own(Gain):\n    def initial(self, u): return u['u']",
            "own does not start: returned a ndarray, expected a dict {'y': ...}",
        ),
        (
            "import numpy as np\nfrom tests.cosim.blocks import Gain\n"
            "class Own(Gain):\n    def initial(self, u): return np.linalg.inv(np.zeros((2, 2)))",
            "own does not start: LinAlgError: Singular matrix (own.py, line 4)",
        ),
    ],
)
def test_a_component_that_cannot_be_made_is_a_sentence(
    cosim: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str, message: str
) -> None:
    monkeypatch.delitem(sys.modules, "own", raising=False)
    (tmp_path / "own.py").write_text(body + "\n", encoding="utf-8")
    Path("own.toml").write_text(
        '[run]\nstep = 0.1\nstop = 1\n[components.own]\nmodel = "own:Own"\n', encoding="utf-8"
    )
    said = cosim.refused("run", "own.toml", "--out", "here")
    assert message in said
    assert "own" in said
    assert not (tmp_path / "here").exists()


# ---- Ctrl-C -------------------------------------------------------------------------------------


def ended(process: subprocess.Popen[str], folder: Path, number: signal.Signals) -> tuple[str, Run]:
    """Send a signal once the run has recorded something; its message and what it left."""
    part = folder / "trajectories.parquet.part"
    try:
        for _ in range(6000):
            if part.is_file() and part.stat().st_size > 1000:
                break
            assert process.poll() is None, process.communicate()
            sleep(0.01)
        process.send_signal(number)
        _, said = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 128 + number
    return Done.of(128 + number, "", said).err, Run.open(folder)


@pytest.mark.parametrize("number", first_fast([signal.SIGINT, signal.SIGTERM, signal.SIGHUP]))
@pytest.mark.parametrize("parts", ["FMUs", "call-backs"])
def test_a_signal_keeps_what_was_recorded(
    tmp_path: Path, parts: str, number: signal.Signals
) -> None:
    scenario: Path = CONFIG
    if parts == "call-backs":
        scenario = tmp_path / "loop.toml"
        scenario.write_text(
            "[run]\nstep = 0.001\nstop = 1\n"
            '[components.gain]\nmodel = "tests.cosim.blocks:Gain"\ninputs.u = "x.y"\n'
            '[components.x]\nmodel = "tests.cosim.blocks:Integrator"\ninputs.u = "gain.y"\n',
            encoding="utf-8",
        )
    process = started("run", scenario, "--set", "run.stop=1e6", "--out", "here", cwd=tmp_path)
    said, result = ended(process, tmp_path / "here", number)
    sentence, place = said.strip().split("; recorded until then: ")
    assert place == "here"
    time = float(sentence.removeprefix("interrupted at t = ").removesuffix(" s"))
    assert result.t[-1] == pytest.approx(time, rel=1e-5, abs=2e-3)  # or a tick before
    assert np.array_equal(result.t, np.arange(len(result)) * 1e-3)
    assert all(np.isfinite(result.column(name)).all() for name in result.names)
    assert result.metadata["error"].startswith("Interrupted: interrupted at t = ")
    assert result.metadata["status"] == "stopped"


@pytest.mark.parametrize("number", first_fast([signal.SIGINT, signal.SIGTERM, signal.SIGHUP]))
def test_a_signal_ends_a_sweep_after_the_runs_under_way(
    tmp_path: Path, number: signal.Signals
) -> None:
    (tmp_path / "study.toml").write_text(
        f'scenario = "{CONFIG}"\n[vary.seed]\npaths = ["run.seed"]\nvalues = {list(range(2000))}\n',
        encoding="utf-8",
    )
    words = ("sweep", "study.toml", "--workers", "threads", "--jobs", "1", "--out", "here")
    process = started(*words, cwd=tmp_path)
    try:
        while process.poll() is None and not any(_sizes(tmp_path / "here")):
            sleep(0.05)
        process.send_signal(number)
        _, said = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 128 + number, said
    assert "stopping after the current runs" in said
    done = int(said.split("interrupted; ")[1].split()[0])
    assert 0 < done < 2000
    assert f"interrupted; {done} more runs are in here; continue with --resume" in said


def _sizes(folder: Path) -> list[int]:
    """Of what a sweep has stored."""
    return [path.stat().st_size for path in folder.glob("*.jsonl")]


@pytest.mark.parametrize(
    "words",
    [("run",), ("run", "--deploy", "can"),
     ("rehearse", "--deploy", "can", "-i", "cosim", "--clock", "simulated")],
)  # fmt: skip
def test_no_command_touches_the_folder_of_a_run_that_goes_on(
    cosim: Command, tmp_path: Path, words: tuple[str, ...]
) -> None:
    (tmp_path / "here" / "nodes").mkdir(parents=True)
    files = {tmp_path / "here" / name for name in ("run.json", "trajectories.parquet.part")}
    files |= {tmp_path / "here" / "nodes" / "master-1.journal"}
    for file in files:
        file.write_text("{}")
    with held_folder(tmp_path / "here"):
        done = cosim(words[0], CONFIG, *words[1:], "--out", "here", "--force", "--quiet")
    assert done.code == 2
    last = done.err.splitlines()[-1]
    assert last.startswith("error: ") and last.endswith(
        "here: another command records into this folder; choose another one, or wait for its end"
    )
    assert {path for path in (tmp_path / "here").rglob("*") if path.is_file()} == files
