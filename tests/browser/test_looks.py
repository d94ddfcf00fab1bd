"""How reports look: against kept pictures, in the dark, on paper, and by keyboard alone."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from cosim.reporting.run_report import write_report
from tests.browser.devtools import Browser
from tests.cli.command import Command
from tests.cli.conftest import cosim as cosim  # the command as a fixture
from tests.cosim.comparison.parts import CONFIG
from tests.cosim.study.studies import STUDY, written
from tests.system.runs import run as simulated
from tests.system.runs import teleoperation

pytestmark = [pytest.mark.slow, pytest.mark.browser]

#: Pictures of pages as they should look; ``COSIM_LOOKS=write`` writes them again.
KEPT = Path(__file__).parent / "looks"
#: The part of the pixels that may differ: versions of browsers are not all the same. Most of a page
#: is white, and all curves of the report together are 2 %.
SHARE = 0.005
#: Difference of a colour channel, of 255, below which a pixel is the same.
NEAR = 24
SIZE = (900, 700)
GRID = """values = [1, 10, 205]
[vary.start]
path = "components.plant.start.x"
values = [1, 2]
[stable]
rest = 1.0
"""
Picture = NDArray[np.int64]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    document = teleoperation(stop=2.0)
    panels = [{"y": [f"{side}.q[{i}]" for side in ("master", "slave")]} for i in (0, 1)]
    document["figures"] = {"positions": {"panels": panels}}
    found = simulated(document, tmp_path_factory.mktemp("looks") / "run", {"findings": []})
    return write_report(found)


@pytest.fixture
def browser(chromium: str, tmp_path: Path) -> Iterator[Browser]:
    with Browser(chromium, tmp_path / "profile") as found:
        found.size(*SIZE)
        yield found


def opened(browser: Browser, page: Path) -> None:
    browser.open(page.as_uri())
    browser.until('document.body && document.body.dataset.ready === "yes"')


def seen(browser: Browser) -> Picture:
    return np.asarray(Image.open(io.BytesIO(browser.picture())).convert("RGB")).astype(np.int64)


def differing(a: Picture, b: Picture) -> float:
    """The share of pixels that differ."""
    assert a.shape == b.shape
    return float((np.abs(a - b).max(axis=-1) > NEAR).mean())


def compare(browser: Browser, name: str, own: str = "") -> None:
    """Refuse a page that looks other than the kept picture.

    Texts of this machine become the same everywhere: the paths below the title, whose length
    decides how many lines they take and with it where all else stands, and those of `own`.
    """
    browser.ask("document.querySelector('header p').textContent = 'paths'")
    if own:
        browser.ask(f"document.querySelectorAll('{own}').forEach((e) => {{ e.textContent = '0' }})")
    now, path = browser.picture(), KEPT / f"{name}.png"
    if os.environ.get("COSIM_LOOKS") == "write":
        path.write_bytes(now)
    kept = np.asarray(Image.open(path).convert("RGB")).astype(np.int64)
    assert differing(seen(browser), kept) < SHARE, f"{name} no longer looks like {path}"
    assert not browser.console


def test_the_report_of_a_run_looks_as_it_did(browser: Browser, run: Path) -> None:
    opened(browser, run)
    compare(browser, "run", ".card b")  # a speed is one of them
    browser.ask("document.getElementById('panels').style.visibility = 'hidden'")
    kept = np.asarray(Image.open(KEPT / "run.png").convert("RGB")).astype(np.int64)
    assert differing(seen(browser), kept) > SHARE  # what the comparison is good for


def test_the_report_of_a_sweep_looks_as_it_did(
    browser: Browser, cosim: Command, tmp_path: Path
) -> None:
    done = cosim("sweep", written(tmp_path, STUDY + GRID), "--out", tmp_path / "out", "--jobs", "1")
    assert done.code == 0, done.err
    opened(browser, tmp_path / "out" / "report.html")
    browser.ask("document.getElementById('map').scrollIntoView()")
    compare(browser, "sweep")


def test_the_report_of_a_comparison_looks_as_it_did(
    browser: Browser, cosim: Command, tmp_path: Path
) -> None:
    done = cosim(
        "compare", CONFIG, "--controllers", "paper,pd", "--operators", "light", "--links", "paper",
        "--set", "run.stop=2 s", "--jobs", "1", "--out", tmp_path / "out",
    )  # fmt: skip
    assert done.code == 0, done.err
    opened(browser, tmp_path / "out" / "report.html")
    compare(browser, "compare")


def luminance(colour: str) -> float:
    """Relative luminance of ``rgb(…)`` (WCAG 2.2, definition in 1.4.3)."""
    c = np.array([int(x) for x in re.findall(r"\d+", colour)[:3]]) / 255
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_is_readable_on_its_background(browser: Browser, run: Path, scheme: str) -> None:
    """Contrast of at least 4.5 : 1, which WCAG 2.2 asks for."""
    browser.emulate(features={"prefers-color-scheme": scheme})
    opened(browser, run)
    ground = luminance(browser.ask("getComputedStyle(document.body).backgroundColor"))
    assert ground < 0.05 if scheme == "dark" else ground > 0.8
    names = ["h1", "header p", ".verdict", ".card b", ".card span", "td", "summary", "figcaption"]
    for name in names:
        said = browser.ask(f"getComputedStyle(document.querySelector('{name}')).color")
        light, dark = sorted((luminance(said), ground), reverse=True)
        assert (light + 0.05) / (dark + 0.05) > 4.5, (name, said)
    mean = float(seen(browser).mean())
    assert mean < 90 if scheme == "dark" else mean > 200


#: The darkest opaque pixel of the first diagram, as the mean of its channels.
DARKEST = """(() => {
  const c = document.querySelector("canvas");
  const p = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
  let least = 255;
  for (let i = 0; i < p.length; i += 4)
    if (p[i + 3] === 255) least = Math.min(least, (p[i] + p[i + 1] + p[i + 2]) / 3);
  return least;
})()"""


def test_it_prints(browser: Browser, run: Path) -> None:
    """Curves are on paper, controls are not, and dark mode does not make paper black."""
    browser.emulate(features={"prefers-color-scheme": "dark"})
    opened(browser, run)
    assert browser.ask(DARKEST) > 40
    browser.emulate(media="print", features={"prefers-color-scheme": "dark"})
    browser.until(f"{DARKEST} < 40")  # axes are black on paper
    shown = "getComputedStyle(document.getElementById('bar')).display"
    assert browser.ask(shown) == "none"
    assert luminance(browser.ask("getComputedStyle(document.body).backgroundColor")) > 0.8
    pdf = browser.pdf()
    assert pdf.startswith(b"%PDF") and len(re.findall(rb"/Type\s*/Page\b", pdf)) >= 2
    browser.emulate(media="screen", features={})
    assert browser.ask(shown) != "none"


#: What a printed page of 700 pixels has: its width, that of canvases, what is open, and the time.
PAPER = """(() => {
  dispatchEvent(new Event("beforeprint"));
  const wide = (names) => Math.max(...[...document.querySelectorAll(names)].map(
    (one) => one.getBoundingClientRect().right));
  const seen = [wide("canvas"), wide("td"), document.querySelectorAll("details:not([open])").length,
    document.getElementById("when").textContent];
  dispatchEvent(new Event("afterprint"));
  return [...seen, document.getElementById("now").textContent];
})()"""


def test_paper_has_whole_diagrams_and_tables_at_the_end_of_the_run(
    browser: Browser, run: Path
) -> None:
    opened(browser, run)
    closed = browser.ask("document.querySelectorAll('details:not([open])').length")
    browser.emulate(media="print")
    browser.size(700, 900)
    canvas, cell, folded, when, now = browser.ask(PAPER)
    assert canvas <= 700 and cell <= 700
    assert (folded, when, now) == (1, "at 2.000 s", "0.000 s")  # the list of signals is not printed
    assert browser.ask("document.querySelectorAll('details:not([open])').length") == closed


def test_it_works_by_keyboard(browser: Browser, run: Path) -> None:
    opened(browser, run)
    names = []
    for _ in range(60):
        browser.key("Tab")
        what = "document.activeElement.id || document.activeElement.tagName"
        names.append(browser.ask(what))
        if names[-1] == "time":
            break
    assert names[-1] == "time" and "play" in names
    outline = "getComputedStyle(document.activeElement).outlineStyle"
    assert browser.ask(outline) == "solid"
    arm = "document.querySelector('[data-tip=\"master\"]').dataset.at"
    before = browser.ask(arm)
    for _ in range(12):
        browser.key("ArrowRight")
    assert float(browser.ask("document.getElementById('now').textContent").split()[0]) > 0
    assert browser.ask(arm) != before
    closed = "document.querySelectorAll('details:not([open])').length"
    count = browser.ask(closed)
    for _ in range(400):
        browser.key("Tab")
        if browser.ask("document.activeElement.tagName") == "SUMMARY" and browser.ask(
            "!document.activeElement.parentElement.open"
        ):
            break
    browser.key("Enter")
    assert browser.ask(closed) == count - 1
    assert not browser.console
