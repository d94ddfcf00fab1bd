"""Reports of sweeps and comparisons in a real browser: what is chosen is what is shown."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from tests.cli.command import Command
from tests.cli.conftest import cosim as cosim  # the command as a fixture
from tests.cosim.comparison.parts import CONFIG
from tests.cosim.study.studies import STUDY, written

pytestmark = [pytest.mark.slow, pytest.mark.browser]
GRID = """values = [1, 10, 205]
[vary.start]
path = "components.plant.start.x"
values = [1, 2]
[stable]
rest = 1.0
"""
MAP = """
const map = document.getElementById("map"), box = map.getBoundingClientRect();
const at = (x, y) => map.dispatchEvent(new MouseEvent("click", {bubbles: true,
  clientX: box.left + 74 + x * (box.width - 170), clientY: box.top + 14 + y * 370}));
const listed = () => document.getElementById("count").textContent;
const first = () => document.querySelectorAll("#rows tr")[1].textContent;
const seen = {all: listed()};
at(0.9, 0.1); // the greatest gain and start
const command = document.getElementById("one").textContent;
Object.assign(seen, {picked: listed(), one: first(), command});
document.getElementById("all").click();
const [least, greatest] = document.querySelectorAll("#limits input");
least.value = "5";
least.dispatchEvent(new Event("change"));
Object.assign(seen, {limited: listed()});
[...document.querySelectorAll("#rows th button")][0].click();
[...document.querySelectorAll("#rows th button")][0].click(); // falling
Object.assign(seen, {falling: first()});
const g = map.getContext("2d").getImageData(0, 0, map.width, map.height).data;
seen.colours = new Set(new Uint32Array(g.buffer)).size;
tell(seen);
"""
LAID = """
const legend = () => document.querySelectorAll("#overlay .u-series").length - 1; // less the time
const minis = [...document.querySelectorAll("button[data-signals]")];
const seen = {minis: minis.length, before: legend()};
minis.find((b) => b.getAttribute("aria-pressed") === "false").click();
seen.more = legend();
for (const b of minis) if (b.getAttribute("aria-pressed") === "true") b.click();
seen.none = document.querySelectorAll("#overlay canvas").length;
tell(seen);
"""


def test_a_cell_of_the_map_is_a_run_and_its_command(
    tmp_path: Path, cosim: Command, ask: Any
) -> None:
    done = cosim("sweep", written(tmp_path, STUDY + GRID), "--out", tmp_path / "out", "--jobs", "1")
    assert done.code == 0, done.err
    seen = ask(tmp_path / "out" / "report.html", MAP)
    records = pq.read_table(tmp_path / "out" / "table.parquet").to_pylist()
    assert seen["all"] == "6 of 6 runs" and seen["picked"] == "1 of 6 runs"
    wanted = next(r for r in records if r["gain"] == 205 and r["start"] == 2)
    assert "not stable" in seen["one"] and "205" in seen["one"]
    words = shlex.split(seen["command"])
    assert words[:2] == ["cosim", "run"] and words[2].endswith("loop.toml")
    assert words[4::2] == json.loads(wanted["settings"]) and set(words[3::2]) == {"--set"}
    assert seen["limited"] == "4 of 6 runs"
    assert "205" in seen["falling"]
    assert seen["colours"] > 6


def test_small_pictures_are_laid_over_each_other(tmp_path: Path, cosim: Command, ask: Any) -> None:
    done = cosim(
        "compare", CONFIG, "--controllers", "paper,pd", "--operators", "light,tight", "--links",
        "paper", "--set", "run.stop=2 s", "--jobs", "1", "--out", tmp_path / "out",
    )  # fmt: skip
    assert done.code == 0, done.err
    seen = ask(tmp_path / "out" / "report.html", LAID)
    assert (seen["minis"], seen["before"], seen["more"], seen["none"]) == (4, 4, 6, 0)
