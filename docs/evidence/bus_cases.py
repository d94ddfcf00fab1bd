"""Write the numbers and pictures of ``bus-cases.md`` beside this file, which is a program.

Each case is a study of ``configs/studies``. `--numbers` leaves the pictures as they are.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
PAGE = Path(__file__).with_name("bus-cases.md")
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from cosim.bus.accounting import BusHistory  # noqa: E402
from cosim.engine.simulate import simulate  # noqa: E402
from cosim.loading.files import load  # noqa: E402
from cosim.measure import declared_metrics  # noqa: E402
from cosim.measure.metrics import evaluate  # noqa: E402
from cosim.record import Run  # noqa: E402
from cosim.reporting.bus_account import draw_account  # noqa: E402
from cosim.reporting.figures import draw_styled, png  # noqa: E402
from cosim.scenario.assemble import assemble, scenario_components  # noqa: E402
from cosim.scenario.buses import bus_history  # noqa: E402
from cosim.scenario.connect_links import frames_on_buses  # noqa: E402
from cosim.study.design import Point, points  # noqa: E402
from cosim.study.study import load_study  # noqa: E402

STUDIES = ROOT / "configs" / "studies"
SCENARIO = ROOT / "configs" / "can" / "teleoperation-bus.toml"
#: Of each picture of frames: study, case, begin and length, s.
FRAMES: dict[str, tuple[str, str, float, float]] = {
    "bus-babbling-frames.png": ("bus-babbling", "without", 0.985, 0.03),
    "bus-priority-sorted.png": ("bus-priority", "sorted", 0.002, 0.012),
    "bus-priority-fifo.png": ("bus-priority", "fifo", 0.002, 0.012),
    "bus-off-frames.png": ("bus-off", "recovers", 1.9995, 0.002),
}
#: Of each picture of arms: study, and the time in which the bus is disturbed, s.
ARMS = {"bus-babbling.png": ("bus-babbling", (1.0, 4.0)), "bus-off.png": ("bus-off", (2.0, 4.0))}
SHOWN = 20.0
"""How much of a run is drawn, s."""


def case_of(point: Point) -> str:
    """The name of a case: the cells of the table, such as ``below, 0.35``."""
    return ", ".join(str(cell).lower() for name, cell in point.cells.items() if name != "seed")


def cases(study: str) -> Mapping[str, Sequence[str]]:
    """The settings of each case of a study, with its first seed."""
    found: dict[str, Sequence[str]] = {}
    for point in points(load_study(STUDIES / f"{study}.toml")):
        found.setdefault(case_of(point), point.settings)
    return found


def run(settings: Sequence[str], folder: Path) -> tuple[Run, dict[str, float]]:
    """A run in a new folder, and its numbers."""
    scenario = load(SCENARIO, list(settings))
    plan = assemble(scenario)
    simulate(scenario, folder, plan=plan)
    done = Run.open(folder)
    results = {r.name: r for r in evaluate(declared_metrics.metrics(scenario), done)}
    laws: list[Any] = [link.table.law for link in plan.links]
    return done, {
        "worst": max(float(law.known["simulated_worst"]) for law in laws),
        "late": float(laws[0].known["simulated_worst"]),
        "lost": sum(int(law.known["lost"]) for law in laws),
        "settle": results["tracking_error"].parts["settle_s"],
        "apart": results["sync_error"].parts["max"],
        "effort": results["effort"].value,
    }


def history(settings: Sequence[str], until: float) -> BusHistory:
    """What happens on the bus up to `until`, s."""
    scenario = load(SCENARIO, list(settings))
    frames = frames_on_buses(scenario_components(scenario))["can0"]
    return bus_history(scenario, "can0", frames, round(until * 1e12))


def rows(study: str, folder: Path) -> tuple[list[str], dict[str, Run]]:
    """The rows of a study's table, and its runs by case."""
    lines = [
        "| case | worst response of 0x101, 0x102, ms | frames lost | arms apart at most, rad "
        "| settled after, s | effort, N·m·√s |",
        "|---|---|---|---|---|---|",
    ]
    if study == "bus-load":
        lines[0] = lines[0].replace("0x101, 0x102", "the two ξ")
    runs = {}
    for i, (case, settings) in enumerate(cases(study).items()):
        runs[case], n = run(settings, folder / f"{study}-{i}")
        settled = f"{n['settle']:.2f}" if np.isfinite(n["settle"]) else "never"
        lines.append(
            f"| {case} | {1e3 * n['worst']:.2f} | {n['lost']:.0f} | {n['apart']:.2f} "
            f"| {settled} | {n['effort']:.2f} |"
        )
    return lines, runs


