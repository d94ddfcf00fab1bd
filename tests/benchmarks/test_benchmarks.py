"""The benchmark scripts run, and all candidates compute the same. No times are evaluated."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks import macro_steps
from benchmarks.models import vdp
from benchmarks.peers import Absent, imported
from benchmarks.race import Contestant, race
from tests.cosim.engine import test_plain_steps
from tests.cosim.fmi.exporter import VARIABLE, export

FOLDER = Path(__file__).parents[2] / "benchmarks"
CASES = ["ring1", "ring2", "ring12", "wide4", "teleoperation"]
OURS = ["engine", "bare C loop, recording", "engine, recording", "simulate, to Parquet"]


class Counter:
    """A session that counts, in steps of `by`; a tick takes a millisecond, it says."""

    def __init__(self, by: int) -> None:
        self.by, self.value = by, 0

    def run(self, ticks: int) -> float:
        self.value += self.by * ticks
        return ticks * 1e-3 * self.by

    def outputs(self) -> bytes:
        return bytes(str(self.value), "ascii")

    def recorded(self, n: int) -> bytes:
        return b""

    def close(self) -> None:
        self.value = -1


def nobody() -> Counter:
    imported("benchmarks.no_such_peer")
    return Counter(0)


def test_a_race_compares_relates_and_names_who_is_absent() -> None:
    makers = {"floor": lambda: Counter(1), "same": lambda: Counter(1), "two": lambda: Counter(2)}
    contestants = [Contestant(name, make, "floor", blocks=2) for name, make in makers.items()]
    contestants.append(Contestant("nobody", nobody, "floor"))
    floor, same, two, absent = (
        t.facts() for t in race(contestants, ticks=20, fmu_steps=4, rounds=3, check=5)
    )
    assert (floor["same"], same["same"], two["same"]) == (True, True, False)
    assert (floor["min_us"], floor["blocks"]) == (pytest.approx(250.0), 6)
    assert (two["ratio_min"], two["ratio_median"]) == (pytest.approx(2.0), pytest.approx(2.0))
    assert "no_such_peer" in absent["absent"]
    with pytest.raises(Absent, match="does not import"):
        nobody()


def run(script: str, folder: Path, *given: str) -> tuple[dict[str, Any], str]:
    """The JSON file and what is printed."""
    path = folder / f"{script}.json"
    command = [sys.executable, str(FOLDER / script), *given, "--quick", "--json", str(path)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(path.read_text(encoding="utf-8")), done.stdout


@pytest.fixture(scope="module")
def engine(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], str]:
    return run("engine.py", tmp_path_factory.mktemp("engine"))


def rows(found: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for case in found["cases"]:
        for row in case["rows"]:
            yield f"{case['case']}, {case['fmi']}, {row['runner']}", row


@pytest.mark.slow
def test_every_case_is_run_in_both_versions(engine: tuple[dict[str, Any], str]) -> None:
    found, _ = engine
    assert [(c["case"], c["fmi"]) for c in found["cases"]] == [
        (case, fmi) for case in CASES for fmi in ("fmi2", "fmi3")
    ]


@pytest.mark.slow
def test_the_engine_computes_what_the_bare_loop_does_to_the_bit(
    engine: tuple[dict[str, Any], str],
) -> None:
    found, _ = engine
    ours = {name: row["same"] for name, row in rows(found) if row["runner"] in OURS}
    assert len(ours) == len(OURS) * len(CASES) * 2
    assert all(same is True for same in ours.values()), ours


@pytest.mark.slow
def test_other_masters_compute_the_same_or_say_why_they_do_not_run(
    engine: tuple[dict[str, Any], str],
) -> None:
    found, _ = engine
    peers = {name: row for name, row in rows(found) if row["runner"] not in (*OURS, "bare C loop")}
    assert len(peers) == 6 * len(CASES) * 2
    for name, row in peers.items():
        assert row["absent"] if "absent" in row else row["same"] is True, name
    assert all("absent" not in row for name, row in peers.items() if "FMPy" in name)


@pytest.mark.slow
def test_fmu_and_kernel_give_the_same_bytes_and_numpy_nearly(
    engine: tuple[dict[str, Any], str],
) -> None:
    found, _ = engine
    assert [c["case"] for c in found["choices"]] == ["ring10", "ring40", "wide4", "teleoperation"]
    for case in found["choices"]:
        for choice in ("fmi2", "fmi3", "kernel"):
            assert case["choices"][choice]["same"] is True, (case["case"], choice)
            assert case["choices"][choice]["difference"] == 0.0
        assert case["choices"]["numpy"]["difference"] < 1e-12


@pytest.mark.slow
def test_tables_drawn_before_the_run_are_those_drawn_in_it(
    engine: tuple[dict[str, Any], str],
) -> None:
    found, _ = engine
    assert [d["scalars"] for d in found["delays"]] == [12, 56, 56]
    for delay in found["delays"]:
        assert delay["rows"]["links, drawn in the run"]["same"] is True
        assert delay["rows"]["wires"]["same"] is False  # late is not the same as in time


@pytest.mark.slow
def test_fmus_of_others_are_called_alike_by_the_engine_and_the_bare_loop(tmp_path: Path) -> None:
    events = export(test_plain_steps.events(f'{VARIABLE} hasEventMode="true"'), tmp_path / "x.fmu")
    fmus = [vdp.fmu("2.0"), events]
    found, text = run("foreign.py", tmp_path, *map(str, fmus))
    cases = [f"{fmu.stem}, {n}" for fmu in fmus for n in (1, 4)]
    assert [r["case"] for r in found["cases"]] == [n for n in CASES for _ in range(2)] + cases
    rows = [row for r in found["cases"] for row in r["rows"]]
    ignoring = [row for row in rows if "ignoring" in row["runner"]]
    assert len(ignoring) == 4 and not any(row["same"] for row in ignoring)
    assert all(row["same"] for row in rows if row not in ignoring)
    assert all(r["title"] in text for r in found["cases"])


def test_the_tables_name_everybody(engine: tuple[dict[str, Any], str]) -> None:
    found, text = engine
    for _, row in rows(found):
        assert f"| {row['runner']} " in text
    assert {"processor", "compiler", "packages", "python"} <= set(found["machine"])


@pytest.mark.slow
def test_stages_and_memory_of_the_teleoperator(tmp_path: Path) -> None:
    found, text = run("teleoperation.py", tmp_path)
    stages = ["start Python", "run and record", "metrics", "write the report", "end Python"]
    assert set(stages) <= set(found["stages"])
    parts = sum(stage["wall"]["median"] for stage in found["stages"].values())
    assert parts == pytest.approx(found["total"]["median"], rel=0.01)
    assert all(m["peak_mb"] > 10 for m in found["memory"].values())
    assert "x real time" in text


@pytest.mark.slow
def test_every_command_is_measured_beside_the_start_of_python(tmp_path: Path) -> None:
    found, said = run("startup.py", tmp_path)
    names = ["python -c pass", "cosim --help", "cosim check", "cosim run --no-plot", "cosim run"]
    assert list(found["seconds"]) == names
    assert all(0 < found["seconds"][names[0]][0] < found["seconds"][name][0] for name in names[1:])
    assert all(name in said for name in names)


@pytest.mark.slow
def test_the_way_to_the_first_report_is_measured_stage_by_stage(tmp_path: Path) -> None:
    found, said = run("first_report.py", tmp_path)
    stages = ["git clone", "python -m venv", "pip install .", "cosim run"]
    names = list(found["seconds"])
    assert names[:4] == stages and names[-2:] == ["cosim rehearse", "cosim replay"]
    for times in (found["seconds"], found["processor"]):
        parts = sum(times[name][0] for name in names[: names.index("together")])
        assert times["together"][0] == pytest.approx(parts)
    assert all(name in said for name in stages)


@pytest.mark.slow
@pytest.mark.browser
def test_a_live_page_is_measured_from_its_size_to_the_changed_run(tmp_path: Path) -> None:
    found, said = run("live_page.py", tmp_path)
    assert found["bytes"]["plain"] < found["bytes"]["live"] < 2_500_000
    assert found["processor_s"]["plain"] > 0 and found["first_picture_ms"] > 0
    assert 0 < found["computed_ms"] < found["shown_ms"] and "moved value shown in" in said


@pytest.mark.slow
def test_dynamics_of_an_arm_are_measured_and_those_of_others_where_they_are(
    tmp_path: Path,
) -> None:
    found, said = run("chain.py", tmp_path)
    assert set(found["ours"]) == {"forward", "inverse"}
    assert {"plant arm", "controller pd"} < found["steps"].keys()
    assert "mujoco" in found or "MuJoCo" in found["absent"][0]
    assert "| ours, forward dynamics (chain_forward) " in said


def test_macro_steps_need_fewer_steps_for_a_smaller_error() -> None:
    found = list(macro_steps.rows("soft", 1, quick=True))
    fixed = [row for row in found if row[0] == "jacobi"]
    adaptive = [row for row in found if row[0] == "adaptive"]
    assert adaptive[0][2] < 0.01 < fixed[0][2] and adaptive[0][3] < fixed[0][3]
    assert adaptive[1][2] < 1e-4 < fixed[1][2] and adaptive[1][3] < fixed[1][3]
    assert macro_steps.table(found).count("adaptive") == 2


def test_checkpoints_have_a_size_and_a_price(tmp_path: Path) -> None:
    found, said = run("checkpoint.py", tmp_path)
    (row,) = found["rows"]
    assert row["bytes"] > 1000 and row["one"] > 0 and row["resume"] > 0
    assert "overhead" in said


@pytest.mark.slow
@pytest.mark.parametrize("hosts", [1, 3])
def test_the_hosts_of_a_stopped_measurement_are_removed(hosts: int) -> None:
    """SIGTERM, in the run of a row."""
    folder = Path("/run/netns")
    code = (
        "import sys; from benchmarks import lockstep as b;"
        f"b.many = lambda *_: b.run_many(b.Case(4, {hosts}, 30), '10 ms', 1e4);"
        "sys.argv = ['lockstep', '--many']; sys.exit(b.main())"
    )
    words = [sys.executable, "-c", code]
    with subprocess.Popen(words, cwd=FOLDER.parent, stderr=subprocess.PIPE, text=True) as process:
        mine = f"cosim-{process.pid}-*"
        while process.poll() is None and len([*folder.glob(mine)]) < hosts:
            time.sleep(0.02)
        time.sleep(0.5)
        process.terminate()
        said = process.communicate(timeout=120)[1]
    assert process.returncode == 143, said
    assert not [*folder.glob(mine)]
