"""How long a new user waits from ``git clone`` to the first report on the screen.

    python benchmarks/first_report.py [--rounds 3] [--no-cache] [--json FILE]

Every round uses new folders: it clones the repository, makes an environment, installs the package
with pip, runs ``cosim run configs/teleoperation.toml``, and lets headless Chromium, if there is
one, load and draw ``report.html``. This is README's first use, command by command. The times
depend on the network and on pip's cache, which `--no-cache` leaves out. Needs git and Python
with pip, nothing else: the script imports only the standard library.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = "configs/teleoperation.toml"


def commands(repository: str, folder: Path, pip: list[str]) -> dict[str, list[str]]:
    """What the user types, by the name of the stage; all but the first run in the clone."""
    clone, bin_ = folder / "clone", folder / "env" / "bin"
    found = {
        "git clone": ["git", "clone", "--quiet", repository, str(clone)],
        "python -m venv": [sys.executable, "-m", "venv", str(folder / "env")],
        "pip install .": [str(bin_ / "pip"), "install", "--quiet", *pip, "."],
        "cosim run": [str(bin_ / "cosim"), "run", SCENARIO, "--quiet", "--out", "first"],
    }
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is not None:
        page = (clone / "first" / "report.html").as_uri()
        found["browser"] = [
            browser, "--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder}",
            f"--screenshot={folder / 'first.png'}", "--window-size=1280,1600", page,
        ]  # fmt: skip
    return found


def waited(repository: str, pip: list[str]) -> dict[str, float]:
    """Wall seconds of each stage of one round. Raises SystemExit if a stage fails."""
    found: dict[str, float] = {}
    env = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    with TemporaryDirectory(prefix="first-report-", ignore_cleanup_errors=True) as folder:
        for name, words in commands(repository, Path(folder), pip).items():
            at = Path(folder, "clone")
            begin = time.perf_counter()
            done = subprocess.run(
                words, env=env, cwd=at if at.exists() else folder, capture_output=True, text=True,
                check=False,
            )  # fmt: skip
            found[name] = time.perf_counter() - begin
            if done.returncode:
                raise SystemExit(f"{name}: exit code {done.returncode}\n{done.stderr[-2000:]}")
        if "browser" in found and not Path(folder, "first.png").is_file():
            raise SystemExit("the browser drew no picture of the report")
    return found


def main() -> None:
    """Measure, print a Markdown table, write the JSON file if one is asked for."""
    said = (__doc__ or "").splitlines()[0]
    parser = argparse.ArgumentParser(description=said)
    parser.add_argument("--repository", default=str(ROOT), help="what git clones")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--quick", action="store_true", help="one round")
    parser.add_argument("--no-cache", action="store_true", help="do not use pip's cache")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    pip = ["--no-cache-dir"] if options.no_cache else []
    rounds = [
        waited(options.repository, pip) for _ in range(1 if options.quick else options.rounds)
    ]
    stages = {name: [one[name] for one in rounds] for name in rounds[0]}
    stages["together"] = [sum(one.values()) for one in rounds]
    print(
        "| stage          | median, s | longest, s |\n|----------------|-----------|------------|"
    )
    for name, values in stages.items():
        print(f"| {name:<14} | {median(values):>9.1f} | {max(values):>10.1f} |")
    facts = {
        "rounds": len(rounds), "cores": os.cpu_count(), "python": platform.python_version(),
        "load": list(os.getloadavg()), "browser": "browser" in stages,
    }  # fmt: skip
    print(f"\n{facts}")
    if options.json is not None:
        options.json.write_text(json.dumps({"seconds": stages, **facts}), encoding="utf-8")


if __name__ == "__main__":
    main()
