"""Comparisons that run their controllers again, with the bits of the command."""

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
WORDS = ["--controllers", "paper,pd,p+d", "--operators", "free,tight", "--links", "paper,constant",
         "--set", "run.stop=20", "--live", "--keep"]  # fmt: skip
#: Moves a value as a hand does.
MOVE = """(() => {{ const one = document.querySelector('[data-path="{}"] [type=range]');
  one.value = "{}"; one.dispatchEvent(new Event("input", {{bubbles: true}})); }})()"""
CHOOSE = """(() => {{ const one = document.getElementById("live-{}");
  one.value = "{}"; one.dispatchEvent(new Event("change", {{bubbles: true}})); }})()"""
DONE = """document.getElementById('live-said').textContent.includes('computed in')
  && !document.getElementById('live').hasAttribute('aria-busy')"""
SEEN = """JSON.stringify({
  command: document.getElementById("live-command").textContent,
  said: document.getElementById("live-said").textContent,
  digests: Object.fromEntries([...document.querySelectorAll("#live-digests dd")].map(
    (x) => [x.dataset.controller, x.textContent])),
  rows: [...document.querySelectorAll("#live-table tbody tr")].map(
    (row) => [...row.cells].map((x) => x.textContent)),
})"""


def opened(browser: Browser, folder: Path) -> dict[str, Any]:
    return live_page.opened(browser, folder / "report.html", SEEN)


def seen(browser: Browser) -> dict[str, Any]:
    return live_page.seen(browser, SEEN)


def compared(cosim: Command, words: list[str], out: Path) -> Path:
    done = cosim(*words, "--keep", "--out", out, "--quiet")
    assert done.code == 0, done.err
    return out


def kept(folder: Path, link: str, operator: str) -> dict[str, str]:
    """The digests of the runs that a comparison kept, by controller."""
    runs = folder / "runs" / link / operator
    return {x.name.rpartition("-seed")[0]: digest(Run.open(x)) for x in runs.iterdir()}


def test_moved_links_give_the_runs_of_the_command_bit_for_bit(
    browser: Browser, cosim: Command, tmp_path: Path
) -> None:
    recorded = compared(cosim, ["compare", str(CONFIG), *WORDS], tmp_path / "a")
    assert (recorded / "report.html").stat().st_size < MOST
    before = opened(browser, recorded)
    assert before["digests"] == kept(recorded, "paper", "free")
    browser.ask(CHOOSE.format("operator", "tight"))
    assert seen(browser)["digests"] == kept(recorded, "paper", "tight")
    for value in ("1.5", "0.9", "1.8"):  # the newest one wins
        browser.ask(MOVE.format("delay.high", value))
    browser.until(DONE)
    after = seen(browser)
    assert "--set links.paper.delay.high=1.8" in after["command"]
    again = compared(cosim, shlex.split(after["command"])[1:], tmp_path / "b")
    assert after["digests"] == kept(again, "paper", "tight")
    assert len({*after["digests"].values(), *before["digests"].values()}) == 6
    opened(browser, again)
    browser.ask(CHOOSE.format("operator", "tight"))
    assert seen(browser)["rows"] == after["rows"]  # Python judged these
    assert not browser.console


def test_a_controller_less_another_link_and_reset(
    browser: Browser, cosim: Command, tmp_path: Path
) -> None:
    recorded = compared(cosim, ["compare", str(CONFIG), *WORDS], tmp_path / "a")
    before = opened(browser, recorded)
    browser.ask(CHOOSE.format("law", "constant"))
    browser.ask("document.querySelector('[type=checkbox][data-controller=pd]').click()")
    browser.ask(MOVE.format("delay.delay", "0.25"))
    browser.until(DONE)
    after = seen(browser)
    again = compared(cosim, shlex.split(after["command"])[1:], tmp_path / "b")
    native = kept(again, "constant", "free")
    assert native.pop("pd") and after["digests"] == native
    browser.ask("document.querySelector('[type=checkbox][data-controller=pd]').click()")
    browser.until(DONE)
    assert seen(browser)["digests"] == kept(again, "constant", "free")
    browser.ask(CHOOSE.format("law", "paper"))
    browser.ask("document.getElementById('live-reset').click()")
    assert seen(browser) == before | {"said": "as recorded"}
    assert not browser.console
