"""``cosim ping --ramp``: beyond which rate a path breaks."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import typer

from bridge.cli.ping_path import PathRequest, open_path
from bridge.ping.exchanges import Exchanges
from bridge.ping.figures import PathResult, evaluate
from bridge.ping.measure import measure
from bridge.ping.ramp import HEADING, RampStep, ramp


def ping_ramp(request: PathRequest, *, json_: bool) -> None:
    """Measure a path at rising rates from that of `request`, and print at which it breaks.

    Each rate takes as long as `request` says, s. Raises RunError where nothing answers.
    """

    def measured(rate: float) -> PathResult:
        """On a path of its own, so that late answers of another rate are not taken for its."""
        plan = replace(request, rate=rate).plan
        path = open_path(request)
        record = Exchanges(path.name, plan.count or 1, path.size, plan.period_ns)
        with path.opened as opened:
            measure(opened, path.codec, plan, record)
        return evaluate(record)

    def tell(step: RampStep) -> None:
        if not json_:
            typer.echo(step.text)

    if not json_:
        typer.echo(HEADING)
    found = ramp(measured, request.rate, tell)
    if json_:
        typer.echo(json.dumps(asdict(found), indent=1))
    else:
        typer.echo(f"{request.name}: {found.text(request.size)}")
