"""Tables of many links in one file: the same rows as in files of their own, whole or cut short."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cosim.base.errors import RunError, ScenarioError
from cosim.engine import simulate as simulation
from cosim.engine.simulate import simulate
from cosim.links.storage import load_table, open_table, read_facts, recover_tables
from cosim.loading.files import load
from cosim.record import Run, claim_folder, link_tables
from cosim.record.folder import TABLE_ROWS, TABLES
from cosim.record.link_tables import TablesWriter, table_paths
from cosim.record.recover import stored_tables
from cosim.scenario.assemble import assemble
from cosim.scenario.recorded import with_recorded_links
from tests.bridge.zenoh.rehearsed import CONFIGS

NAMES = ["a.xi -> b.xi[0]", "käse/100 %", "links", "x" * 80]
FACTS = {name: {"name": name, "sender_period": 1, "h": 0.1 * i} for i, name in enumerate(NAMES)}
ROWS = st.lists(st.integers(-1, 2**31 - 1), max_size=9)


def written(folder: Path, blocks: list[list[list[int]]]) -> TablesWriter:
    writer = TablesWriter(folder, FACTS)
    for block in blocks:
        rows = np.array([x for rows in block for x in rows], np.int32)
        writer.write(rows, np.array([len(rows) for rows in block]))
    return writer


def tables(folder: Path) -> dict[str, list[int]]:
    found = {name: load_table(path) for name, path in table_paths(folder).items()}
    assert all(facts == FACTS[name] for name, (facts, _) in found.items())
    return {name: rows.tolist() for name, (_, rows) in found.items()}


def joined(blocks: list[list[list[int]]]) -> dict[str, list[int]]:
    return {name: [x for block in blocks for x in block[i]] for i, name in enumerate(NAMES)}


@settings(max_examples=60, suppress_health_check=list(HealthCheck))
@given(
    blocks=st.lists(st.lists(ROWS, min_size=4, max_size=4), max_size=5),
    cut=st.integers(0, 40),
)
def test_what_is_written_is_read_also_where_it_was_cut(
    tmp_path_factory: pytest.TempPathFactory, blocks: list[list[list[int]]], cut: int
) -> None:
    folder = tmp_path_factory.mktemp("run")
    (folder / "run.json").write_text(json.dumps({"links": FACTS}))
    writer = written(folder, blocks)
    writer._file.close()
    assert tables(folder) == joined(blocks)
    rows = (folder / TABLE_ROWS).read_bytes()
    first = rows.index(b"\n") + 1
    kept = max(first, len(rows) - cut)
    (folder / TABLE_ROWS).write_bytes(rows[:kept])
    whole, at = [], first
    for block in blocks:
        at += 4 * (4 + sum(map(len, block)))
        if at <= kept:
            whole.append(block)
    assert tables(folder) == joined(whole)
    recover_tables(folder)
    assert sorted(p.name for p in folder.iterdir()) == [TABLES, "run.json"]
    assert tables(folder) == joined(whole)


def test_the_same_rows_give_the_same_bytes(tmp_path: Path) -> None:
    for name, blocks in (("a", [[[1], [2, 3], [], [-1]]]), ("b", [[[], [2], [], []],
                                                               [[1], [3], [], [-1]]])):  # fmt: skip
        (tmp_path / name).mkdir()
        written(tmp_path / name, blocks).close()
    one, other = ((tmp_path / name / TABLES).read_bytes() for name in "ab")
    assert one == other


def test_links_with_many_rows_are_written_a_few_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link_tables, "_GROUP_ROWS", 20)
    blocks = [[[k, k], [k] * 3, [], [k]] for k in range(3)]
    written(tmp_path, blocks).close()
    with pq.ParquetFile(tmp_path / TABLES) as file:
        assert [file.metadata.row_group(i).num_rows for i in range(2)] == [2, 2]
    assert tables(tmp_path) == joined(blocks)


def test_a_link_that_is_not_there_and_a_damaged_file_are_named(tmp_path: Path) -> None:
    written(tmp_path, [[[1], [2], [3], [4]]]).close()
    with pytest.raises(ScenarioError, match="no table of the link 'q'"):
        read_facts(tmp_path / TABLES / "q")
    (tmp_path / TABLES).write_bytes(b"PAR1 is not all")
    with pytest.raises(ScenarioError, match="not a file of link tables"):
        stored_tables(tmp_path)
    with pytest.raises(RunError, match=r"cannot write .*links\.rows"):
        TablesWriter(tmp_path / "nowhere", FACTS)


def test_a_run_with_one_file_has_the_same_tables_and_repeats(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = load(CONFIGS / "many.toml", ("graphs.net.n=9", "run.stop=2.5"))
    simulate(scenario, tmp_path / "files")
    monkeypatch.setattr(simulation, "MANY", 2)
    simulate(scenario, tmp_path / "one")
    assert not (tmp_path / "one" / "links").exists()
    files, one = (Run.open(tmp_path / name) for name in ("files", "one"))
    assert list(one.link_tables) == list(files.link_tables)
    for name, path in one.link_tables.items():
        facts, rows = load_table(path)
        expected, known = load_table(files.link_tables[name])
        assert facts == expected and np.array_equal(rows, known)
    plan = with_recorded_links(assemble(scenario), tmp_path / "one")
    simulate(scenario, tmp_path / "again", plan=plan)
    again = (tmp_path / "again" / "trajectories.parquet").read_bytes()
    assert again == (tmp_path / "files" / "trajectories.parquet").read_bytes()
    claim_folder(tmp_path / "one", force=True)
    assert not (tmp_path / "one" / TABLES).exists()
    link = plan.links[0]
    assert open_table(
        files.link_tables[link.name], name=link.name, grid=link.table.grid
    ).length == len(load_table(files.link_tables[link.name])[1])


def test_a_run_that_fails_keeps_its_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation, "MANY", 2)
    scenario = load(
        CONFIGS / "many.toml",
        ("graphs.net.n=9", "run.stop=2.5", "components.robot.parameters.k_p=1e9"),
    )
    with pytest.raises(RunError):
        simulate(scenario, tmp_path / "one")
    assert len(Run.open(tmp_path / "one").link_tables) == len(assemble(scenario).links)


def test_tables_that_cannot_be_written_stop_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are written in a thread beside the engine."""
    monkeypatch.setattr(simulation, "MANY", 2)
    monkeypatch.setattr(simulation, "CHUNK_TICKS", 64)
    monkeypatch.setattr("cosim.engine.tables.STRETCH", 40)
    monkeypatch.setattr("cosim.engine.tables.LONGEST", 40)
    calls = iter(range(99))
    write = TablesWriter.write

    def full(self: TablesWriter, rows: NDArray[np.int32], counts: NDArray[np.int64]) -> None:
        if next(calls) == 2:
            raise RunError("no space left")
        write(self, rows, counts)

    monkeypatch.setattr(TablesWriter, "write", full)
    scenario = load(CONFIGS / "many.toml", ("graphs.net.n=9", "run.stop=0.5"))
    with pytest.raises(RunError, match="no space left"):
        simulate(scenario, tmp_path / "run")
    found = Run.open(tmp_path / "run")
    assert found.metadata["status"] == "stopped"
    assert {len(load_table(path)[1]) for path in found.link_tables.values()} == {26}


def test_paths_are_sorted_by_name_and_made_for_links_that_are_there(tmp_path: Path) -> None:
    facts = {name: FACTS[name] for name in reversed(NAMES)}
    with TablesWriter(tmp_path, facts) as writer:
        writer.write(np.arange(4, dtype=np.int32), np.ones(4, np.int64))
    paths = table_paths(tmp_path)
    assert list(paths) == sorted(NAMES) and len(paths) == 4
    assert load_table(paths[NAMES[0]])[1].tolist() == [3]
    with pytest.raises(KeyError):
        paths["nobody"]
