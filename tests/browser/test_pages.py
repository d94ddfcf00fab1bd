"""Reports in a real browser: nothing fails, nothing is requested, and the time moves the arms."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.record import Run
from cosim.reporting.many import ARMS
from cosim.reporting.run_report import write_report
from tests.bridge.zenoh.rehearsed import CONFIGS
from tests.browser.devtools import Browser
from tests.system.runs import run as simulated
from tests.system.runs import teleoperation

pytestmark = [pytest.mark.slow, pytest.mark.browser]
SCRIPT = """
const arm = (name) => document.querySelector(`[data-tip="${name}"]`).dataset.at;
const now = () => document.getElementById("now").textContent;
const seen = {start: arm("master")};
const bar = document.getElementById("time");
bar.value = "1.5";
bar.dispatchEvent(new Event("input"));
Object.assign(seen, {moved: arm("master"), slave: arm("slave"), now: now()});
setTimeout(() => {
  const over = document.querySelector(".u-over"), box = over.getBoundingClientRect();
  const at = {clientX: box.left + box.width / 4, clientY: box.top + box.height / 2, bubbles: true};
  for (const kind of ["mouseenter", "mousemove"]) over.dispatchEvent(new MouseEvent(kind, at));
  setTimeout(() => {
    Object.assign(seen, {hovered: now(), arm: arm("master")});
    document.querySelector("#signals input").click();
    seen.chosen = document.querySelectorAll("#chosen canvas").length;
    seen.panels = document.querySelectorAll("#panels canvas").length;
    tell(seen);
  }, 300);
}, 300);
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    document = teleoperation(stop=2.0)
    panels = [{"y": [f"{side}.q[{i}]" for side in ("master", "slave")]} for i in (0, 1)]
    document["figures"] = {"positions": {"panels": panels}}
    found = simulated(document, tmp_path_factory.mktemp("run") / "run")
    write_report(found)
    return found


def tip(place: str) -> tuple[float, float]:
    x, y, z = map(float, place.split())
    assert z == 0.0
    return x, y


def expected(run: Run, name: str, t: float) -> tuple[float, float]:
    """The position of the tip of a planar arm with links of 1 m."""
    q = [np.interp(t, run.t, run.column(f"{name}.q[{i}]")) for i in (0, 1)]
    angle = q[0] + q[1]
    return np.cos(q[0]) + np.cos(angle), np.sin(q[0]) + np.sin(angle)


def test_time_moves_the_arms_and_nothing_fails(run: Run, ask: Any) -> None:
    seen = ask(run.path.parent / "report.html", SCRIPT)
    assert tip(seen["start"]) == pytest.approx(expected(run, "master", 0.0), abs=1e-4)
    assert seen["now"] == "1.500 s"
    assert tip(seen["moved"]) == pytest.approx(expected(run, "master", 1.5), abs=2e-3)
    assert tip(seen["slave"]) == pytest.approx(expected(run, "slave", 1.5), abs=2e-3)
    hovered = float(seen["hovered"].split()[0])
    assert 0.4 < hovered < 0.6  # a quarter of the diagram
    assert tip(seen["arm"]) == pytest.approx(expected(run, "master", hovered), abs=5e-3)
    assert (seen["panels"], seen["chosen"]) == (2, 1)


NAMES = """
const scene = document.getElementById("arm"), square = scene.getBoundingClientRect();
const names = [...document.querySelectorAll("#arms span:not(.force)")];
const boxes = names.map((name) => name.getBoundingClientRect());
tell({
  names: names.map((name) => name.textContent),
  colours: names.map((name) => getComputedStyle(name.querySelector("b")).color),
  drawn: names.map((name) => {
    const tip = scene.querySelector(`[data-tip="${name.textContent.split(" ")[1]}"]`);
    return getComputedStyle(tip).fill;
  }),
  inside: [...scene.querySelectorAll("text")].map((text) => text.textContent),
  force: document.querySelector("#arms .force").textContent,
  below: Math.min(...boxes.map((box) => box.top)) - square.bottom,
  right: square.right - Math.max(...boxes.map((box) => box.right)),
});
"""


