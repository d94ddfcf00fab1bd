"""What ``cosim run`` does, stage by stage, in a process of its own; prints JSON.

    python stages.py STARTED SCENARIO FOLDER [PATH=VALUE ...]

STARTED: ``time.perf_counter()`` of whoever started this process, just before.
"""

import sys
import time

BORN = time.perf_counter(), time.process_time()


class Stages:
    """Wall and processor seconds between marks; and what that adds up to."""

    def __init__(self, started: float) -> None:
        """From the start of the process on, or from the first line where clocks differ."""
        self.found: dict[str, dict[str, float]] = {}
        known = 0.0 <= BORN[0] - started < 60.0
        self._last = (started if known else BORN[0], 0.0)
        self.mark("start Python", BORN)

    def mark(self, name: str, now: tuple[float, float] | None = None) -> None:
        """End a stage."""
        now = now or (time.perf_counter(), time.process_time())
        wall, cpu = (b - a for a, b in zip(self._last, now, strict=True))
        self.found[name] = {"wall": wall, "cpu": cpu}
        self._last = now

    def split(self, name: str, part: str, wall: float) -> None:
        """Take `wall` s out of a stage as a stage of its own."""
        self.found[name]["wall"] -= wall
        self.found[part] = {"wall": wall, "cpu": float("nan")}


def peak() -> float:
    """Greatest resident memory of this process so far, MB."""
    try:
        with open("/proc/self/status", encoding="ascii") as status:
            lines = dict(line.split(":", 1) for line in status)
        return int(lines["VmHWM"].split()[0]) / 1024
    except (OSError, KeyError):
        import resource

        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return most / (1 << 20 if sys.platform == "darwin" else 1024)


def main() -> None:
    """Run the scenario as the command does, with a mark behind every stage."""
    stages = Stages(float(sys.argv[1]))
    from pathlib import Path

    sys.path.append(str(Path(__file__).resolve().parents[1]))
    import cosim.cli.commands

    stages.mark("import the command line")
    from cosim.cli.options import OutputOptions
    from cosim.cli.summary import pictures, summary
    from cosim.engine.simulate import simulate
    from cosim.loading.files import load
    from cosim.record import Run
    from cosim.scenario.assemble import assemble

    stages.mark("import the runner")
    scenario = load(Path(sys.argv[2]), sys.argv[4:])
    plan = assemble(scenario)
    stages.mark("read scenario and FMUs")
    outcome = simulate(scenario, Path(sys.argv[3]), plan=plan)
    stages.mark("start components, files")
    stages.split("start components, files", "run and record", outcome.wall)
    memory = peak()
    run = Run.open(sys.argv[3])
    summary(scenario, run, outcome)
    stages.mark("metrics")
    list(pictures(scenario, run, OutputOptions(plot=len(sys.argv) == 4)))
    stages.mark("write the report")
    import json

    facts = {"stages": stages.found, "peak_mb": memory, "seconds": outcome.seconds}
    print(json.dumps({**facts, "wall": outcome.wall, "ended": time.perf_counter()}))
    del cosim


if __name__ == "__main__":
    main()