def draw_arms(path: Path, runs: Mapping[str, Run], disturbed: tuple[float, float]) -> None:
    """The first coordinate of both arms, a panel for each case."""

    def render() -> bytes:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(9.0, 2.6), dpi=110, layout="constrained")
        axes = figure.subplots(1, len(runs), sharey=True, squeeze=False)[0]
        for ax, (case, done) in zip(axes, runs.items(), strict=True):
            kept = done.t <= SHOWN
            ax.axvspan(*disturbed, color="0.88", lw=0)
            ax.axhline(3.5, color="0.6", lw=0.8, ls="--")
            for name, style in (("master", "-"), ("slave", "--")):
                ax.plot(done.t[kept], done.array(f"{name}.q")[kept, 0], style, label=name)
            ax.set_title(case)
            ax.set_xlabel("t [s]")
        axes[0].set_ylabel("q₁ [rad]")
        axes[0].legend(loc="lower right")
        return png(figure)

    draw_styled(render, path)


def draw_load(path: Path, table: Sequence[str]) -> None:
    """Worst response, settle time and effort against the load of the others."""
    found: dict[str, list[tuple[float, ...]]] = {}
    for line in table[2:]:
        case, worst, _, _, settled, effort = (cell.strip() for cell in line.strip("|").split("|"))
        priority, share = case.split(", ")
        found.setdefault(priority, []).append(
            (100 * float(share) + 10, float(worst), float(settled), float(effort))
        )

    def render() -> bytes:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(9.0, 2.6), dpi=110, layout="constrained")
        axes = figure.subplots(1, 3)
        titles = ("worst response [ms]", "settled after [s]", "effort [N·m·√s]")
        for i, (ax, title) in enumerate(zip(axes, titles, strict=True), 1):
            for (priority, values), style in zip(found.items(), ("o-", "s--"), strict=True):
                ax.plot([v[0] for v in values], [v[i] for v in values], style, label=priority)
            ax.set_title(title)
            ax.set_xlabel("load of the bus [%]")
        axes[0].set_yscale("log")
        axes[0].legend(title="priority of ξ")
        return png(figure)

    draw_styled(render, path)


def page(*, pictures: bool) -> str:
    """The text of the page with new numbers; draws the pictures, too, if asked for."""
    text = PAGE.read_text(encoding="utf-8")
    with TemporaryDirectory() as scratch:
        runs = {}
        for study in ("bus-babbling", "bus-priority", "bus-off", "bus-load"):
            lines, runs[study] = rows(study, Path(scratch))
            begin, end = f"<!-- {study} -->\n", f"<!-- end of {study} -->"
            before, rest = text.split(begin)
            text = before + begin + "\n".join(lines) + "\n" + end + rest.split(end)[1]
            if pictures and study == "bus-load":
                draw_load(PAGE.parent / "bus-load-effect.png", lines)
        if pictures:
            for name, (study, disturbed) in ARMS.items():
                draw_arms(PAGE.parent / name, runs[study], disturbed)
    for name, (study, case, start, length) in FRAMES.items() if pictures else ():
        h = history(cases(study)[case], start + length)
        picos = round(start * 1e12), round((start + length) * 1e12)
        draw_account(PAGE.parent / name, h.names, h.requests, h.events, h.timing, *picos)
    return text


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(pictures="--numbers" not in sys.argv), encoding="utf-8")
    print(PAGE.relative_to(ROOT))


if __name__ == "__main__":
    main()