@pytest.mark.parametrize("n", [6, ARMS + 2])
def test_the_names_of_arms_cover_no_arm(n: int, ask: Any, tmp_path: Path) -> None:
    scenario = load(CONFIGS / "many.toml", (f"graphs.net.n={n}", "run.stop=0.5"))
    simulate(scenario, tmp_path / "run")
    seen = ask(write_report(Run.open(tmp_path / "run")), NAMES)
    assert [name.split()[1] for name in seen["names"]] == [
        f"robot{i + 1}" for i in range(min(n, ARMS))
    ]
    assert seen["colours"] == seen["drawn"] and seen["inside"] == ["1 m", "x", "y"]
    assert seen["force"] == "→ force at the tip"
    assert 0 <= seen["below"] < 20 and seen["right"] >= 0


SPACE = """
[run]
step = "1 ms"
stop = "0.1 s"
[components.arm]
count = 4
model = "fmus.models.arm"
options = { urdf = "URDF", base = "link0", tip = "link6" }
start = { q = [0.0, 0.4, 0.9, 0.3, 0.0, 0.2] }
"""
BOXES = """tell({boxes: ["arm1", "arm2", "arm3", "arm4"].map((name) => {
  const lines = [...document.querySelectorAll(`[data-arm="${name}"]`)];
  const boxes = lines.map((line) => line.getBoundingClientRect());
  const least = (key) => Math.min(...boxes.map((box) => box[key]));
  const most = (key) => Math.max(...boxes.map((box) => box[key]));
  return [least("left"), most("right"), least("top"), most("bottom")];
})});"""


def test_arms_in_space_stand_in_rows(ask: Any, tmp_path: Path) -> None:
    urdf = (CONFIGS / "robots" / "six_axis.urdf").as_posix()
    path = tmp_path / "space.toml"
    path.write_text(SPACE.replace("URDF", urdf))
    simulate(load(path), tmp_path / "run")
    boxes = ask(write_report(Run.open(tmp_path / "run")), BOXES)["boxes"]
    (left, right, _, bottom), (beside, _, _, _), (below, _, top, _), _ = boxes
    assert right < beside and bottom < top and below == pytest.approx(left, abs=1)


#: Tips in m, what is drawn outside of the picture, and the tip of an arm before and after a drag.
SHARED = """
const scene = document.getElementById("arm"), box = scene.getBoundingClientRect();
const tips = Object.fromEntries([...scene.querySelectorAll("[data-tip]")].map(
  (tip) => [tip.dataset.tip, tip.dataset.at.split(" ").map(Number)]));
const outside = [...scene.querySelectorAll("[data-arm], [data-tip], text")].filter((one) => {
  const own = one.getBoundingClientRect();
  return own.left < box.left || own.right > box.right || own.top < box.top
    || own.bottom > box.bottom;
}).length;
const place = () => document.querySelector("[data-tip]").getAttribute("cx");
const before = place(), at = {bubbles: true, pointerId: 1, clientY: box.top + 100};
scene.setPointerCapture = () => {};
scene.dispatchEvent(new PointerEvent("pointerdown", {...at, clientX: box.left + 100}));
scene.dispatchEvent(new PointerEvent("pointermove", {...at, clientX: box.left + 160}));
scene.dispatchEvent(new PointerEvent("pointerup", at));
const turned = place();
scene.dispatchEvent(new PointerEvent("pointermove", {...at, clientX: box.left + 300}));
tell({tips, outside, before, turned, after: place(),
  traces: scene.querySelectorAll(".trace").length,
  bodies: scene.querySelectorAll("[data-arm=slave]").length,
  length: scene.querySelector(".scale text").textContent});
"""


