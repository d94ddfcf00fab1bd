"""``cosim ping``: measure a path, also one between two nodes of a deployment."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.cli.options import PingDeployment
from bridge.cli.paths.path import EndOptions, PathRequest, WatchOptions
from bridge.ping.predicted import PredictionOptions
from cosim.base.convert import Struct
from cosim.base.copies import replace
from cosim.cli.options import Json, finite

if TYPE_CHECKING:
    from bridge.ping.zenoh import PingedNodes


class QuestionOptions(Struct, frozen=True):
    """The questions of a measurement, and what is written of it."""

    rate: Annotated[
        float, typer.Option(callback=finite, min=0.01, max=20_000, help="Questions a second.")
    ] = 200.0
    size: Annotated[int, typer.Option(min=80, max=65_000, help="Payload, bytes.")] = 128
    duration: Annotated[
        float | None,
        typer.Option(
            callback=finite,
            min=0,
            show_default="10; with --watch 0",
            help="Length, s; 0: until Ctrl-C.",
        ),
    ] = None
    ramp: Annotated[
        bool,
        typer.Option(
            "--ramp", help="Raise --rate until the path breaks, --duration (2 s) at each rate."
        ),
    ] = False
    out: Annotated[Path, typer.Option(help="Folder for traces and report.")] = Path("ping")
    json: Json = None
    deploy: PingDeployment = "zenoh"


class ListeningOptions(Struct, frozen=True):
    """The traffic that is listened to."""

    id_: Annotated[
        str, typer.Option("--id", help="listen can: this identifier only, hexadecimal.")
    ] = ""
    connect: Annotated[
        str, typer.Option(help="listen zenoh: endpoint. Default: tcp/localhost:7447, a router.")
    ] = ""


def ping(
    path: Annotated[
        str,
        typer.Argument(help="udp, zenoh, can or listen; or a scenario file (.toml)."),
    ],
    questions: QuestionOptions,
    watch: WatchOptions,
    end: EndOptions,
    listen: ListeningOptions,
    prediction: PredictionOptions,
    target: Annotated[
        list[str] | None,
        typer.Argument(
            help="udp: HOST[:PORT]; zenoh: endpoint; can: channel; several are measured at once. "
            "Scenario: the node that asks and the one that answers. The other end: cosim pong."
        ),
    ] = None,
) -> None:
    """Measure delays of a network each way and by parts; predict the effect on controllers.

    cosim ping udp HOST and cosim ping zenoh ENDPOINT need no scenario, only cosim pong at the other
    end, and cosim ping can CHANNEL that or a drive. cosim ping listen can CHANNEL and cosim ping
    listen zenoh KEY only listen, also to ROS 2 topics of rmw_zenoh. cosim ping SCENARIO measures
    between two nodes of a deployment, as these nodes, and predicts what the scenario does there.
    """
    usual = 2.0 if questions.ramp else 0.0 if watch.every else 10.0
    length, out = usual if questions.duration is None else questions.duration, questions.out
    words, nodes = target or [], None
    if path == "listen":
        from bridge.cli.paths.listen import ping_listen

        ping_listen(
            words, identifier=listen.id_, connect=listen.connect, duration=length,
            json=questions.json, end=end,
        )  # fmt: skip
        return
    if path.endswith(".toml"):
        nodes = _nodes(Path(path), questions.deploy, words, prediction.settings)
        prediction = replace(
            prediction,
            scenario=prediction.scenario or (None if questions.ramp else Path(path)),
            settings=[text for text in prediction.settings if not text.startswith("deploy.")],
        )
        path, words = "zenoh", []
    common = PathRequest(
        path, "", questions.rate, questions.size, length, out, end, prediction, watch, nodes
    )
    _paths(path, words, common, json=questions.json, ramp=questions.ramp)


def _paths(
    kind: str, target: list[str], common: PathRequest, *, json: Path | None, ramp: bool
) -> None:
    """One path, several of them, or one at rising rates."""
    from bridge.cli.paths.path import ping_path, requests
    from cosim.base.errors import ScenarioError

    found = requests(kind, target, common)
    if ramp:
        from bridge.cli.paths.several import ping_ramp

        if (
            len(found) > 1
            or not common.duration
            or common.watch.every
            or common.prediction.scenario
        ):
            raise ScenarioError(
                "found --ramp with several paths, --duration 0, --watch or --scenario; expected "
                "one path and a length of each rate",
                "cosim ping",
            )
        ping_ramp(found[0], json)
    elif len(found) == 1:
        ping_path(found[0], json)
    else:
        from bridge.cli.paths.several import ping_several

        ping_several(found, json)


def _nodes(scenario: Path, deploy: str, target: list[str], settings: list[str]) -> PingedNodes:
    """The two nodes of a deployment, ``[ASKING [ANSWERING]]``."""
    from bridge.deployment.system import load_system
    from bridge.ping.zenoh import pinged_nodes
    from cosim.base.errors import ScenarioError

    if len(target) > 2:
        raise ScenarioError(
            f"found {' '.join(target)!r}; expected at most two nodes, the one that asks and the "
            "one that answers",
            "cosim ping",
        )
    return pinged_nodes(load_system(scenario, deploy, settings), *target)
