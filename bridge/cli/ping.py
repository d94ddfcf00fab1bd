"""``cosim ping``: measure a path, also one between two nodes of a deployment."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.cli.options import (
    CanBitrate,
    CanInterface,
    PingDeployment,
    PingSettings,
    ZenohConfig,
)
from cosim.cli.options import finite

if TYPE_CHECKING:
    from bridge.cli.ping_path import EndOptions, PathRequest


def ping(
    path: Annotated[
        str,
        typer.Argument(help="udp, zenoh, can or listen; or a scenario file (.toml)."),
    ],
    target: Annotated[
        list[str] | None,
        typer.Argument(
            help="udp: HOST[:PORT]; zenoh: endpoint; can: channel; several are measured at once. "
            "Scenario: the node that asks and the one that answers. The other end: cosim pong."
        ),
    ] = None,
    rate: Annotated[
        float, typer.Option(callback=finite, min=0.01, max=20_000, help="Questions a second.")
    ] = 200.0,
    size: Annotated[int, typer.Option(min=80, max=65_000, help="Payload, bytes.")] = 128,
    duration: Annotated[
        float | None,
        typer.Option(
            callback=finite,
            min=0,
            show_default="10; with --watch 0",
            help="Length, s; 0: until Ctrl-C.",
        ),
    ] = None,
    watch: Annotated[
        float,
        typer.Option(
            callback=finite,
            min=0,
            show_default="none",
            help="Print a line for every window of this length, s, and append it to watch.jsonl.",
        ),
    ] = 0.0,
    alarm: Annotated[
        list[str] | None,
        typer.Option(
            metavar="'p99 > 20 ms'",
            help="With --watch: tell when a window is beyond this, and exit with 1 in the end.",
        ),
    ] = None,
    ramp: Annotated[
        bool,
        typer.Option(
            "--ramp", help="Raise --rate until the path breaks, --duration (2 s) at each rate."
        ),
    ] = False,
    tos: Annotated[
        int, typer.Option(min=0, max=255, help="udp: byte of service of IPv4 (DSCP * 4).")
    ] = 0,
    config: ZenohConfig = None,
    interface: CanInterface = "socketcan",
    bitrate: CanBitrate = None,
    ask: Annotated[
        str, typer.Option(metavar="ID#DATA", help="can: frame that a drive answers; ID#R: remote.")
    ] = "",
    answer: Annotated[
        str, typer.Option(metavar="ID", help="can: identifier of the drive's answer.")
    ] = "",
    id_: Annotated[
        str, typer.Option("--id", help="listen can: this identifier only, hexadecimal.")
    ] = "",
    connect: Annotated[
        str, typer.Option(help="listen zenoh: endpoint. Default: tcp/localhost:7447, a router.")
    ] = "",
    json_: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
    scenario: Annotated[
        Path | None, typer.Option(help="Predict: run this scenario (.toml) with these delays.")
    ] = None,
    link: Annotated[
        str, typer.Option(help="Predict with this link (FROM->TO) only. Default: all links.")
    ] = "",
    compare: Annotated[
        bool, typer.Option("--compare", help="Predict for the controllers of cosim compare, too.")
    ] = False,
    deploy: PingDeployment = "zenoh",
    out: Annotated[Path, typer.Option(help="Folder for traces and report.")] = Path("ping"),
    set_: PingSettings = None,
) -> None:
    """Measure delays of a network each way and by parts; predict the effect on controllers.

    cosim ping udp HOST and cosim ping zenoh ENDPOINT need no scenario, only cosim pong at the other
    end, and cosim ping can CHANNEL that or a drive. cosim ping listen can CHANNEL and cosim ping
    listen zenoh KEY only listen, also to ROS 2 topics of rmw_zenoh. cosim ping SCENARIO measures
    between two nodes of a deployment, as these nodes, and predicts what the scenario does there.
    """
    from bridge.cli.ping_path import EndOptions, PathRequest, PredictionOptions, WatchOptions

    usual = 2.0 if ramp else 0.0 if watch else 10.0
    length = usual if duration is None else duration
    end, target = EndOptions(tos, config, interface, bitrate, ask, answer), target or []
    if path == "listen":
        from bridge.cli.ping_listen import ping_listen

        ping_listen(target, identifier=id_, connect=connect, duration=length, json_=json_, end=end)
        return
    settings = [*(set_ or ())]
    if path.endswith(".toml"):
        end = _deployed(Path(path), deploy, target, settings, end)
        scenario = scenario or (None if ramp else Path(path))
        settings = [text for text in settings if not text.startswith("deploy.")]
        path, target = "zenoh", []
    common = PathRequest(
        path, "", rate, size, length, out, end,
        PredictionOptions(scenario, link, compare, tuple(settings)),
        WatchOptions(watch, tuple(alarm or ())),
    )  # fmt: skip
    _paths(path, target, common, json_=json_, ramp=ramp)


def _paths(kind: str, target: list[str], common: PathRequest, *, json_: bool, ramp: bool) -> None:
    """One path, several of them, or one at rising rates."""
    from bridge.cli.ping_path import ping_path, requests
    from cosim.base.errors import ScenarioError

    found = requests(kind, target, common)
    if ramp:
        from bridge.cli.ping_ramp import ping_ramp

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
        ping_ramp(found[0], json_=json_)
    elif len(found) == 1:
        ping_path(found[0], json_=json_)
    else:
        from bridge.cli.ping_several import ping_several

        ping_several(found, json_=json_)


def _deployed(
    scenario: Path, deploy: str, target: list[str], settings: list[str], end: EndOptions
) -> EndOptions:
    """Our end of the path between two nodes of a deployment, ``[ASKING [ANSWERING]]``."""
    from bridge.deployment.system import load_system
    from bridge.ping.zenoh import pinged_nodes
    from cosim.base.errors import ScenarioError

    if len(target) > 2:
        raise ScenarioError(
            f"found {' '.join(target)!r}; expected at most two nodes, the one that asks and the "
            "one that answers", "cosim ping",
        )  # fmt: skip
    return replace(end, nodes=pinged_nodes(load_system(scenario, deploy, settings), *target))
