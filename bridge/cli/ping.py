"""``cosim ping``: measure a path, or a network with the messages of a deployment."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.cli.options import CanBitrate, CanInterface, ZenohConfig
from cosim.cli.numbers import finite

if TYPE_CHECKING:
    from bridge.cli.ping_path import PathRequest
    from bridge.deployment.system import System
    from bridge.zenoh.ping import Floats, PingResult


def ping(
    path: Annotated[
        str,
        typer.Argument(help="udp, zenoh, can or listen; or a scenario file (.toml)."),
    ],
    target: Annotated[
        list[str] | None,
        typer.Argument(
            help="udp: HOST[:PORT]; zenoh: endpoint; can: channel; several are measured at once. "
            "The other end: cosim pong."
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
    deploy: Annotated[
        str, typer.Option("--deploy", help="Of a scenario: deployment, file or name.")
    ] = "zenoh",
    as_: Annotated[
        str, typer.Option("--as", help="Node that sends the pings. Default: the first.")
    ] = "",
    to: Annotated[str, typer.Option("--to", help="Node that answers. Default: the next one.")] = "",
    echo: Annotated[
        bool, typer.Option("--echo", help="Only answer, as the node --to, until Ctrl-C.")
    ] = False,
    local: Annotated[
        bool, typer.Option("--local", help="Answer in this process, too; both ends run here.")
    ] = False,
    count: Annotated[int, typer.Option(min=10, help="Number of pings between nodes.")] = 2000,
    period: Annotated[
        float,
        typer.Option(callback=finite, min=0.0005, help="Time between two pings of nodes, s."),
    ] = 0.005,
    out: Annotated[Path, typer.Option(help="Folder for traces and report.")] = Path("ping"),
    predict: Annotated[
        bool,
        typer.Option(
            "--predict/--no-predict", help="Simulate the scenario with the measured delays."
        ),
    ] = True,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Change a value.")
    ] = None,
) -> None:
    """Measure delays of a network each way and by parts; predict the effect on controllers.

    cosim ping udp HOST and cosim ping zenoh ENDPOINT need no scenario, only cosim pong at the other
    end, and cosim ping can CHANNEL that or a drive. cosim ping listen can CHANNEL and cosim ping
    listen zenoh KEY only listen, also to ROS 2 topics of rmw_zenoh. cosim ping SCENARIO measures
    with the messages of a deployment between two of its nodes.
    """
    if not path.endswith(".toml"):
        from bridge.cli.ping_path import EndOptions, PathRequest, PredictionOptions, WatchOptions

        usual = 2.0 if ramp else 0.0 if watch else 10.0
        length = usual if duration is None else duration
        end = EndOptions(tos, config, interface, bitrate, ask, answer)
        if path == "listen":
            from bridge.cli.ping_listen import ping_listen

            ping_listen(
                target or [], identifier=id_, connect=connect, duration=length, json_=json_,
                end=end,
            )  # fmt: skip
            return
        common = PathRequest(
            path, "", rate, size, length, out, end,
            PredictionOptions(scenario, link, compare, tuple(set_ or ())),
            WatchOptions(watch, tuple(alarm or ())),
        )  # fmt: skip
        _paths(path, target or [], common, json_=json_, ramp=ramp)
        return
    _nodes(Path(path), deploy, as_, to, echo, local, count, period, out, predict, set_ or [])


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


def _nodes(
    scenario: Path, deploy: str, as_: str, to: str, echo: bool, local: bool, count: int,
    period: float, out: Path, predict: bool, settings: list[str],
) -> None:  # fmt: skip
    """Round trips between two nodes of a deployment."""
    from bridge.deployment.system import load_system
    from bridge.zenoh import ping as measuring

    system = load_system(scenario, deploy, settings)
    bus = _bus(system)
    here, there = _pair(system, bus, as_, to)
    if echo:
        _echo(system, bus, there, here)
        return
    with _Ends(system, bus, here, there, local=local) as ends:
        found = measuring.ping(
            ends.session, ends.names, here, there, n=count, period=period,
            reliability=ends.reliability,
        )  # fmt: skip
    for line in lines(found):
        typer.echo(line)
    paths = _traces(found, out, here, there)
    if predict:
        _predict(system, scenario, here, found, paths, settings, out)


def _traces(found: PingResult, out: Path, here: str, there: str) -> list[Path]:
    """Both ways, as files."""
    from cosim.links.traces import write_trace

    out.mkdir(parents=True, exist_ok=True)
    paths = [out / f"{here}-{there}.csv", out / f"{there}-{here}.csv"]
    for path, delay in zip(paths, (found.there, found.back), strict=True):
        write_trace(path, found.sent, delay)
        typer.echo(f"trace: {path}")
    return paths


def _bus(system: System) -> str:
    from cosim.base.errors import ScenarioError

    for name, bus in system.deployment.buses.items():
        if bus.kind == "zenoh":
            return name
    raise ScenarioError(
        "no Zenoh bus to measure; CAN buses are analysed by cosim check",
        system.deployment.place("buses"),
    )


def _pair(system: System, bus: str, here: str, there: str) -> tuple[str, str]:
    from cosim.base.errors import ScenarioError

    nodes = [n for n in system.deployment.nodes if bus in system.buses_of(n)]
    for name in (here, there):
        if name and name not in nodes:
            raise ScenarioError(f"no node {name!r} on {bus}; there are: {', '.join(nodes)}")
    first = here or next(n for n in nodes if n != there)
    return first, there or next(n for n in nodes if n != first)


class _Ends:
    """The session of the pinging node, with an echo in this process if `local`."""

    def __init__(self, system: System, bus: str, here: str, there: str, *, local: bool) -> None:
        from bridge.deployment.zenoh_keys import names_of
        from bridge.zenoh.node_channel import rules_of
        from bridge.zenoh.options import options_of
        from bridge.zenoh.session import configure, open_session

        d, rules = system.deployment, rules_of(system, bus)
        self.names = names_of(d, bus)
        options = options_of(d, bus, here)
        self.reliability = options.reliability
        self.session = open_session(configure(options, here, rules), bus)
        self._other = None
        if local:
            from bridge.zenoh.ping import Echo

            far = options_of(d, bus, there)
            self._other = open_session(configure(far, there, rules), bus)
            self._echo = Echo(self._other, self.names, there, here, far.reliability)

    def __enter__(self) -> _Ends:
        return self

    def __exit__(self, *_: object) -> None:
        from bridge.zenoh.session import close_session

        for session in (self._other, self.session):
            if session is not None:
                close_session(session)


def _echo(system: System, bus: str, node: str, other: str) -> None:
    from bridge.zenoh.ping import Echo
    from cosim.base.clock import sleep
    from cosim.base.interrupts import until_signal

    with _Ends(system, bus, node, other, local=False) as ends:
        Echo(ends.session, ends.names, node, other, ends.reliability)
        typer.echo(f"{node} answers {other}; Ctrl-C ends it", err=True)
        with until_signal():
            while True:
                sleep(1.0)


def lines(found: PingResult) -> list[str]:
    """The measured values, a line each."""
    shown = [f"{len(found.sent)} pings, {found.loss:.2%} lost, jitter {found.jitter * 1e3:.3f} ms"]
    for label, values in (("round trip", found.rtt), ("there", found.there), ("back", found.back)):
        shown.append(f"{label:<12} {_quantiles(values)}")
    shown.append(f"the other clock is {found.offset * 1e3:+.3f} ms from this one")
    return [*shown, *histogram(found.rtt)]


def _quantiles(values: Floats) -> str:
    import numpy as np

    found = np.nanpercentile(values, [0, 50, 99, 99.9, 100]) * 1e3
    labels = ("min", "p50", "p99", "p99.9", "max")
    return "  ".join(f"{n} {v:.3f}" for n, v in zip(labels, found, strict=True)) + " ms"


def histogram(values: Floats, bins: int = 12, width: int = 40) -> list[str]:
    """Return text bars of the numbers of `values` (n,), s, in bins of a logarithmic axis."""
    import numpy as np

    there = values[~np.isnan(values)] * 1e3
    low, high = max(there.min(), 1e-3), max(there.max(), 1.1e-3)
    counts, edges = np.histogram(there, np.geomspace(low * 0.999, high * 1.001, bins + 1))
    most = max(int(counts.max()), 1)
    return [
        f"{edges[i]:9.3f} ms {'#' * round(width * n / most):<{width}} {n}"
        for i, n in enumerate(counts)
    ]


def _predict(
    system: System,
    scenario: Path,
    here: str,
    found: PingResult,
    paths: list[Path],
    settings: list[str],
    out: Path,
) -> None:
    """Felt damping and stiffness, and the scenario offline with the delays its links would have."""
    from bridge.cli.options import unused_folder
    from cosim.checks.laws import prediction
    from cosim.cli.summary import summary
    from cosim.engine.simulate import simulate
    from cosim.loading.files import load
    from cosim.predict.system import system as with_facts
    from cosim.record import Run
    from cosim.scenario.assemble import assemble

    ours = [s for s in settings if not s.startswith("deploy.")]
    added = links_with_laws(system, here, found, out) if system.deployment.latency else None
    traced = [*system.deployment.settings(), *ours, *(added or links(system, here, paths))]
    loaded = load(scenario, traced)
    typer.echo("on this network:")
    for finding in prediction(with_facts(loaded, assemble(loaded))):
        typer.echo(f"  {finding.where}: {finding.reason}")
    folder = unused_folder(out / "run")
    outcome = simulate(loaded, folder)
    for line in summary(loaded, Run.open(folder), outcome):
        typer.echo(f"  {line}")


def links(system: System, here: str, paths: list[Path]) -> list[str]:
    """Settings that give every link between nodes the measured delay: `paths` there and back."""
    homes = {c: n for n, spec in system.deployment.nodes.items() for c in spec.components}
    said: list[str] = []
    for i, link in enumerate(system.scenario.links):
        sender = homes[link.source.partition(".")[0]]
        receiver = homes[link.target.partition(".")[0]]
        if sender == receiver:
            continue
        path = paths[0] if sender == here else paths[1]
        delay = f'{{law="trace", file="{path.resolve()}", repeat=true}}'
        said += [f"links.{i}.delay={delay}", f'links.{i}.semantics="last-arrival"']
    return said


def links_with_laws(system: System, here: str, found: PingResult, out: Path) -> list[str]:
    """Settings for ``latency = true``: the law of each link between nodes, and the network on top.

    A trace each, in the folder `out`: what the law draws, plus what was measured, repeated.
    """
    from bridge.deployment.latency import network_delays
    from cosim.links.traces import write_trace

    homes = {c: n for n, spec in system.deployment.nodes.items() for c in spec.components}
    plans = {link.name: link for link in system.plan.links}
    said: list[str] = []
    for i, link in enumerate(system.scenario.links):
        sender = homes[link.source.partition(".")[0]]
        if sender == homes[link.target.partition(".")[0]]:
            continue
        measured = found.there if sender == here else found.back
        planned = plans[f"{link.source}->{link.target}"]
        path = out / f"link{i}.csv"
        write_trace(path, *network_delays(planned, system.plan.ticks, found.sent, measured))
        said.append(f'links.{i}.delay={{law="trace", file="{path.resolve()}"}}')
    return said
