"""Ages of what the receiver of a link held, in pieces, against whole columns."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.links import storage
from cosim.links.storage import TableWriter
from cosim.measure.link_ages import AgeSummary, link_ages, summarize_ages

FACTS = {"name": "a", "sender_period": 2, "receiver_period": 5, "h": 0.001}


def summary(folder: Path, sent: list[int], group: int) -> tuple[Path, AgeSummary | None]:
    """The summary of a table that is read in groups of so many rows."""
    path = folder / "a.parquet"
    with TableWriter(path, FACTS) as writer:
        writer.write(np.array(sent, np.int32))
    with pytest.MonkeyPatch.context() as patch:
        rows = np.concatenate([np.empty(0, np.int32), *storage.table_groups(path)])
        patch.setattr(
            "cosim.measure.link_ages.table_groups",
            lambda _: (rows[k : k + group] for k in range(0, len(rows), group)),
        )
        return path, summarize_ages(path)


def test_a_sample_has_its_delay_when_it_is_first_held(tmp_path: Path) -> None:
    _, found = summary(tmp_path, [-1, -1, 0, 0, 4, 4, 4, 9], 3)
    assert found is not None
    ages = [10, 15, 12, 17, 22, 17]  # ticks: 5 k - 2 sent
    assert found.values.tolist() == pytest.approx([0.01, 0.012, 0.015, 0.017, 0.022])
    assert found.counts.tolist() == [1, 1, 1, 2, 1]
    assert found.mean == pytest.approx(sum(ages) / 6000)
    assert found.delays == pytest.approx((0.01, 0.017))
    assert found.lost == pytest.approx(1 - 3 / 10)
    assert summary(tmp_path, [-1], 1)[1] is None


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 400), st.integers(1, 50), st.integers(0, 99))
def test_ages_are_those_of_numpy(count: int, group: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    newest = 5 * np.arange(count) // 2
    sent = np.maximum(newest - random.integers(0, 40, count), -1)
    sent[0] = 0
    with TemporaryDirectory() as folder:
        path, found = summary(Path(folder), sent.tolist(), group)
        whole = link_ages(path)
    assert found is not None
    held = whole.age[np.isfinite(whole.age)]
    new = np.flatnonzero((sent >= 0) & (np.diff(sent, prepend=-1) != 0))
    assert found.mean == held.mean()
    assert found.delays == (whole.age[new].min(), whole.age[new].max())
    assert found.lost == 1.0 - np.unique(sent[sent >= 0]).size / (int(sent.max()) + 1)
    assert np.repeat(found.values, found.counts).tolist() == sorted(held)
    for q in (0, 3, 50, 95, 99, 100):
        assert found.percentile(q) == np.percentile(held, q)
