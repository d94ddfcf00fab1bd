"""Same seed, same bytes: whatever the order, the interface, the executor or the size of a chunk."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim.engine.simulate
from cosim.record import Run
from tests.cosim.oracle import execute
from tests.system.golden import make
from tests.system.runs import CONFIG, SIDES, Document, plan, run, signals, teleoperation

STOP = 3.0  # s: what is sent arrives, first after 0.3 s, and acts


def recorded(folder: Path) -> dict[str, bytes]:
    """Trajectories and link tables, byte for byte."""
    files = [folder / "trajectories.parquet", *sorted((folder / "links").iterdir())]
    return {file.name: file.read_bytes() for file in files}


def made(document: Document, folder: Path) -> dict[str, bytes]:
    """What a run of a document records."""
    run(document, folder)
    return recorded(folder)


def with_models(document: Document, arm: str, control: str, **more: Any) -> Document:
    """The same scenario with other makers of its models."""
    for side in SIDES:
        document["components"][side] |= {"model": f"fmus.models.planar2r{arm}", **more}
        control_model = {"model": f"fmus.models.teleoperation{control}", **more}
        document["components"][f"{side}_control"] |= control_model
    return document


# ---- bytes --------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_bytes_and_another_one_does_not(tmp_path: Path) -> None:
    first, again, other = (
        made(teleoperation(stop=STOP, seed=seed), tmp_path / str(i))
        for i, seed in enumerate((7, 7, 8))
    )
    assert len(first) == 3
    assert first == again
    assert all(first[name] != other[name] for name in first)


def test_the_order_in_which_things_are_listed_does_not_matter(tmp_path: Path) -> None:
    document = teleoperation(stop=STOP)
    other = backwards(document)
    assert list(other["components"]) == list(document["components"])[::-1]
    assert made(other, tmp_path / "b") == made(document, tmp_path / "a")


def backwards(value: Any) -> Any:
    """Every table and the list of links in reverse."""
    if isinstance(value, dict):
        turned = {key: backwards(entry) for key, entry in reversed(value.items())}
        return turned | {"links": turned["links"][::-1]} if "links" in turned else turned
    return value


@pytest.mark.parametrize(
    ("arm", "control", "more"),
    [
        ("", "", {"fmi": "3.0"}),
        (":kernel", ":kernel", {}),
        ("", ":kernel", {"fmi": "3.0"}),
    ],
    ids=["FMI 3.0", "call-backs into the C kernels", "both in one scenario"],
)
def test_fmi_2_fmi_3_and_a_python_call_back_give_the_same_bytes(
    tmp_path: Path, arm: str, control: str, more: dict[str, str]
) -> None:
    document = teleoperation(stop=STOP)
    other = with_models(teleoperation(stop=STOP), arm, control, **more)
    assert made(other, tmp_path / "other") == made(document, tmp_path / "fmi2")


@pytest.mark.parametrize("ticks", [64, 1000, 2999, 3000, 3001, 1 << 20])
def test_the_size_of_a_chunk_does_not_matter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ticks: int
) -> None:
    before = made(teleoperation(stop=STOP), tmp_path / "before")
    monkeypatch.setattr(cosim.engine.simulate, "CHUNK_TICKS", ticks)
    assert made(teleoperation(stop=STOP), tmp_path / "after") == before


def test_a_run_replays_from_its_link_tables(tmp_path: Path) -> None:
    """Run -> table -> run: neither law, semantics nor seed is needed any more."""
    document = teleoperation(stop=STOP, seed=5)
    for link in document["links"]:
        link["semantics"] = "last-arrival"
    first = run(document, tmp_path / "first")
    replay = teleoperation(stop=STOP, seed=0)
    for link in replay["links"]:
        file = first.link_tables[f"{link['from']}->{link['to']}"]
        link["delay"] = {"law": "table", "file": str(file.relative_to(tmp_path))}
    again = run(replay, tmp_path / "again", path=tmp_path / "replay.toml")
    there, here = recorded(first.path.parent), recorded(again.path.parent)
    assert here["trajectories.parquet"] == there["trajectories.parquet"]
    assert here.keys() == there.keys()


# ---- references ---------------------------------------------------------------------------------


@pytest.mark.parametrize("algorithm", ["sampled", "jacobi"])
def test_the_engine_is_the_oracle_with_fmus(algorithm: str) -> None:
    document = teleoperation(stop=2.0)
    document["run"]["algorithm"] = algorithm
    fast, slow = signals(plan(document)), execute(plan(document))
    assert fast.shape == slow.shape
    assert fast.tobytes() == slow.tobytes()


def test_jacobi_is_another_algorithm() -> None:
    document = teleoperation(stop=0.5)
    sampled = signals(plan(document))
    document["run"]["algorithm"] = "jacobi"
    assert np.abs(signals(plan(document)) - sampled).max() > 1e-3


def test_the_numpy_reference_gives_the_same_trajectory() -> None:
    fmus = signals(plan(teleoperation(stop=1.5)))
    numpy = signals(plan(make.document(1.5)))
    assert np.abs(fmus - numpy).max() < 1e-9


def test_a_run_is_the_golden_trajectory(tmp_path: Path) -> None:
    golden = np.loadtxt(make.FILE, delimiter=",", skiprows=1)
    names = make.FILE.read_text(encoding="utf-8").splitlines()[0].split(",")
    assert tuple(names) == ("t", *make.COLUMNS)
    result = run(teleoperation(stop=make.STOP), tmp_path / "run")
    ours = np.column_stack([result.column(name) for name in names])[: -1 : make.EVERY]
    assert ours.shape == golden.shape
    assert np.abs(ours - golden).max() < 1e-9


def test_the_golden_file_is_what_its_script_makes() -> None:
    golden = np.loadtxt(make.FILE, delimiter=",", skiprows=1)
    fresh = make.rows(stop=1.0)
    assert np.abs(golden[: len(fresh)] - fresh).max() < 1e-12


# ---- many ---------------------------------------------------------------------------------------


def copies(n: int, models: Callable[[Document], Document] = lambda d: d) -> Document:
    """`n` teleoperators side by side, with links of constant delay so that all are equal."""
    one = models(teleoperation(stop=2.0))
    many = one | {"components": {}, "links": []}
    for i in range(n):
        for name, component in one["components"].items():
            inputs = {port: f"n{i}_{source}" for port, source in component["inputs"].items()}
            many["components"][f"n{i}_{name}"] = component | {"inputs": inputs}
        for link in one["links"]:
            ends = {end: f"n{i}_{link[end]}" for end in ("from", "to")}
            delay = {"law": "constant", "delay": 0.7}
            many["links"].append(link | ends | {"delay": delay})
    return many


@pytest.mark.parametrize("n", [3, 10], ids=["12 FMUs", "40 FMUs"])
def test_many_fmus_do_not_disturb_each_other(tmp_path: Path, n: int) -> None:
    alone = run(copies(1), tmp_path / "alone")
    together = run(copies(n), tmp_path / "together")
    assert len(together.names) == n * len(alone.names)
    for i in range(n):
        for name in alone.names:
            twin = together.column(name.replace("n0_", f"n{i}_"))
            assert np.array_equal(twin, alone.column(name)), name


def test_many_fmus_of_both_versions_and_call_backs_agree(tmp_path: Path) -> None:
    alone = run(copies(1), tmp_path / "alone")
    document = copies(3)
    for name, component in document["components"].items():
        if name.startswith("n1_"):
            component["fmi"] = "3.0"
        if name.startswith("n2_"):
            component["model"] += ":kernel"
    together = run(document, tmp_path / "together")
    for name in alone.names:
        for i in range(3):
            twin = together.column(name.replace("n0_", f"n{i}_"))
            assert np.array_equal(twin, alone.column(name)), name


def test_a_stored_run_says_what_it_was(tmp_path: Path) -> None:
    result = run(teleoperation(stop=0.1, seed=3), tmp_path / "run")
    said = Run.open(tmp_path / "run").metadata
    assert said == result.metadata
    assert (said["seed"], said["ticks"], said["step"]) == (3, 100, 1e-3)
    assert said["scenario"]["path"] == str(CONFIG)
    assert set(said["fmus"]) == set(said["scenario"]["components"])
    assert all(len(fmu["sha256"]) == 64 for fmu in said["fmus"].values())
