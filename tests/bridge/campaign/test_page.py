"""The report of a campaign: its word, and the runs that were not as expected first."""

from __future__ import annotations

import re
from pathlib import Path

from bridge.campaign.judgement import JudgedRun
from bridge.campaign.page import (
    campaign_as_data,
    many_as_data,
    write_campaign,
    write_many,
)
from bridge.records.node_lives import Life


def judged(*failures: str) -> JudgedRun:
    return JudgedRun(
        "drop", {Life("slave", 1): "fault (peer)"}, {"crc": 3}, 3, 0, 0.5, True, "0", failures
    )


def test_a_run_that_was_not_as_expected_fails_the_campaign(tmp_path: Path) -> None:
    (tmp_path / "drop").mkdir()
    (tmp_path / "drop" / "report.html").touch()
    runs = [("drop", judged()), ("drop-2", judged("a torque of 2 times its limit"))]
    page = write_campaign(runs, "Faults", tmp_path, "cosim campaign x.toml").read_text("utf-8")
    assert 'class="verdict failed"' in page
    assert "1 of 2 runs were not as expected: drop-2" in page
    assert '<a href="drop/report.html">drop</a>' in page and "drop-2/report.html" not in page
    assert "NO: a torque of 2 times its limit" in page and "cosim campaign x.toml" in page
    assert "<span>Frames corrupted</span><b>6</b>" in page
    assert 'class="verdict passed"' in write_campaign(
        runs[:1], "Faults", tmp_path, ""
    ).read_text("utf-8")  # fmt: skip
    assert 'class="verdict failed"' in write_campaign([], "", tmp_path, "").read_text("utf-8")
    found = campaign_as_data(runs, tmp_path)["runs"]
    assert [(x["name"], x["passed"], x["corrupted"]) for x in found] == [
        ("drop", True, 3), ("drop-2", False, 3),
    ]  # fmt: skip


def record(run: str, verdict: str, reason: str = "") -> dict[str, object]:
    return {"run": run, "verdict": verdict, "faults": "drop", "reason": reason, "s": 20.0}


def word(path: Path) -> str:
    (found,) = re.findall(r'class="verdict (\w+)"', path.read_text("utf-8"))
    return str(found)


def test_many_runs_have_one_word(tmp_path: Path) -> None:
    (tmp_path / "runs" / "00001").mkdir(parents=True)
    kinds = [["fault", "injected"], ["drop", "4"]]
    good, slow = record("00000", "passed"), record("00002", "inconclusive", "too slow")
    bad = record("00001", "failed", "replay differs")
    path = write_many([good, bad, slow], kinds, "Soak", tmp_path, "cosim soak")
    page = path.read_text("utf-8")
    assert word(path) == "failed" and "1 of 3 runs were not as expected: 00001" in page
    assert '<a href="runs/00001/">00001</a>' in page and "runs/00000" not in page
    assert page.index("00001/") < page.index("<td>00000</td>")  # what failed stands first
    assert word(write_many([good, slow], kinds, "", tmp_path, "")) == "passed"
    assert [r["verdict"] for r in many_as_data([good, bad], tmp_path)["runs"]] == [
        "passed", "failed",
    ]  # fmt: skip
    assert word(write_many([slow], kinds, "", tmp_path, "")) == "inconclusive"
