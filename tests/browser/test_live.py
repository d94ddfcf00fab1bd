"""A rehearsal in a browser while it runs, and its report when it has ended."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.browser.devtools import Browser
from tests.cli.command import CALL

pytestmark = [pytest.mark.slow, pytest.mark.browser]
ROOT = Path(__file__).resolve().parents[2]
TIP = """document.querySelector('[data-tip="master"]')?.dataset.at"""
HEAD = """parseFloat(/t = ([\\d.]+)/.exec(document.getElementById("status").textContent)?.[1])"""
NOW = """parseFloat(document.getElementById("now").textContent)"""


def test_the_arms_move_while_the_run_goes_on_and_its_report_follows(
    chromium: str, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    rehearse = [*CALL, "rehearse", "configs/teleoperation.toml", "--deploy", "zenoh"]
    options = ["--set", "run.stop='40 s'", "--no-twin", "--out", str(folder)]
    with Browser(chromium, tmp_path / "profile") as browser:
        run = subprocess.Popen([*rehearse, *options], cwd=ROOT, stdout=subprocess.DEVNULL)
        while not (folder / "rehearsal.json").is_file():
            assert run.poll() is None
        monitor = subprocess.Popen(
            [*CALL, "monitor", str(folder), "--web", "0"], stdout=subprocess.PIPE, text=True
        )
        assert monitor.stdout is not None
        try:
            browser.open(monitor.stdout.readline().split()[-1])
            browser.until(f"document.body?.dataset.ready === 'yes' && {NOW} > 0.5")
            assert "token" not in browser.ask("location.href")
            before, tip = browser.ask(NOW), browser.ask(TIP)
            browser.until(f"{NOW} > {before} + 0.5 && {TIP} !== '{tip}'")
            assert browser.ask("document.querySelectorAll('#panels canvas').length") == 5
            assert "active" in browser.ask("document.getElementById('status').textContent")
            browser.ask("document.getElementById('play').click()")  # pause
            held = browser.ask(NOW)
            browser.until(f"{HEAD} > {held} + 0.3")  # it goes on
            assert browser.ask(NOW) == held
            report = "location.pathname === '/report' && document.readyState === 'complete'"
            browser.until(report, seconds=120.0)
            assert browser.ask("document.querySelector('.verdict').textContent") != ""
            assert browser.console == []
        finally:
            for process in (monitor, run):
                process.kill()
                process.wait()
