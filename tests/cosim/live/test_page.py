"""The values that a live report offers, and the page that has them."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from cosim.engine.simulate import simulate
from cosim.live import bundle, digest
from cosim.live.page import rewrite_live, write_live_report
from cosim.loading.files import load
from cosim.record import Run
from cosim.reporting.run_report import write_report

CONFIG = Path(__file__).parents[3] / "configs" / "teleoperation.toml"
SETTINGS = ["run.stop=0.2"]


def embedded(page: Path, name: str) -> dict[str, Any]:
    """A document in a page."""
    text = page.read_text(encoding="utf-8")
    found = re.search(rf'id="{name}">(.*?)</script>', text, re.DOTALL)
    assert found is not None
    return dict(json.loads(found[1]))


def test_the_values_of_links_come_first_in_the_order_of_a_law(tmp_path: Path) -> None:
    scenario = load(CONFIG, SETTINGS)
    simulate(scenario, tmp_path / "run")
    run = Run.open(tmp_path / "run")
    page = write_live_report(run, bundle(scenario, SETTINGS), "cosim run x", digest(run))
    facts = embedded(page, "live-data")
    first = facts["keys"][:6]
    assert [key["label"] for key in first] == 2 * [
        "least delay", "greatest delay", "delay changes every"
    ]  # fmt: skip
    assert len(facts["links"]) == 2 and {key["group"] for key in first} == {*facts["links"]}
    assert facts["keys"][6]["unit"] == "N·m/rad"
    assert {pair["low"] for pair in facts["ordered"]} == {f"links.{i}.delay.low" for i in (0, 1)}
    text = page.read_text(encoding="utf-8")
    assert rewrite_live(run) == page and page.read_text(encoding="utf-8") == text
    write_report(run)
    assert rewrite_live(run) is None
