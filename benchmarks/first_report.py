"""The time of a new user from ``git clone`` to the first report, and of the steps after it.

    python benchmarks/first_report.py [--rounds 3] [--no-cache] [--json FILE]

Every round uses new folders: it clones the repository, makes an environment, installs the package
with pip, runs ``cosim run configs/teleoperation.toml``, and lets headless Chromium, if there is
one, load and draw ``report.html``. This is README's first use, command by command. Then come the
first steps with a controller of one's own: its files, its test, a rehearsal in simulated time and
the replay of it. Processor time is that of a command and its children, and depends less on other
work on the machine. The times depend on the network and on pip's cache, which `--no-cache` leaves
out. Needs git and Python with pip, nothing else: the script imports only the standard library.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = "configs/teleoperation.toml"


#: A command: its name, its words, and the folder that it runs in.
Stage = tuple[str, list[str], Path]


def first_report(repository: str, folder: Path, pip: list[str]) -> Iterator[Stage]:
    """The commands up to the first report."""
    clone, bin_ = folder / "clone", folder / "env" / "bin"
    yield "git clone", ["git", "clone", "--quiet", repository, str(clone)], folder
    yield "python -m venv", [sys.executable, "-m", "venv", str(folder / "env")], folder
    yield "pip install .", [str(bin_ / "pip"), "install", "--quiet", *pip, "."], clone
    run = [str(bin_ / "cosim"), "run", SCENARIO, "--quiet", "--out", "first"]
    yield "cosim run", run, clone
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is not None:
        page = (clone / "first" / "report.html").as_uri()
        yield "browser", [
            browser, "--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder}",
            f"--screenshot={folder / 'first.png'}", "--window-size=1280,1600", page,
        ], folder  # fmt: skip


def own_controller(folder: Path, pip: list[str]) -> Iterator[Stage]:
    """The commands after it: a controller of one's own, its test, a rehearsal, and its replay."""
    bin_, own = folder / "env" / "bin", folder / "own"
    own.mkdir()
    cosim, law = str(bin_ / "cosim"), "my_law.toml"
    yield "cosim new controller", [cosim, "new", "controller", "my_law"], own
    yield "pip install pytest", [str(bin_ / "pip"), "install", "--quiet", *pip, "pytest"], own
    yield "pytest", [str(bin_ / "pytest"), "-q", "test_my_law.py"], own
    clock = ["-i", "cosim", "--clock", "simulated", "--quiet", "--out", "rehearsed"]
    yield "cosim rehearse", [cosim, "rehearse", law, *clock], own
    yield "cosim replay", [cosim, "replay", "rehearsed"], own


def processor_s() -> float:
    """Processor time of all commands so far, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def waited(stages: Iterable[Stage]) -> dict[str, tuple[float, float]]:
    """Wall and processor seconds of each stage. Raises SystemExit if a stage fails."""
    found: dict[str, tuple[float, float]] = {}
    env = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    for name, words, at in stages:
        begin, used = time.perf_counter(), processor_s()
        done = subprocess.run(words, env=env, cwd=at, capture_output=True, text=True, check=False)
        found[name] = time.perf_counter() - begin, processor_s() - used
        if done.returncode:
            said = f"{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
            raise SystemExit(f"{name}: exit code {done.returncode}\n{said}")
    return found


def one_round(repository: str, pip: list[str]) -> dict[str, tuple[float, float]]:
    """Wall and processor seconds of each stage of one round, and of those up to the report."""
    with TemporaryDirectory(prefix="first-report-", ignore_cleanup_errors=True) as folder:
        found = waited(first_report(repository, Path(folder), pip))
        if "browser" in found and not Path(folder, "first.png").is_file():
            raise SystemExit("the browser drew no picture of the report")
        wall, used = (sum(times) for times in zip(*found.values(), strict=True))
        return {**found, "together": (wall, used), **waited(own_controller(Path(folder), pip))}


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
    count = 1 if options.quick else options.rounds
    rounds = [one_round(options.repository, pip) for _ in range(count)]
    stages = {name: [one[name][0] for one in rounds] for name in rounds[0]}
    used = {name: [one[name][1] for one in rounds] for name in rounds[0]}
    print("| stage | median, s | longest, s | processor, s |\n|---|---|---|---|")
    for name, values in stages.items():
        processor = median(used[name])
        print(f"| {name} | {median(values):.1f} | {max(values):.1f} | {processor:.1f} |")
    facts = {
        "rounds": len(rounds), "cores": os.cpu_count(), "python": platform.python_version(),
        "load": list(os.getloadavg()), "browser": "browser" in stages,
    }  # fmt: skip
    print(f"\n{facts}")
    if options.json is not None:
        options.json.write_text(
            json.dumps({"seconds": stages, "processor": used, **facts}), encoding="utf-8"
        )


if __name__ == "__main__":
    main()
