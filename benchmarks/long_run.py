"""Memory and time of the commands that read a recording, for runs of growing length.

    python benchmarks/long_run.py [--rows 1e6 1e7 1e8] [--commands run report ...] [--json FILE]

A mass that is pushed less and less is recorded at every tick, in three signals.
Each command is a process of its own, of which the peak of resident memory and the wall time are
measured. The recording of 1e8 rows takes some 3 GB, and an exported file up to 6 GB, beside the
current folder; they are deleted afterwards.

On request also `arms`, a run of two arms with 42 signals in a row (8.7 GB for 1e8 rows), with
`arms-report`, `arms-show`, `arms-diff` and `arms-parquet`; `compare` (two controllers, `rows` looks
of each link, each hundredth row recorded); and, of a rehearsal in lock-step with `rows` slots of
two nodes (832 bytes of journals a slot), `rehearse`, `replay` and `offline` (`replay --offline`).
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))

from benchmarks import tables
from cosim.base.clock import stopwatch

COMMAND = str(Path(sys.executable).with_name("cosim"))
GOAL = 300  # MB of resident memory
SCENARIO = """
title = "A mass that is pushed less and less, recorded at every tick"
[run]
step = "1 ms"
stop = "{stop} s"
record.signals = ["mass.x", "mass.dx", "push.f"]
[components.mass]
model = "fmus.models.pointmass"
inputs = {{ f = "push.f" }}
parameters = {{ b = 0.01 }}
[components.push]
model = "fmus.models.decaying_push"
period = "1 ms"
[analysis]
force = "push.f"
response = "mass.x"
rate = "mass.dx"
[metrics]
rest = {{ kind = "error", of = ["mass.dx"], target = [0.0], within = 0.05 }}
way = {{ kind = "norm", of = ["mass.x"] }}
late = {{ kind = "tail_mean", of = ["mass.dx"], window = "10 s" }}
swing = {{ kind = "vibration", of = ["mass.x"], window = "10 s" }}
peak = {{ kind = "peak", of = ["mass.dx"] }}
[require.near]
always = "abs(mass.x) <= 10 km"
[require.slows]
formula = "mass.dx <= 50 m/s until within [100 s, 1000 s] mass.dx <= 4 m/s"
[require.gentle]
formula = "always (push.f >= 0.01 N implies eventually within 100 s push.f <= 0.01 N)"
[figures.motion]
[[figures.motion.panels]]
y = ["mass.x", "mass.dx"]
"""
TWO_ARMS = str(Path(__file__).resolve().parents[1] / "configs" / "teleoperation.toml")
#: Words of each command.
CALLS = {
    "run": ["run", "{scenario}", "--out", "{run}", "--no-live"],
    "report": ["report", "{run}"],
    "png": ["report", "{run}", "--png"],
    "show": ["show", "{run}"],
    "diff": ["diff", "{run}", "{run}"],
    "analyze": ["analyze", "{run}", "--no-tests", "--png"],
    "mat": ["export", "{run}", "--to", "{folder}/run.mat", "--signal", "mass.x"],
    "csv": ["export", "{run}", "--to", "{folder}/run.csv"],
    "parquet": ["export", "{run}", "--to", "{folder}/copy.parquet"],
    "mcap": ["export", "{run}", "--to", "{folder}/run.mcap"],
    "compare": ["compare", TWO_ARMS, "--controllers", "pd,p+d", "--operators", "light", "--links",
                "paper", "--jobs", "1", "--no-plot", "--set", "run.step=5 ms", "--set",
                "run.stop={looks_s} s", "--set", "run.record.every=100", "--out", "{folder}/table"],
    "arms": ["run", TWO_ARMS, "--no-plot", "--set", "run.stop={count_s} s", "--out", "{arms}"],
    "arms-report": ["report", "{arms}"],
    "arms-show": ["show", "{arms}"],
    "arms-diff": ["diff", "{arms}", "{arms}"],
    "arms-parquet": ["export", "{arms}", "--to", "{folder}/copy.parquet"],
    "rehearse": ["rehearse", TWO_ARMS, "--deploy", "zenoh", "--clock", "lockstep", "--no-plot",
                 "--set", "run.stop={slots_s} s", "--out", "{folder}/nodes"],
    "replay": ["replay", "{folder}/nodes"],
    "offline": ["replay", "{folder}/nodes", "--offline"],
}  # fmt: skip
#: What has to be there before a command; `run` before all others.
BEFORE = {
    "run": [], "compare": [], "arms": [], "rehearse": [],
    "arms-report": ["arms"], "arms-show": ["arms"], "arms-diff": ["arms"], "arms-parquet": ["arms"],
    "replay": ["rehearse"], "offline": ["rehearse"],
}  # fmt: skip


def measured(words: list[str]) -> dict[str, Any]:
    """Wall time, s, and peak of resident memory, MB, of a command."""
    watch = stopwatch()
    process = subprocess.Popen([COMMAND, *words], stdout=subprocess.DEVNULL)
    peak = 0
    while process.poll() is None:
        peak = max(peak, _peak(process.pid))
        try:
            process.wait(0.05)
        except subprocess.TimeoutExpired:
            continue
    return {"s": watch(), "mb": peak / 1000, "exit": process.returncode}


def _peak(pid: int) -> int:
    """The largest peak of a process and its children, kB; 0 when they are gone."""
    found = 0
    for each in (pid, *_children(pid)):
        try:
            text = Path(f"/proc/{each}/status").read_text(encoding="ascii")
        except OSError:
            continue
        lines = [line for line in text.splitlines() if line.startswith("VmHWM:")]
        found = max([found, *(int(line.split()[1]) for line in lines)])
    return found


def _children(pid: int) -> list[int]:
    try:
        text = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii")
    except OSError:
        return []
    return [int(child) for child in text.split()]


def rows(count: int, commands: list[str]) -> list[dict[str, Any]]:
    """A row for each command on a recording of `count` rows."""
    found = []
    with TemporaryDirectory(prefix="long-run-", dir=Path.cwd()) as folder:
        scenario = Path(folder) / "long.toml"
        scenario.write_text(SCENARIO.format(stop=(count - 1) / 1000), encoding="utf-8")
        names = {"scenario": str(scenario), "run": f"{folder}/run", "folder": folder,
                 "arms": f"{folder}/arms", "count_s": f"{(count - 1) * 0.001:.15g}",
                 "looks_s": f"{count * 0.005:g}", "slots_s": f"{count * 0.001:g}"}  # fmt: skip
        wanted = [x for command in commands for x in (*BEFORE.get(command, ["run"]), command)]
        for command in dict.fromkeys(wanted):
            row = measured([word.format(**names) for word in CALLS[command]])
            for kind in ("run.csv", "copy.parquet", "run.mcap", "run.mat"):
                (Path(folder) / kind).unlink(missing_ok=True)
            print(f"{count:>10} {command:<8} {row['mb']:6.0f} MB {row['s']:7.1f} s {row['exit']}",
                  file=sys.stderr)  # fmt: skip
            found.append({"rows": count, "command": command, **row})
    return found


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=float, nargs="+", default=[1e6, 1e7, 1e8])
    parser.add_argument("--commands", nargs="+", choices=sorted(CALLS),
                        default=[x for x in CALLS if x not in BEFORE or x == "run"])  # fmt: skip
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    found = [row for count in given.rows for row in rows(int(count), given.commands)]
    if given.json:
        data = {"machine": tables.machine(), "goal_mb": GOAL, "rows": found}
        given.json.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
    head = ["rows", "command", "peak, MB", "time, s"]
    lines = [(f"{r['rows']:.0e}", r["command"], f"{r['mb']:.0f}", f"{r['s']:.1f}") for r in found]
    print(tables.grid(head, lines))


if __name__ == "__main__":
    main()
