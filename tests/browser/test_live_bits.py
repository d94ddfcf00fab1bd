"""Chromium computes scenarios with the bits of the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cosim.engine.simulate import simulate
from cosim.live import bundle, digest
from cosim.live.bundle import script
from cosim.loading.files import load
from cosim.record import Run
from tests.browser.devtools import Browser

pytestmark = [pytest.mark.slow, pytest.mark.browser]
CONFIGS = Path(__file__).parents[2] / "configs"
COMPUTE = """
(async () => {
  const live = await Live.open(JSON.parse(document.getElementById("bundle").textContent));
  return (await live.compute({})).digest;
})()
"""


@pytest.mark.parametrize("name", ["teleoperation", "network", "six_axis"])
def test_the_digest_in_chromium_is_that_of_the_command_line(
    name: str, chromium: str, tmp_path: Path
) -> None:
    scenario = load(CONFIGS / f"{name}.toml")
    data = json.dumps(bundle(scenario)).replace("<", "\\u003c")
    page, profile = tmp_path / "page.html", tmp_path / "profile"
    profile.mkdir()
    page.write_text(
        f'<!DOCTYPE html><meta charset="utf-8"><script>{script()}</script>'
        f'<script type="application/json" id="bundle">{data}</script><p id="end"></p>',
        encoding="utf-8",
    )
    simulate(scenario, tmp_path / "run")
    with Browser(chromium, profile) as browser:
        browser.open(page.as_uri())
        browser.until('document.getElementById("end") !== null')
        assert browser.ask(COMPUTE) == digest(Run.open(tmp_path / "run"))
