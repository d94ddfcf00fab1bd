"""``cosim falsify``: what it prints, its exit codes, its folder, and that the result is true."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import tomllib
from pathlib import Path

import pytest

from cosim.cli.falsify import FalsifyOptions
from cosim.cli.options import wall_seconds
from cosim.falsify.scenario_text import text
from cosim.record import Run
from tests.cli.command import CALL, CONFIG, ROOT, Command
from tests.cosim.falsify.plants import integrator

STIFF = [
    "--set", "components.master.parameters.k_p=100",
    "--set", "components.master.parameters.k_d=10",
    "--set", 'run.stop="2 s"',
    "--set", 'require={near={always="abs(master.q[0]) < 20 rad"}}',
]  # fmt: skip


def loop(folder: Path, a: float = 0.3, **tables: object) -> Path:
    path = folder / "loop.toml"
    path.write_text(text({**integrator(a, 8, 120.0), **tables}))
    return path


def test_the_grip_that_all_constant_delays_spare_breaks_by_one_segment(cosim: Command) -> None:
    """On links of 0.3 to 1.2 s a grip of 100 N.m/rad and 10 N.m.s/rad diverges within a second."""
    done = cosim("falsify", CONFIG, *STIFF, "--out", "out", "--jobs", "2", "--json", "found.json")
    assert done.code == 1, done.err
    lines = dict(line.split(maxsplit=1) for line in done.out.splitlines())
    assert "to 1 segment on 1 link" in lines["shrunk"]
    assert lines["breaks"].startswith("near is violated") and "instead of 750 ms" in lines["breaks"]
    found = json.loads(Path("found.json").read_text())
    assert found["family"] != "constant" and found["families"]["constant"] >= 300
    assert len(found["segments"]) == 1 and found["robust"]
    files = {p.name for p in Path("out").iterdir()}
    assert {"failing.toml", "report.html", "netem.sh", "test_failing.py", "falsify.json"} <= files
    assert_breaks_and_the_nominal_one_passes(cosim)
    assert_it_stands_alone(cosim)
    assert_the_script_is_one_of_the_shell()


def assert_breaks_and_the_nominal_one_passes(cosim: Command) -> None:
    again = cosim("run", "out/failing.toml", "--out", "again", "--no-plot")
    assert again.code == 1
    rows = [Run.open(folder).array("master.q") for folder in ("again", "out/failing")]
    assert rows[0].tobytes() == rows[1].tobytes()
    nominal = Run.open("out/nominal").metadata
    assert nominal["status"] == "finished"


def assert_it_stands_alone(cosim: Command) -> None:
    document = tomllib.loads(Path("out/failing.toml").read_text())
    assert "falsify" not in document
    laws = [link["delay"]["law"] for link in document["links"]]
    assert sorted(laws) == ["constant", "segments"]
    Path("moved").mkdir()
    Path("out/failing.toml").rename("moved/other.toml")
    assert cosim("run", "moved/other.toml", "--out", "third", "--no-plot").code == 1


def assert_the_script_is_one_of_the_shell() -> None:
    script = Path("out/netem.sh").read_text()
    assert "set_to delay 750000us" in script
    subprocess.run(["sh", "-n", "out/netem.sh"], check=True)


def test_no_failure_is_told_with_the_least_margin(cosim: Command, tmp_path: Path) -> None:
    done = cosim("falsify", loop(tmp_path, 0.1), "--runs", "30", "--jobs", "1")
    assert done.code == 0, done.err
    assert "no failure       found in " in done.out
    assert "least margin     decays: margin 0.8" in done.out
    assert not Path("runs/loop-falsified/failing.toml").exists()
    assert json.loads(Path("runs/loop-falsified/falsify.json").read_text())["found"] is False


def test_the_test_in_the_folder_holds_the_failure(cosim: Command, tmp_path: Path) -> None:
    path = loop(tmp_path, 0.4)  # too much for the nominal delay
    assert cosim("falsify", path, "--jobs", "1", "--out", "out").code == 1
    done = subprocess.run(
        ["python", "-m", "pytest", "-q", "-p", "no:cacheprovider", "out/test_failing.py"],
        capture_output=True, text=True, env=_environment(),
    )  # fmt: skip
    assert "1 xfailed" in done.stdout, done.stdout + done.stderr


def _environment() -> dict[str, str]:
    import sys

    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT)}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--set", "require={}"], "no requirement that could be violated; expected [require.NAME]"),
        (["--set", "links.0.delay={law='constant', delay=3.0}"], "nothing can move"),
        (["--set", "falsify.links={'*'={delay=[3.0, 2.0]}}"], "at falsify.links.*.delay"),
        (["--time", "soon"], "--time"),
        (["--time", "0 s"], "--time: found 0 s; expected a time of more than 0"),
        (["--set", "falsify.families=['zigzag']"], "no family 'zigzag'"),
    ],
)
def test_what_cannot_be_searched_is_one_sentence(
    arguments: list[str], words: str, cosim: Command, tmp_path: Path
) -> None:
    done = cosim("falsify", loop(tmp_path), *arguments, "--out", "out")
    assert done.code == 2
    assert words in done.err and done.err.count("\n") == 1
    assert not Path("out").exists()


@pytest.mark.parametrize("given, seconds", [("5m", 300.0), ("90", 90.0), ("2 min", 120.0)])
def test_times_have_units(given: str, seconds: float) -> None:
    assert wall_seconds(given, "--time") == seconds
    assert FalsifyOptions(time=given).budget().passes


def test_ctrl_c_keeps_what_there_is_and_the_same_command_continues(tmp_path: Path) -> None:
    path = loop(tmp_path, 0.1)
    call = [*CALL, "falsify", str(path), "--out", str(tmp_path / "out"), "--jobs", "1"]
    process = subprocess.Popen(
        [*call, "--time", "10 min"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        cwd=ROOT,
    )  # fmt: skip
    journal = tmp_path / "out" / "journal.jsonl"
    while not journal.exists() or journal.read_bytes().count(b"\n") < 70:
        assert process.poll() is None, process.communicate()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert "no failure" in out and "the same command continues" in err
    n = journal.read_bytes().count(b"\n")
    done = subprocess.run([*call, "--runs", "40"], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert journal.read_bytes().count(b"\n") >= n


def test_a_killed_search_ends_as_one_that_nothing_disturbed(tmp_path: Path) -> None:
    path = loop(tmp_path, 0.1)
    call = [*CALL, "falsify", str(path), "--runs", "200", "--jobs", "2", "--quiet", "--out"]
    subprocess.run([*call, str(tmp_path / "whole")], cwd=ROOT, check=True)
    process = subprocess.Popen([*call, str(tmp_path / "out")], cwd=ROOT)
    journal = tmp_path / "out" / "journal.jsonl"
    while not journal.exists() or journal.read_bytes().count(b"\n") < 70:
        assert process.poll() is None
    process.kill()
    process.wait()
    killed = journal.read_bytes()
    subprocess.run([*call, str(tmp_path / "out")], cwd=ROOT, check=True)
    assert journal.read_bytes().startswith(killed[: killed.rindex(b"\n") + 1])
    rows = [len((tmp_path / x / "journal.jsonl").read_bytes().splitlines()) for x in RESULTS]
    assert rows[0] == rows[1]
    found = [json.loads((tmp_path / x / "falsify.json").read_text()) for x in RESULTS]
    assert found[0] == found[1]


RESULTS = ("whole", "out")
