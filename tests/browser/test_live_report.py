"""Reports that run their scenario again: values move, and the run is that of the command."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import pytest

from cosim.live import digest
from cosim.record import Run
from tests.browser import live_page
from tests.browser.devtools import Browser
from tests.browser.live_page import CONFIG, MOST
from tests.cli.command import Command
from tests.cli.conftest import cosim as cosim  # the command as a fixture

pytestmark = [pytest.mark.slow, pytest.mark.browser]
HIGH = "document.querySelector('[data-key=\"links.0.delay.high\"] [type=range]')"
#: Moves a slider as a hand does.
MOVE = """(() => {{ const one = {}; one.value = "{}";
  one.dispatchEvent(new Event("input", {{bubbles: true}})); }})()"""
DONE = "document.getElementById('live-said').textContent.includes('computed in')"
IDLE = "!document.getElementById('live').hasAttribute('aria-busy')"
SEEN = """JSON.stringify({
  digest: document.getElementById("live-digest").textContent,
  command: document.getElementById("live-command").textContent,
  said: document.getElementById("live-said").textContent,
  verdict: document.querySelector("header .verdict").textContent,
  required: [...document.querySelectorAll("#requirements td:last-child")].map((x) => x.textContent),
  results: [...document.querySelectorAll("#results td")].map((x) => x.textContent),
  cards: [...document.querySelectorAll(".cards .card")].map((x) => x.textContent),
  table: document.querySelector("#panels table.hidden").textContent,
  tip: document.querySelector("[data-tip=slave]").dataset.at,
  note: document.getElementById("live-note").hidden,
})"""


def opened(browser: Browser, page: Path) -> dict[str, Any]:
    return live_page.opened(browser, page, SEEN, "document.body?.dataset.ready === 'yes'")


def seen(browser: Browser) -> dict[str, Any]:
    return live_page.seen(browser, SEEN)


def run(cosim: Command, words: list[str], out: Path) -> Run:
    done = cosim(*words, "--out", out, "--quiet")
    assert done.code == 0, done.err
    return Run.open(out)


@pytest.mark.parametrize("setting", [("high", "0.6"), ("low", "1.1")])
def test_a_moved_delay_gives_the_run_of_the_command_bit_for_bit(
    setting: tuple[str, str], browser: Browser, cosim: Command, tmp_path: Path
) -> None:
    recorded = run(cosim, ["run", str(CONFIG), "--live", "--set", "run.stop=20"], tmp_path / "a")
    page = recorded.path.parent / "report.html"
    assert page.stat().st_size < MOST
    before = opened(browser, page)
    assert before["digest"] == digest(recorded) and before["note"]
    browser.ask("document.getElementById('time').value = '5'")
    browser.ask("document.getElementById('time').dispatchEvent(new Event('input'))")
    still = browser.ask("document.querySelector('[data-tip=slave]').dataset.at")
    key, value = setting
    browser.ask(MOVE.format(HIGH.replace("high", key), value))
    browser.until(DONE)
    after = seen(browser)
    assert after["digest"] != before["digest"] and not after["note"]
    assert f"--set links.0.delay.{key}={value}" in after["command"]
    again = run(cosim, shlex.split(after["command"])[1:], tmp_path / "b")
    assert after["digest"] == digest(again)
    facts = again.metadata["requirements"]
    assert after["required"] == [r["text"] for r in facts.values()]
    assert after["tip"] != still and after["table"] != before["table"]
    written = opened(browser, again.path.parent / "report.html")
    for part in ("verdict", "required", "results"):
        assert written[part] == after[part]
    assert written["cards"][:-1] == after["cards"][:-1]  # the last one is the speed
    assert not browser.console


def test_masses_of_a_preset_and_losses_are_set_as_a_whole(
    browser: Browser, cosim: Command, tmp_path: Path
) -> None:
    newest = [w for i in (0, 1) for w in ("--set", f"links.{i}.semantics='newest-stamp'")]
    words = ["run", str(CONFIG), "--live", "--set", "run.stop=5", *newest]
    recorded = run(cosim, words, tmp_path / "a")
    before = opened(browser, recorded.path.parent / "report.html")
    for key, value in (
        ("components.slave.parameters.theta.0", "5.5"),
        ("components.slave.parameters.theta.1", "1.5"),
        ("links.0.loss.p", "0.05"),
    ):
        one = f"""document.querySelector('[data-key="{key}"] input')"""
        browser.ask(MOVE.format(one, value))
    browser.until(f"{DONE} && {IDLE}")
    after = seen(browser)
    assert "'components.slave.parameters.theta=[5.5, 1.5, 0.97]'" in after["command"]
    assert after["command"].count(".loss=") == 2  # links move together
    again = run(cosim, shlex.split(after["command"])[1:], tmp_path / "b")
    assert before["digest"] != after["digest"] == digest(again)
    assert not browser.console


def test_the_newest_values_win_and_reset_returns(
    browser: Browser, cosim: Command, tmp_path: Path
) -> None:
    recorded = run(cosim, ["run", str(CONFIG), "--live", "--set", "run.stop=10"], tmp_path / "a")
    before = opened(browser, recorded.path.parent / "report.html")
    for value in ("0.5", "0.9", "1.5", "0.7", "0.8"):
        browser.ask(MOVE.format(HIGH, value))
    browser.until(f"{DONE} && {IDLE}")
    after = seen(browser)
    again = run(cosim, shlex.split(after["command"])[1:], tmp_path / "b")
    assert "links.0.delay.high=0.8" in after["command"] and after["digest"] == digest(again)
    browser.ask("document.getElementById('live-reset').click()")
    assert seen(browser) == before
    assert not browser.console


def test_a_value_by_the_keyboard(browser: Browser, cosim: Command, tmp_path: Path) -> None:
    recorded = run(cosim, ["run", str(CONFIG), "--live", "--set", "run.stop=5"], tmp_path / "a")
    before = opened(browser, recorded.path.parent / "report.html")
    browser.ask(f"{HIGH}.focus()")
    browser.key("ArrowRight")
    browser.until(DONE)
    assert seen(browser)["digest"] != before["digest"]
    assert browser.ask(f"{HIGH}.labels.length") == 1
    field = f"{HIGH}.parentElement.querySelector('[type=number]')"
    browser.ask(f"{field}.value = '-1', {field}.dispatchEvent(new Event('change'))")
    assert "links.0.delay.high: found -1, expected a number from" in seen(browser)["said"]
    browser.ask("document.getElementById('live-reset').click()")
    assert seen(browser)["said"] == "as recorded"


def test_links_that_move_together_stay_each_in_its_range(
    browser: Browser, cosim: Command, tmp_path: Path
) -> None:
    """Ranges of links may differ; what is beyond them is not asked for."""
    settings = ["--set", "run.stop=2", "--set", "links.1.delay={law='constant', delay='0.5 s'}",
                "--set", "links.0.delay={law='constant', delay='0.5 s'}"]  # fmt: skip
    recorded = run(cosim, ["run", str(CONFIG), "--live", *settings], tmp_path / "a")
    opened(browser, recorded.path.parent / "report.html")
    one = HIGH.replace("delay.high", "delay.delay")
    browser.ask(f"document.querySelector('[data-key] [type=range]').max = 1e9, {one}.max = 1e9")
    browser.ask(MOVE.format(one, "1e6"))
    browser.until(f"{DONE} && {IDLE}")
    after = seen(browser)
    again = run(cosim, shlex.split(after["command"])[1:], tmp_path / "b")
    assert "1000000" not in after["command"] and after["digest"] == digest(again)


@pytest.mark.parametrize("missing", ["WebAssembly", "Worker"])
def test_without_the_means_the_report_is_as_it_was(
    missing: str, browser: Browser, cosim: Command, tmp_path: Path
) -> None:
    recorded = run(cosim, ["run", str(CONFIG), "--live", "--set", "run.stop=2"], tmp_path / "a")
    page = recorded.path.parent / "report.html"
    text = page.read_text(encoding="utf-8")
    script = f"<script>delete window.{missing};</script>"
    page.write_text(text.replace("<style>", script + "<style>", 1), encoding="utf-8")
    browser.open("about:blank")
    browser.open(page.as_uri())
    browser.until("document.body?.dataset.ready === 'yes'")
    assert browser.ask("document.getElementById('live').hidden") is True
    assert browser.ask("document.querySelectorAll('#panels canvas').length") == 2
