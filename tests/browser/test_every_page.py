"""Every kind of page as a person sees it: on a desktop, a phone, in the dark, and on paper.

The pictures are left in the folder of the run of tests (``--basetemp``), ``looks/KIND-HOW.png``.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.campaign.page import write_campaign, write_many
from bridge.cli.replay import recorded_system
from bridge.ping.page import PingNotes, write_ping_page
from bridge.records.records import Lagged
from bridge.results.outcome import reopen
from bridge.results.page import describe
from cosim.base.copies import replace
from cosim.certify.page import Mark
from cosim.certify.page import write as write_region
from cosim.certify.region import Region
from tests.bridge.campaign.test_page import judged, record
from tests.bridge.ping.test_watch import FakePath, evaluate
from tests.browser.devtools import Browser
from tests.cosim.comparison.parts import CONFIG
from tests.cosim.study.studies import STUDY, written

pytestmark = [pytest.mark.slow, pytest.mark.browser]

KINDS = (
    "run", "live", "rehearsal", "late-rehearsal", "comparison", "live-comparison", "diff", "sweep",
    "campaign", "soak", "ping", "reproduction", "region", "falsified",
)  # fmt: skip
STIFF = (
    "--set", "components.master.parameters.k_p=100",
    "--set", "components.master.parameters.k_d=10",
    "--set", 'require={near={always="abs(master.q) < 20 rad"}}',
)  # fmt: skip
GRID = """values = [1, 5, 10, 50, 100, 205]
[vary.start]
path = "components.plant.start.x"
values = [1, 2, 3]
[stable]
rest = 1.0
[figures.time]
kind = "map"
x = "gain"
y = "start"
z = "rest.settle_s"
"""
#: The width and height of a window, pixels, and the CSS features, by the name of a look.
WINDOWS: Mapping[str, tuple[int, int, dict[str, str]]] = {
    "desktop": (1280, 1000, {}),
    "phone": (390, 844, {}),
    "dark": (1280, 1000, {"prefers-color-scheme": "dark"}),
}
#: CSS pixels between the margins of a sheet of paper (letter, margins of 14 mm).
SHEET = 710
#: What a page shows: its width, parts that are wider than it, words on two lines, empty parts.
SEEN = """JSON.stringify((() => {
  const shown = (e) => e.getClientRects().length > 0;
  const scrolls = (e) => e.closest(".scroll, .copy, #signals, pre");
  const width = document.documentElement.clientWidth;
  const kind = (e) => `${e.tagName} ${e.className?.baseVal ?? e.className}`;
  const name = (e) => `${kind(e)} ${e.textContent.slice(0, 40)}`;
  const box = (e) => e.getBoundingClientRect();
  const wide = [...document.querySelectorAll("main *")].filter((e) => shown(e) && !scrolls(e)
    && !e.closest("svg, .hidden, .u-wrap") && box(e).right > width + 1).map(name);
  const cut = [...document.querySelectorAll(".scroll, pre")].filter((e) => shown(e)
    && e.scrollWidth > e.clientWidth + 1).map(name);
  const broken = [];
  const texts = document.createTreeWalker(document.querySelector("main"), NodeFilter.SHOW_TEXT);
  for (let text; (text = texts.nextNode()); ) {
    const skipped = "svg, code, pre, .hidden, option, script";
    if (!text.parentElement || text.parentElement.closest(skipped)) continue;
    for (const word of text.data.matchAll(/(?<![\\w./=-])[A-Za-z]{2,14}(?![\\w./=-])/g)) {
      const range = document.createRange();
      range.setStart(text, word.index);
      range.setEnd(text, word.index + word[0].length);
      const lines = new Set([...range.getClientRects()].map((r) => Math.round(r.top)));
      if (lines.size > 1) broken.push(word[0]);
    }
  }
  const pixels = (c) => {
    const found = c.getContext("2d").getImageData(0, 0, c.width, c.height);
    return new Set(new Uint32Array(found.data.buffer)).size;
  };
  const empty = [...document.querySelectorAll("canvas")].filter((c) => shown(c)
    && (!c.width || pixels(c) < 3)).map(kind);
  const bare = [...document.querySelectorAll("h2, h3")].filter((h) => shown(h)
    && (!h.nextElementSibling || ["H2", "H3"].includes(h.nextElementSibling.tagName)
        || box(h.nextElementSibling).height < 5)).map(name);
  const tables = [...document.querySelectorAll("table")].filter((t) => shown(t)
    && t.rows.length < 2 && !t.closest(".uplot")).map(name);
  return {width: document.documentElement.scrollWidth, wide, cut, broken, empty, bare, tables};
})())"""


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A page of each kind."""
    patch, folder = pytest.MonkeyPatch(), tmp_path_factory.mktemp("pages")
    patch.chdir(folder)

    def made(*words: str | Path, codes: tuple[int, ...] = (0,)) -> None:
        code = called(patch, *words)
        assert code in codes, words

    made("run", CONFIG, "--set", "run.stop=20", "--no-live", "--out", "run")
    made("run", CONFIG, "--set", "run.stop=20", "--out", "live")
    made("run", CONFIG, "--set", "run.stop=10", "--seed", "3", "--out", "short")
    made("rehearse", CONFIG, "--deploy", "can", "-i", "cosim", "--clock", "simulated", "--set",
         "run.stop=4", "--out", "rehearsal")  # fmt: skip
    made("compare", CONFIG, "--controllers", "paper,pd,p+d,free", "--operators", "light,tight",
         "--links", "paper,constant", "--set", "run.stop=20", "--out", "comparison")  # fmt: skip
    made("compare", CONFIG, "--controllers", "paper,pd,p+d", "--operators", "light", "--links",
         "paper,wifi5", "--set", "run.stop=20", "--live", "--out", "live-comparison")  # fmt: skip
    made("diff", "run", "short", "--html", "diff.html", codes=(1,))
    made("sweep", written(folder, STUDY + GRID), "--out", "sweep", "--jobs", "1")
    made("reproduce", "--only", "thm2", "--out", "reproduction", codes=(0, 1))
    made("falsify", CONFIG, *STIFF, "--set", "run.stop=3", "--jobs", "1", "--quiet", "--out",
         "falsified", codes=(1,))  # fmt: skip
    for name in ("campaign", "soak", "ping"):
        (folder / name).mkdir()
    repeat = "cosim campaign configs/faults/campaign.toml"
    runs = [("drop", judged()), ("kill", judged("a torque of 2 times its limit"))]
    write_campaign(runs, "Faults of teleoperation", folder / "campaign", repeat)
    records = [
        record("00000", "passed"), record("00001", "failed", "replay differs: master.q[0]"),
        record("00002", "inconclusive", "bus left was up to 1.50 s behind the wall clock"),
    ]  # fmt: skip
    kinds = [["fault", "injected", "seen", "idle", "unseen", "seen by"],
             ["drop", "40", "38", "2", "0", "lost"], ["all", "40", "38", "2", "0", ""]]  # fmt: skip
    write_many(records, kinds, "Soak test of teleoperation", folder / "soak", "cosim soak x.toml")
    path = FakePath()
    path.ask(100)
    path.ask(50, lost=True)
    path.ask(100, delay=8e-3)
    notes = PingNotes({"there": {"trace": 'delay = { law = "constant" }'}}, "cosim ping udp host")
    write_ping_page(folder / "ping" / "report.html", evaluate(path.record), notes)
    found = {kind: folder / kind / "report.html" for kind in KINDS}
    found["region"] = certified(folder / "region")
    found["diff"] = folder / "diff.html"
    found["late-rehearsal"] = late(folder / "rehearsal", folder / "late-rehearsal")
    patch.undo()
    return found


