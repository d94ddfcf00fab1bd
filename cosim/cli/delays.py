"""``cosim delays``: networks by name, and frozen traces: listed, written and verified."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from cosim.base.random_numbers import generator
from cosim.cli.options import Json, write_json
from cosim.links.frozen import frozen
from cosim.links.laws import FloatArray
from cosim.links.spec import delay_law


def delays(
    name: Annotated[str, typer.Argument(help="Preset or trace to describe.")] = "",
    verify: Annotated[
        bool, typer.Option("--verify", help="Compute every frozen trace, and check its sum.")
    ] = False,
    write: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Write the frozen traces as CSV, with SHA256SUMS."),
    ] = None,
    json: Json = None,
) -> None:
    """List delays by name: presets of networks, and frozen traces with their SHA-256 sums.

    cosim delays from FILE makes a link of a recording (MCAP, rosbag2, pcap, candump, CSV).
    """
    if json is not None:
        write_json(json, "delays", {"delays": _data()})
    if write is not None:
        typer.echo(f"{_write(write)} traces written to {write}")
    elif verify:
        typer.echo(f"{_verify()} traces have their SHA-256 sums")
    elif name:
        typer.echo("\n".join(_described(name)))
    else:
        typer.echo("\n".join(_listing()))


def _data() -> list[dict[str, Any]]:
    """Every preset and frozen trace with its figures, delays in s."""
    from cosim.base.copies import asdict
    from cosim.links.frozen import TRACES
    from cosim.links.presets import PRESETS

    presets = (("preset", n, p.title, figures_of_preset(n)) for n, p in PRESETS.items())
    traces = (("frozen", n, t.title, figures_of_trace(n)) for n, t in TRACES.items())
    return [
        {"law": law, "name": name, "title": title, **asdict(figures)}
        for law, name, title, figures in (*presets, *traces)
    ]


def _verify() -> int:
    """The number of traces; ScenarioError for one that has not its sum."""
    from cosim.links.frozen import TRACES

    for trace in TRACES.values():
        trace.text()
    return len(TRACES)


def _write(folder: Path) -> int:
    from cosim.links.frozen import write_traces

    return write_traces(folder)


_HEAD = ["", "mean", "p50", "p95", "p99", "max", "lost", "burst"]


def _listing() -> list[str]:
    from cosim.cli.show import aligned
    from cosim.links.frozen import TRACES
    from cosim.links.presets import PRESETS

    presets = [
        [n, *_numbers(figures_of_preset(n)), f"{p.title}; {p.source}"] for n, p in PRESETS.items()
    ]
    traces = [
        [n, *_numbers(figures_of_trace(n)), f"{t.title}; sha256 {t.sha256[:16]}…"]
        for n, t in TRACES.items()
    ]
    return [
        'networks, one direction each: delay = { law = "preset", name = "…" }',
        *aligned([[*_HEAD, "what; source"], *presets]),
        "",
        'frozen traces, 120 s, a packet every 5 ms: delay = { law = "frozen", name = "…" }',
        *aligned([[*_HEAD, "what; sum of the CSV text"], *traces]),
        "",
        "delays in ms; lost: % of the packets; burst: mean number of packets lost in a row",
    ]


def _numbers(f: DelayFigures) -> list[str]:
    times = [f"{1e3 * x:.3g}" for x in (f.mean, f.p50, f.p95, f.p99, f.maximum)]
    return [*times, f"{100 * f.lost:.2g}", f"{f.burst:.3g}" if f.lost else "-"]


def _described(name: str) -> list[str]:
    from cosim.base.errors import ScenarioError
    from cosim.base.names import unknown
    from cosim.cli.show import aligned
    from cosim.links.frozen import TRACES
    from cosim.links.presets import PRESETS

    rows = []
    if name in PRESETS:
        p = PRESETS[name]
        rows += [["preset", p.title], ["source", p.source], ["delay", str(dict(p.delay))]]
        rows += [["loss", str(dict(p.loss)) if p.loss else "none"]]
        rows += [["of draws", _said(figures_of_preset(name))]]
    if name in TRACES:
        t = TRACES[name]
        rows += [["frozen trace", t.title], ["sha256", t.sha256]]
        rows += [["of its rows", _said(figures_of_trace(name))]]
    if not rows:
        raise ScenarioError(unknown(name, [*PRESETS, *TRACES], "preset or frozen trace"))
    return [line[2:] for line in aligned(rows)]


def _said(f: DelayFigures) -> str:
    numbers = zip(_HEAD[1:], _numbers(f), strict=True)
    return ", ".join(f"{head} {number}" for head, number in numbers) + " (ms; lost in %)"


#: Packets drawn of a preset, and the time between two of them, s.
DRAWS, PERIOD = 1 << 15, Fraction(5, 1000)


@dataclass(frozen=True, slots=True)
class DelayFigures:
    """Delays of the packets that arrive, s; `lost`: a share; `burst`: packets in a row."""

    mean: float
    p50: float
    p95: float
    p99: float
    maximum: float
    lost: float
    burst: float


def figures_of_preset(name: str, draws: int = DRAWS) -> DelayFigures:
    """Statistics of `draws` packets at 200 per second. Raises ScenarioError if unknown."""
    law = delay_law({"law": "preset", "name": name}, Path())
    return figures(law.stream(PERIOD, generator(0, f"preset {name}")).take(draws))


def figures_of_trace(name: str) -> DelayFigures:
    """Statistics of all rows of a trace. Raises ScenarioError for an unknown name."""
    return figures(frozen(name).trace(lookup="index").delay)


def figures(delays: FloatArray) -> DelayFigures:
    """Statistics of `delays` (n,), s, not finite for lost packets; at least one arrives."""
    arrives = np.isfinite(delays)
    T, lost = delays[arrives], ~arrives
    bursts = int(np.count_nonzero(lost & ~np.concatenate(([False], lost[:-1]))))
    p50, p95, p99 = (float(x) for x in np.quantile(T, (0.5, 0.95, 0.99)))
    return DelayFigures(
        float(T.mean()), p50, p95, p99, float(T.max()), float(lost.mean()),
        float(lost.sum()) / bursts if bursts else 0.0,
    )  # fmt: skip
