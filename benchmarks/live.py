"""Live reports: sizes of bundles, and the time of a run in a page, in Node and in Chromium.

``python -m benchmarks.live [--json FILE] [--quick]``: for some scenarios the bundle (s, kB), the
command line's engine, and in Node and Chromium (where it is installed) opening the bundle and
computing the run, the least of several times. The digests must be those of the command line.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

from cosim.engine.simulate import simulate
from cosim.live import bundle, digest
from cosim.live.bundle import script
from cosim.loading.files import load
from cosim.record import Run
from tests.browser.devtools import Browser
from tests.cosim.live.node import node

CONFIGS = Path(__file__).parents[1] / "configs"
NAMES = ("teleoperation", "network", "openarm", "teaching")
#: Opens the bundle once, computes ROUNDS times.
_TIMED = """
async function timed(bundle) {
  const before = performance.now(), live = await Live.open(bundle), seconds = [];
  const opened = (performance.now() - before) / 1000;
  let digest = "";
  for (let i = 0; i < ROUNDS; i++) {
    const result = await live.compute({});
    digest = result.digest;
    seconds.push(result.seconds);
  }
  return JSON.stringify({opened, computed: Math.min(...seconds), first: seconds[0], digest});
}
"""


def in_node(program: str, made: dict[str, Any]) -> dict[str, Any]:
    """The times of a bundle in Node."""
    end = 'timed(JSON.parse(require("fs").readFileSync(0, "utf8"))).then(console.log);'
    call = [node(), "-e", program + end]
    done = subprocess.run(call, input=json.dumps(made), capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout))


def in_chromium(program: str, made: dict[str, Any]) -> dict[str, Any] | None:
    """The times of a bundle in a page of Chromium; None without Chromium."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        return None
    with tempfile.TemporaryDirectory() as scratch:
        page, profile = Path(scratch, "page.html"), Path(scratch, "profile")
        profile.mkdir()
        data = json.dumps(made).replace("<", "\\u003c")
        page.write_text(
            f'<!DOCTYPE html><meta charset="utf-8"><script>{program}</script>'
            f'<script type="application/json" id="bundle">{data}</script>',
            encoding="utf-8",
        )
        with Browser(chromium, profile) as browser:
            browser.open(page.as_uri())
            browser.until('document.getElementById("bundle") !== null')
            found = browser.ask('timed(JSON.parse(document.getElementById("bundle").textContent))')
    return dict(json.loads(found))


def measured(name: str, rounds: int) -> dict[str, Any]:
    """The numbers of a scenario."""
    path = CONFIGS / f"{name}.toml"
    before = perf_counter()
    made = bundle(load(path))
    found: dict[str, Any] = {"scenario": name, "bundle_s": perf_counter() - before}
    found |= {"kB": len(json.dumps(made)) / 1000, "keys": len(made["keys"])}
    with tempfile.TemporaryDirectory() as scratch:
        outcome = simulate(load(path), Path(scratch) / "run")
        expected = digest(Run.open(Path(scratch) / "run"))
    found |= {"simulated_s": outcome.seconds, "native_s": outcome.wall}
    program = script() + _TIMED.replace("ROUNDS", str(rounds))
    for where, times in (
        ("node", in_node(program, made)),
        ("chromium", in_chromium(program, made)),
    ):
        if times is None:
            continue
        assert times.pop("digest") == expected, f"{name}: other bits in {where}"
        found |= {f"{where}_{key}_s": value for key, value in times.items()}
    return found


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="one scenario, once")
    given = parser.parse_args()
    names = NAMES[:1] if given.quick else NAMES
    rows = [measured(name, 1 if given.quick else given.rounds) for name in names]
    heads = list(rows[0])
    print("| " + " | ".join(heads) + " |\n|" + "---|" * len(heads))
    for row in rows:
        cells = (row.get(head, "") for head in heads)
        texts = (f"{x:.3g}" if isinstance(x, float) else str(x) for x in cells)
        print("| " + " | ".join(texts) + " |")
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