def called(patch: pytest.MonkeyPatch, *words: str | Path) -> int:
    """The exit code of a command."""

    from cosim.cli.commands import command

    patch.setattr(sys, "argv", ["cosim", *map(str, words)])
    try:
        command()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def certified(folder: Path) -> Path:
    """The map of what is certified, broken by a constant delay or an adversary, and unknown."""
    n = 16
    highest = tuple(6 if i < 3 else 8 if i < 9 else -1 for i in range(n))
    grown = frozenset({(0, 9), (4, 11)})
    region = Region(tuple(range(n)), 0.1, highest, tuple(i > 12 for i in range(n)), grown)
    marks = [Mark("×", "the failure of cosim falsify, of a large motion", 0.1, 0.5),
             Mark("○", "the delays of the links", 0.3, 1.2)]  # fmt: skip
    folder.mkdir()
    return write_region(region, "Bilateral teleoperation with time-varying delay", marks, folder)


def late(rehearsal: Path, to: Path) -> Path:
    """The page of the same rehearsal, had a bus stood still."""

    shutil.copytree(rehearsal, to)
    system = recorded_system(to)
    lag = Lagged(t=1.2, bus="right", end=2.9, late=1.51)
    return describe(system, replace(reopen(system, to), notes=(lag,)))


@pytest.fixture(scope="module")
def looks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the pictures."""
    folder = tmp_path_factory.getbasetemp() / "looks"
    folder.mkdir(exist_ok=True)
    return folder


def opened(browser: Browser, page: Path) -> None:
    browser.open("about:blank")
    browser.open(page.as_uri())
    browser.until('document.body && document.readyState === "complete"')
    browser.until('document.body.dataset.ready === "yes" || !document.getElementById("data")')


def seen(browser: Browser) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(browser.ask(SEEN))
    return found


@pytest.mark.parametrize("how", WINDOWS)
@pytest.mark.parametrize("kind", KINDS)
def test_on_a_screen(
    browser: Browser, pages: dict[str, Path], looks: Path, kind: str, how: str
) -> None:
    """Nothing is wider than the window, no word is on two lines, and no part is empty."""
    width, height, features = WINDOWS[how]
    browser.emulate(features=features)
    browser.size(width, height)
    opened(browser, pages[kind])
    browser.ask("scrollTo(0, document.body.scrollHeight), scrollTo(0, 0), 0")
    whole = browser.ask("document.documentElement.scrollHeight")
    found = seen(browser)
    browser.size(width, min(whole, 8000))
    browser.shot(looks / f"{kind}-{how}.png")
    assert found["width"] <= width and found["wide"] == []
    assert found["broken"] == [] and found["empty"] == []
    assert found["bare"] == [] and found["tables"] == []
    assert not browser.console


@pytest.mark.parametrize("kind", KINDS)
def test_on_paper(browser: Browser, pages: dict[str, Path], looks: Path, kind: str) -> None:
    """Nothing is cut off at the right, and no sheet has a heading alone."""
    pdfium = pytest.importorskip("pypdfium2")
    browser.emulate(media="print")
    browser.size(SHEET, 1000)
    opened(browser, pages[kind])
    found = seen(browser)
    (looks / f"{kind}.pdf").write_bytes(browser.pdf())
    browser.emulate(media="screen", features={})
    assert found["width"] <= SHEET and found["wide"] == [] and found["cut"] == []
    sheets = pdfium.PdfDocument(looks / f"{kind}.pdf")
    for k, sheet in enumerate(sheets):
        picture = sheet.render(scale=1).to_pil().convert("L")
        picture.save(looks / f"{kind}-paper-{k + 1}.png")
        lines = np.flatnonzero((np.asarray(picture) < 200).any(axis=1))
        last = k == len(sheets) - 1
        assert len(lines) and (last or np.ptp(lines) > 0.1 * picture.height), f"sheet {k + 1}"
