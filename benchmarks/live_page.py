"""A live report in a browser: its size, its first picture, and how soon it shows a run anew.

    python benchmarks/live_page.py [--rounds 5] [--json FILE]

Runs ``configs/teleoperation.toml`` with ``--no-live`` and ``--live``, and opens the page in
headless Chromium. Then the greatest delay of both links is moved: `computed` is the time of the run
and its digest in the worker, `shown` that from the moved slider to the changed page. Processor time
of the command depends less on other work on the machine than the times do. Needs Chromium.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # the tests have a browser

from tests.browser.devtools import Browser  # noqa: E402

SCENARIO = ROOT / "configs" / "teleoperation.toml"
SLIDER = "document.querySelector('[data-key=\"links.0.delay.high\"] [type=range]')"
#: Moves the slider; [ms until the page has changed, ms of the run].
MOVED = """(async () => {{
  const said = document.getElementById("live-said"), slider = {}, before = performance.now();
  const done = new Promise((resolve) => new MutationObserver(() => {{
    if (said.textContent.includes("computed in")) requestAnimationFrame(() => resolve());
  }}).observe(said, {{childList: true, characterData: true, subtree: true}}));
  slider.value = "{}";
  slider.dispatchEvent(new Event("input", {{bubbles: true}}));
  await done;
  const [, size, unit] = /computed in ([\\d.]+) (m?s)/.exec(said.textContent);
  return [performance.now() - before, Number(size) * (unit === "s" ? 1000 : 1)];
}})()"""
PAINT = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime"


def written(folder: Path, *options: str) -> float:
    """Processor seconds of the command that writes a report into a folder."""
    cosim = [sys.executable, "-c", "from cosim.cli import main; main()"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    words = ["run", str(SCENARIO), *options, "--quiet", "--force", "--out", str(folder)]
    subprocess.run([*cosim, *words], check=True, cwd=ROOT)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def looked_at(page: Path, folder: Path, rounds: int) -> Iterator[tuple[float, float, float]]:
    """First picture, moved value until shown, run in the worker: ms, a row a round."""
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        sys.exit("benchmarks/live_page.py: found no Chromium")
    with Browser(program, folder) as browser:
        for k in range(rounds):
            browser.open("about:blank")
            browser.open(page.as_uri())
            browser.until("document.body?.dataset.ready === 'yes'")
            paint = browser.until(PAINT)
            browser.ask(MOVED.format(SLIDER, 0.6))  # compiles engine and models
            shown, computed = browser.ask(MOVED.format(SLIDER, round(0.7 + 0.01 * k, 2)))
            yield paint, shown, computed


def main() -> None:
    """Measure, print, and write JSON if wanted."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="One round.")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    rounds = 1 if given.quick else given.rounds
    with TemporaryDirectory(ignore_cleanup_errors=True) as name:
        plain, live = Path(name) / "plain", Path(name) / "live"
        times = [(written(plain, "--no-live"), written(live, "--live")) for _ in range(rounds)]
        pages = [folder / "report.html" for folder in (plain, live)]
        sizes = [page.stat().st_size for page in pages]
        seen = [*looked_at(pages[1], Path(name) / "profile", rounds)]
    commands = [median(x) for x in zip(*times, strict=True)]
    paint, shown, computed = (median(x) for x in zip(*seen, strict=True))
    found = {
        "bytes": dict(zip(("plain", "live"), sizes, strict=True)),
        "processor_s": dict(zip(("plain", "live"), commands, strict=True)),
        "first_picture_ms": paint, "shown_ms": shown, "computed_ms": computed,
    }  # fmt: skip
    print(f"report.html          {sizes[0] / 1e3:7.0f} kB, live {sizes[1] / 1e3:.0f} kB")
    print(f"cosim run            {commands[0]:7.2f} s of processor time, live"
          f" {commands[1]:.2f} s")  # fmt: skip
    print(f"first picture        {paint:7.0f} ms")
    print(f"moved value shown in {shown:7.0f} ms, of which the run took {computed:.0f} ms")
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
