"""``cosim ping`` of several paths at once, then one table; or of one path at several rates."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import typer

from bridge.cli.paths.path import PathOutcome, PathRequest, end_live_line, measured, open_path
from bridge.ping.exchanges import Exchanges
from bridge.ping.figures import PathResult, evaluate
from bridge.ping.measure import measure
from bridge.ping.ramp import HEADING, RampStep, ramp
from cosim.base.clock import monotonic_ns
from cosim.base.copies import asdict, replace
from cosim.base.errors import CosimError, RunError
from cosim.base.interrupts import acknowledge, act_on_signal
from cosim.base.processes import leave_signals_to_parent
from cosim.cli.options import write_json

#: Set in the process of a path: ends the measurement.
_stop: list[Event] = []


@dataclass(frozen=True, slots=True)
class FailedPath:
    """The reason why a path could not be measured."""

    reason: str


def ping_several(requests: Sequence[PathRequest], json: Path | None) -> None:
    """Measure paths at the same time, each written to its own folder; print them side by side.

    Ctrl-C ends all of them with their results. Raises RunError if one could not be measured, after
    the others; exits with 1 after an alarm.
    """
    found = _measured(requests)
    done = {name: f for name, f in found.items() if isinstance(f, PathOutcome)}
    failed = [f.reason for f in found.values() if isinstance(f, FailedPath)]
    for line in table({name: f.data for name, f in done.items()}):
        typer.echo(line)
    for request in requests:
        if request.name in done:
            typer.echo(f"report: {request.out / 'report.html'}")
    if json is not None:
        write_json(json, "ping", {"paths": {name: f.data for name, f in done.items()}})
    if failed:
        raise RunError("; ".join(failed))
    if any(f.sounded for f in done.values()):
        raise typer.Exit(1)


def _measured(requests: Sequence[PathRequest]) -> dict[str, PathOutcome | FailedPath]:
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    start = monotonic_ns()
    with ProcessPoolExecutor(len(requests), context, _prepare, (stop,)) as pool:
        waiting = {request.name: pool.submit(_one, request) for request in requests}
        try:
            while wait(waiting.values(), timeout=0.5).not_done:
                act_on_signal()
                _live(waiting, requests[0].duration, (monotonic_ns() - start) * 1e-9)
        except KeyboardInterrupt:
            acknowledge()
            stop.set()
        finally:
            end_live_line()
        return {name: future.result() for name, future in waiting.items()}


def _prepare(stop: Event) -> None:
    """In the process of a path: Ctrl-C is for the one that waits, which says when to stop."""
    leave_signals_to_parent()
    _stop.append(stop)


def _one(request: PathRequest) -> PathOutcome | FailedPath:
    """Measure in this process."""

    def say(line: str) -> None:
        typer.echo(f"{request.name}: {line}", err=True)

    try:
        return measured(request, say, _until_stopped, lambda _: None)
    except CosimError as error:
        said = str(error)
        return FailedPath(said if request.name in said else f"{request.name}: {said}")


def _until_stopped(_: Exchanges) -> None:
    if _stop[0].is_set():
        raise KeyboardInterrupt


def table(found: dict[str, dict[str, Any]]) -> list[str]:
    """Paths side by side, by their values for JSON: delays in ms, losses in %."""
    width = max(map(len, [*found, "path"]))
    heads = ("min", "p50", "p95", "p99", "p99.9", "max", "jitter")
    columns = "".join(f"{head:>10}" for head in heads)
    lines = [f"{'round trip, ms':<{width}}{columns}{'lost':>9}{'sent':>9}"]
    for name, data in found.items():
        delays = data["delays"]["round trip"]
        cells = "".join(f"{1e3 * delays[head]:10.3f}" for head in heads)
        lines.append(f"{name:<{width}}{cells}{data['loss']['share']:9.3%}{data['sent']:9}")
    for name, data in found.items():
        ways = data["delays"]
        if "there" in ways:
            there, back = (ways[w] for w in ("there", "back"))
            lines.append(
                f"{name}: there p50 {1e3 * there['p50']:.3f} p99 {1e3 * there['p99']:.3f} ms, back "
                f"p50 {1e3 * back['p50']:.3f} p99 {1e3 * back['p99']:.3f} ms, to within "
                f"{1e3 * data['uncertainty']:.3f} ms"
            )
    return lines


def _live(
    waiting: dict[str, Future[PathOutcome | FailedPath]], duration: float, seconds: float
) -> None:
    if sys.stderr.isatty():
        of = f" of {duration:g}" if duration else ""
        done = sum(future.done() for future in waiting.values())
        sys.stderr.write(
            f"\r\033[K{len(waiting)} paths, {seconds:.0f}{of} s, {done} done; Ctrl-C ends them"
        )
        sys.stderr.flush()


def ping_ramp(request: PathRequest, json: Path | None) -> None:
    """Measure a path at rising rates from that of `request`, and print at which it breaks.

    Each rate takes as long as `request` says, s. Raises RunError where nothing answers.
    """

    def at(rate: float) -> PathResult:
        """On a path of its own, so that late answers of another rate are not taken for its."""
        plan = replace(request, rate=rate).plan
        path = open_path(request)
        record = Exchanges(path.name, plan.count or 1, path.size, plan.period_ns)
        with path.opened as opened:
            measure(opened, path.codec, plan, record)
        return evaluate(record)

    def tell(step: RampStep) -> None:
        typer.echo(step.text)

    typer.echo(HEADING)
    found = ramp(at, request.rate, tell)
    typer.echo(f"{request.name}: {found.text(request.size)}")
    if json is not None:
        write_json(json, "ping", asdict(found))
