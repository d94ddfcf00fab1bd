"""The options and the lines of a prediction, for all commands that predict for a path."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cosim.base.convert import Struct, field
from cosim.base.copies import asdict

if TYPE_CHECKING:
    from bridge.ping.prediction import PathTrace
    from bridge.ping.zenoh import PingedNodes


class PredictionOptions(Struct, frozen=True):
    """The options of a prediction; nothing is predicted without a `scenario`."""

    scenario: Annotated[
        Path | None, typer.Option(help="Predict: run this scenario (.toml) with these delays.")
    ] = None
    link: Annotated[
        str, typer.Option(help="Predict with this link (FROM->TO) only. Default: all links.")
    ] = ""
    compare: Annotated[
        bool, typer.Option("--compare", help="Predict for the controllers of cosim compare, too.")
    ] = False
    settings: Annotated[
        list[str], typer.Option("--set", metavar="PATH=VALUE", help="Change a value.")
    ] = field(default_factory=list)

    def lacking(self, command: str) -> None:
        """Raise ScenarioError if an option needs a scenario that is not given."""
        from cosim.base.errors import ScenarioError

        if (self.link or self.compare) and self.scenario is None:
            raise ScenarioError("found --link or --compare; expected --scenario FILE", command)


@dataclass(frozen=True, slots=True)
class ShownPrediction:
    """A prediction: `data` for JSON; `scenario` and `controllers` in lines."""

    data: dict[str, Any] | None = None
    scenario: tuple[str, ...] = ()
    controllers: tuple[str, ...] = ()

    def text(self, wanted: PredictionOptions, out: Path) -> list[str]:
        """All in lines, with headings."""
        lines = []
        if self.scenario:
            lines += [f"{wanted.scenario} on this path:", *(f"  {x}" for x in self.scenario)]
        if self.controllers:
            lines += [
                "controllers of cosim compare on this path, with every operator:",
                *(f"  {x}" for x in self.controllers),
                f"in numbers: cosim compare {wanted.scenario} --variants {out}/compare.toml "
                "--links measured",
            ]
        return lines


def predicted_on(
    wanted: PredictionOptions, trace: PathTrace, out: Path, nodes: PingedNodes | None = None
) -> ShownPrediction:
    """The scenario on a path, and the controllers that come to rest on it; `out`: folder of files.

    Raises ScenarioError.
    """
    if wanted.scenario is None:
        return ShownPrediction()
    from bridge.ping.prediction import predict, survivors
    from cosim.comparison.variants_file import variants_path

    found = predict(wanted.scenario, trace, wanted.link, wanted.settings, nodes)
    data = asdict(found)
    for number in data["numbers"]:
        for key in ("value", "least", "most", "ideal"):
            number[key] = number[key] if isfinite(number[key]) else None
    if not wanted.compare:
        return ShownPrediction(data, tuple(found.lines()))
    variants = variants_path(wanted.scenario)
    each = survivors(wanted.scenario, variants, trace, out, wanted.settings, jobs=2)
    data["controllers"] = {one.name: dict(one.verdicts) for one in each}
    return ShownPrediction(data, tuple(found.lines()), tuple(one.text for one in each))
