"""Trace files: what is read, and where a file that cannot be read is wrong."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cosim.base.errors import ScenarioError
from cosim.base.random_numbers import generator
from cosim.links.laws import Uniform
from cosim.links.semantics import Grid, PacketSemantics
from cosim.links.table import DrawnTable
from cosim.links.traces import read_trace


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def test_csv_takes_other_columns_comments_and_losses(tmp_path):
    text = "# measured\nseq,delay, t_send\n0,0.1,5.0\n1,,5.1\n\n# gap\n2,nan,5.3\n3, inf ,5.4\n"
    text += "4,2e-1,6\n"
    law = read_trace(write(tmp_path / "a.csv", text), repeat=True)
    assert law.t_send.tolist() == [5.0, 5.1, 5.3, 5.4, 6.0]
    assert np.flatnonzero(np.isfinite(law.delay)).tolist() == [0, 4]
    assert (law.minimum, law.maximum, law.loses_packets) == (0.1, 0.2, True)
    assert law.facts()["file"].endswith("a.csv")


def test_parquet_says_the_same_as_csv(tmp_path):
    t, d = [0.0, 0.5, 1.0], [0.25, None, 1.0]
    pq.write_table(pa.table({"delay": d, "t_send": t}), tmp_path / "a.parquet")
    csv = write(tmp_path / "a.csv", "t_send,delay\n0,0.25\n0.5,\n1,1.0\n")
    a, b = read_trace(tmp_path / "a.parquet"), read_trace(csv)
    assert a.facts()["sha256"] == b.facts()["sha256"]
    assert np.array_equal(a.delay, b.delay, equal_nan=True)


def test_integers_in_parquet_are_numbers(tmp_path):
    pq.write_table(pa.table({"t_send": [0, 1], "delay": [1, 2]}), tmp_path / "a.parquet")
    assert read_trace(tmp_path / "a.parquet").maximum == 2.0


@pytest.mark.parametrize(
    "text, message",
    [
        ("", r"a.csv:1: columns none; expected 't_send'"),
        ("t_send\n0\n", r"a.csv:1: columns t_send; expected 'delay'"),
        ("t_send,delay\n", r"a.csv: .*not empty"),
        ("t_send,delay\n0,0.1\n# x\n1,zero\n", r"a.csv:4: delay = 'zero' is not a number"),
        ("t_send,delay\n0,0.1\n,0.1\n", r"a.csv:3: t_send = '' is not a number"),
        ("t_send,delay\n0,0.1\n\n1\n", r"a.csv:4: 1 values; expected 2"),
        ("t_send,delay\n0,0.1\n\n0,0.2\n", r"a.csv:4: t_send = 0 s after 0 s"),
        ("t_send,delay\n0,0.1\n1,-0.2\n", r"a.csv:3: delay = -0.2 s"),
        ("t_send,delay\n0,\n1,\n", r"a.csv:3: every packet is lost"),
    ],
)
def test_a_csv_that_is_wrong_is_told_its_line(tmp_path, text, message):
    with pytest.raises(ScenarioError, match=message):
        read_trace(write(tmp_path / "a.csv", text))


def test_files_of_another_kind_are_refused(tmp_path):
    with pytest.raises(ScenarioError, match=r"none.csv: no such file"):
        read_trace(tmp_path / "none.csv")
    (tmp_path / "b.csv").write_bytes(b"t_send,delay\n\xff\xfe,\x00\n")
    with pytest.raises(ScenarioError, match=r"b.csv:\d+: this is not UTF-8 text"):
        read_trace(tmp_path / "b.csv")
    write(tmp_path / "b.parquet", "t_send,delay\n0,1\n")
    with pytest.raises(ScenarioError, match=r"b.parquet: this cannot be read as a trace"):
        read_trace(tmp_path / "b.parquet")
    pq.write_table(pa.table({"t": [0.0]}), tmp_path / "c.parquet")
    with pytest.raises(ScenarioError, match=r"c.parquet: columns t; expected 't_send'"):
        read_trace(tmp_path / "c.parquet")
    pq.write_table(pa.table({"t_send": ["now"], "delay": ["x"]}), tmp_path / "d.parquet")
    with pytest.raises(ScenarioError, match=r"d.parquet: this cannot be read as a trace"):
        read_trace(tmp_path / "d.parquet")
    pq.write_table(pa.table({"t_send": [0.0, 0.0], "delay": [0.1, 0.1]}), tmp_path / "e.parquet")
    with pytest.raises(ScenarioError, match=r"e.parquet:row 1: t_send = 0 s after 0 s"):
        read_trace(tmp_path / "e.parquet")


@pytest.mark.parametrize("lookup", ["time", "index"])
def test_a_law_written_down_as_a_trace_gives_the_same_table(tmp_path, lookup):
    """What was measured once can be run again: same delays, same rows."""
    grid, law, n = Grid(3, 2, 0.005), Uniform(0.05, 0.4, 0.03), 2000
    T = law.stream(grid.sending_period, generator(4, "x")).take(n)
    lines = [f"{float(k * grid.sending_period)!r},{t!r}" for k, t in enumerate(T.tolist())]
    path = write(tmp_path / "t.csv", "\n".join(["t_send,delay", *lines]))
    for order in ("last-arrival", "newest-stamp", "fifo"):
        drawn = DrawnTable("x", grid, law, PacketSemantics(order), 4)
        traced = DrawnTable("y", grid, read_trace(path, lookup=lookup), PacketSemantics(order), 0)
        assert traced.stream(n).rows(n).tolist() == drawn.stream(n).rows(n).tolist()


def test_a_run_longer_than_the_trace_is_refused(tmp_path):
    path = write(tmp_path / "t.csv", "t_send,delay\n0,0.1\n0.5,0.1\n")
    table = DrawnTable("x", Grid(1, 1, 0.005), read_trace(path), PacketSemantics("fifo"), 0)
    table.stream(200).rows(200)
    with pytest.raises(ScenarioError, match=r"end after 200 samples \(1 s\).*201.*repeat = true"):
        table.stream(201)
    again = DrawnTable("x", table.grid, read_trace(path, repeat=True), PacketSemantics("fifo"), 0)
    assert again.stream(10_000).rows(10_000)[-1] == 9_979