def test_arms_that_agree_on_their_tips_stand_in_one_workspace(ask: Any, tmp_path: Path) -> None:
    """The tips are where the controllers, computed in C, have them in common coordinates."""
    settings = ("run.stop=1", "run.record.every=100")
    simulate(load(CONFIGS / "task_space.toml", settings), tmp_path / "run")
    run = Run.open(tmp_path / "run")
    page = write_report(run)
    text = page.read_text(encoding="utf-8")
    page.write_text(text.replace("location.hash", '"#t=0.9"'), encoding="utf-8")
    seen = ask(page, SHARED)
    row = int(np.argmin(abs(run.t - 0.9)))
    for name in ("master", "slave", "planar"):
        expected = [run.column(f"{name}_control.x[{i}]")[row] for i in range(3)]
        assert seen["tips"][name] == pytest.approx(expected, abs=2e-3)
    assert seen["outside"] == 0 and seen["length"].split()[1] in ("mm", "m")
    assert seen["before"] != seen["turned"] == seen["after"]
    assert seen["traces"] >= 3 and seen["bodies"] >= 10


#: How wide a phone's page is; words of cells that stand on two lines.
NARROW = """JSON.stringify({wide: document.documentElement.scrollWidth, broken:
  [...document.querySelectorAll(".scroll td")].flatMap((cell) => {
    const text = document.createTreeWalker(cell, NodeFilter.SHOW_TEXT).nextNode(), broken = [];
    for (const word of (text?.data ?? "").matchAll(/\\b[a-z]{3,12}\\b/g)) {
      const range = document.createRange();
      range.setStart(text, word.index);
      range.setEnd(text, word.index + word[0].length);
      if (range.getClientRects().length > 1) broken.push(word[0]);
    }
    return broken;
  })})"""


PLOTS = "[...document.querySelectorAll('.u-wrap')]"


def test_on_a_phone_nothing_overflows_and_words_are_whole(
    run: Run, chromium: str, tmp_path: Path
) -> None:
    with Browser(chromium, tmp_path / "profile") as browser:
        browser.size(390, 1600)
        browser.open(f"{(run.path.parent / 'report.html').as_uri()}#t=1.5")
        browser.until("document.body?.dataset.ready === 'yes'")
        seen = json.loads(browser.ask(NARROW))
        browser.size(360, 1600)  # turned or made narrower: diagrams keep their time
        browser.until(
            "Math.max(...plots().map((p) => p.clientWidth)) < 345".replace("plots()", PLOTS)
        )
        shown = browser.ask("document.querySelector('.u-legend .u-value').textContent")
    assert float(shown.split()[0]) == pytest.approx(1.5, abs=0.02)
    assert seen["wide"] <= 390 and seen["broken"] == []


#: Keeps the texts that are written on canvases.
WRITTEN = """<script>window.written = [];
const write = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function (text, ...rest) {
  written.push(text);
  return write.call(this, text, ...rest);
};
</script>"""


def test_ticks_of_a_time_axis_carry_the_unit(run: Run, ask: Any, tmp_path: Path) -> None:
    text = (run.path.parent / "report.html").read_text(encoding="utf-8")
    page = tmp_path / "page.html"
    page.write_text(text.replace("<style>", WRITTEN + "<style>", 1), encoding="utf-8")
    written = ask(page, "setTimeout(() => tell({written}), 300);")["written"]
    assert {"0 s", "1 s", "2 s"} <= set(written)


def test_the_picture_has_the_curves(run: Run, browse: Any, tmp_path: Path) -> None:
    from PIL import Image

    shot = tmp_path / "shot.png"
    browse(run.path.parent / "report.html", f"--screenshot={shot}")
    image = np.asarray(Image.open(shot).convert("RGB")).astype(int)
    for colour in ((0x00, 0x72, 0xB2), (0xD5, 0x5E, 0x00)):
        assert (np.abs(image - colour).max(axis=-1) < 24).sum() > 800
