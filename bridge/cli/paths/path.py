"""``cosim ping udp`` and the other paths: measure, print, keep the trace."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from textwrap import indent
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bridge.ping.predicted import PredictionOptions
from cosim.base.convert import Struct, field
from cosim.base.copies import replace
from cosim.cli.options import finite, write_json

if TYPE_CHECKING:
    from bridge.can.interface import CanBusSpec
    from bridge.ping.exchanges import Exchanges, PingCodec, PingPath
    from bridge.ping.figures import PathResult
    from bridge.ping.measure import PingPlan
    from bridge.ping.prediction import PathTrace
    from bridge.ping.zenoh import PingedNodes
    from cosim.base.errors import ScenarioError

PATHS = ("udp", "zenoh", "can")


class LineOptions(Struct, frozen=True):
    """The options of both ends of a path: Zenoh's configuration, and CAN's bus."""

    config: Annotated[
        Path | None, typer.Option(help="zenoh: session configuration (JSON5), for TLS.")
    ] = None
    interface: Annotated[
        str, typer.Option("--interface", "-i", help="can: interface of python-can.")
    ] = "socketcan"
    bitrate: Annotated[
        float | None, typer.Option(callback=finite, min=1, help="can: bit rate, bit/s.")
    ] = None


class EndOptions(LineOptions, frozen=True):
    """The options of our end of a path, with UDP's service, and the frames of a drive on CAN."""

    tos: Annotated[
        int, typer.Option(min=0, max=255, help="udp: byte of service of IPv4 (DSCP * 4).")
    ] = 0
    ask: Annotated[
        str, typer.Option(metavar="ID#DATA", help="can: frame that a drive answers; ID#R: remote.")
    ] = ""
    answer: Annotated[
        str, typer.Option(metavar="ID", help="can: identifier of the drive's answer.")
    ] = ""


class OpenedPath(Struct, frozen=True):
    """A path that is about to be opened: `name`, how to open and to read it, payload in bytes.

    `below`: lines of its own, of the result.
    """

    name: str
    opened: AbstractContextManager[PingPath]
    codec: PingCodec
    size: int
    below: Callable[[PathResult], list[str]] = lambda _: []


class WatchOptions(Struct, frozen=True):
    """Windows of `every` s with `alarms` (``p99 > 20 ms``); 0: no windows."""

    every: Annotated[
        float,
        typer.Option(
            "--watch",
            callback=finite,
            min=0,
            show_default="none",
            help="Print a line for every window of this length, s, and append it to watch.jsonl.",
        ),
    ] = 0.0
    alarms: Annotated[
        list[str],
        typer.Option(
            "--alarm",
            metavar="'p99 > 20 ms'",
            help="With --watch: tell when a window is beyond this, and exit with 1 in the end.",
        ),
    ] = field(default_factory=list)


class PathRequest(Struct, frozen=True):
    """A path and how to measure it: `kind` and `where`, questions a second, bytes, s (0: until
    Ctrl-C), the folder for traces and report.

    `nodes`: of a deployment, between which a path over Zenoh is.
    """

    kind: str
    where: str
    rate: float
    size: int
    duration: float
    out: Path
    end: EndOptions = EndOptions()
    prediction: PredictionOptions = field(default_factory=PredictionOptions)
    watch: WatchOptions = field(default_factory=WatchOptions)
    nodes: PingedNodes | None = None

    @property
    def name(self) -> str:
        """In words, as it is given."""
        return f"{self.kind} {self.where}".strip()

    @property
    def plan(self) -> PingPlan:
        """The plan of its questions."""
        from bridge.ping.measure import PingPlan

        count = max(1, round(self.rate * self.duration)) if self.duration else None
        return PingPlan(round(1e9 / self.rate), count)


class PathOutcome(Struct, frozen=True):
    """The outcome of a measurement: `data` for JSON, and the alarms that sounded."""

    data: dict[str, Any]
    sounded: list[str]


Say = Callable[[str], None]
Show = Callable[["Exchanges"], None]


def requests(kind: str, target: Sequence[str], common: PathRequest) -> list[PathRequest]:
    """One for each path of the command line: ``udp HOST HOST can CHANNEL``. A kind begins another
    group of targets. Several paths get folders of their own in that of `common`.

    Raises ScenarioError for what is no path.
    """
    from cosim.base.errors import ScenarioError

    found: list[tuple[str, str]] = []
    if kind not in PATHS:
        raise _no_path([kind, *target])
    open_kind = kind  # one that has no target yet
    for word in target:
        if word in PATHS:
            if open_kind:
                found.append((open_kind, ""))
            kind = open_kind = word
        else:
            found.append((kind, word))
            open_kind = ""
    if open_kind:
        found.append((open_kind, ""))
    if any(not where and k != "zenoh" for k, where in found) or len(set(found)) < len(found):
        raise _no_path([found[0][0], *target])
    prediction, watch = common.prediction, common.watch
    prediction.lacking("cosim ping")
    if watch.alarms and not watch.every:
        raise ScenarioError("found --alarm; expected --watch SECONDS with it", "cosim ping")
    folders = [common.out / re.sub(r"[^\w.-]+", "-", f"{k} {where}".strip()) for k, where in found]
    if len(found) == 1:
        folders = [common.out]
    return [
        replace(common, kind=k, where=where, out=folder)
        for (k, where), folder in zip(found, folders, strict=True)
    ]


def _no_path(words: Sequence[str]) -> ScenarioError:
    from cosim.base.errors import ScenarioError

    return ScenarioError(
        f"found {' '.join(words)!r}; expected udp HOST[:PORT], zenoh [ENDPOINT] or can CHANNEL, "
        "several of them, each once; or listen, or a scenario file (.toml)",
        "cosim ping",
    )


def ping_path(request: PathRequest, json: Path | None) -> None:
    """Measure one path, print its figures, and write its traces and a report.

    Raises RunError or BusError where nothing answers; exits with 1 after an alarm.
    """

    def say(line: str) -> None:
        end_live_line()
        typer.echo(line)

    found = measured(request, say, _live, typer.echo)
    if json is not None:
        write_json(json, "ping", found.data)
    if found.sounded:
        raise typer.Exit(1)


def measured(request: PathRequest, say: Say, live: Show, tell: Say) -> PathOutcome:
    """Measure a path, and write its traces and a report.

    `say` is given lines while it is measured, `live` the state now and then, `tell` the lines of
    the result as they are known. Raises RunError or BusError where nothing answers.
    """
    from bridge.ping.exchanges import CAPACITY, Exchanges
    from bridge.ping.figures import evaluate
    from bridge.ping.page import PingNotes, write_ping_page
    from bridge.ping.predicted import predicted_on
    from bridge.ping.report import text, values

    plan, out = request.plan, request.out
    path = open_path(request)
    capacity = CAPACITY if plan.count is None else plan.count
    record = Exchanges(path.name, capacity, path.size, plan.period_ns)
    sounded = _watched(path, plan, record, request, say, live)
    result = evaluate(record)
    link = _links(request.kind, result, out)
    below = path.below(result)
    for line in [*text(result), *below]:
        tell(line)
    for name, lines in link.items():
        tell(f"{name}, as a link:")
        tell(indent("\n".join(lines.values()), "  "))
    trace = _path_trace(request.kind, result)
    predicted = predicted_on(request.prediction, trace, out, request.nodes)
    notes = PingNotes(link, _command(), below, predicted.scenario, predicted.controllers)
    page = write_ping_page(out / "report.html", result, notes)
    for line in predicted.text(request.prediction, out):
        tell(line)
    tell(f"report: {page}")
    return PathOutcome(
        {**values(result), "links": link, "prediction": predicted.data, "alarms": sounded}, sounded
    )


def _watched(
    path: OpenedPath, plan: PingPlan, record: Exchanges, request: PathRequest, say: Say, live: Show
) -> list[str]:
    """Measure, in windows if they are wanted; which alarms sounded."""
    from bridge.ping.measure import measure

    wanted = request.watch
    if not wanted.every:
        with path.opened as opened:
            measure(opened, path.codec, plan, record, live)
        end_live_line()
        return []
    from bridge.ping.watch import PingAlarm, PingWatch, append

    alarms = [PingAlarm.parse(text) for text in wanted.alarms]
    with (
        append(request.out / "watch.jsonl") as file,
        PingWatch(wanted.every, plan.period_ns, alarms, file, say) as watching,
        path.opened as opened,
    ):

        def show(record: Exchanges) -> None:
            watching.show(record)
            live(record)

        measure(opened, path.codec, plan, record, show)
        end_live_line()
        watching.finish(record)
        return sorted(watching.sounded)


def _command() -> str:
    return shlex.join(["cosim", *sys.argv[1:]])


def _path_trace(kind: str, result: PathResult) -> PathTrace:
    """Both directions; half the round trip each where only their sum is known."""
    from bridge.ping.as_link import semantics_of, traces
    from bridge.ping.prediction import PathTrace

    found = traces(result)
    there, back = found.get("there", found.get("half")), found.get("back", found.get("half"))
    assert there is not None and back is not None
    return PathTrace(result.sent, there, back, semantics_of(kind, result))


def open_path(request: PathRequest) -> OpenedPath:
    """The asking end of a path. Raises ScenarioError."""
    kind, where, size, end = request.kind, request.where, request.size, request.end
    from contextlib import closing

    from bridge.ping.measure import PacketCodec

    if kind == "can":
        return _open_can(where, end)
    if kind == "udp":
        from bridge.ping.udp import UdpPath, parse_address

        address = parse_address(where)
        opened = closing(UdpPath(address, tos=end.tos))
        return OpenedPath(f"udp {address[0]}:{address[1]}", opened, PacketCodec(size), size)
    from bridge.ping.zenoh import node_path, zenoh_path
    from bridge.zenoh.exchange import ENDPOINT

    if request.nodes is not None:
        name = f"zenoh {request.nodes.here} -> {request.nodes.there}"
        return OpenedPath(name, node_path(request.nodes), PacketCodec(size), size)
    endpoint = where or ENDPOINT
    return OpenedPath(
        f"zenoh {endpoint}", zenoh_path(endpoint, end.config), PacketCodec(size), size
    )


def _open_can(channel: str, end: EndOptions) -> OpenedPath:
    from contextlib import closing

    import numpy as np

    from bridge.ping.can import (
        ASK,
        CanCodec,
        CanPath,
        CanQuestion,
        DriveCodec,
        can_lines,
        parse_question,
    )
    from cosim.bus.timing import BusTiming

    drive = parse_question(end.ask, end.answer) if end.ask or end.answer else None
    question = drive or CanQuestion(ASK, b"", ASK + 1)
    timing = BusTiming(end.bitrate) if end.bitrate else None
    path = CanPath(can_bus(channel, end.interface, end.bitrate), question, question.answer, timing)

    def below(result: PathResult) -> list[str]:
        median = float(np.nanmedian(result.rtt))
        return can_lines(path, question, timing, median, float(result.sent[-1]))

    codec = DriveCodec(drive) if drive else CanCodec()
    return OpenedPath(f"can {channel} ({end.interface})", closing(path), codec, 8, below)


def can_bus(channel: str, interface: str, bitrate: float | None) -> CanBusSpec:
    """The bus of a path; `bitrate`: bit/s, given to interfaces that take one."""
    from bridge.can.interface import CanBusSpec

    takes = interface not in ("socketcan", "udp_multicast", "virtual")
    rate = round(bitrate) if bitrate and takes else None
    return CanBusSpec(channel, interface=interface, channel=channel, bitrate=rate)


def _live(record: Exchanges) -> None:
    """The live line, on a terminal only."""
    if sys.stderr.isatty():
        from bridge.ping.report import live_line

        sys.stderr.write(f"\r\033[K{live_line(record)}")
        sys.stderr.flush()


def end_live_line() -> None:
    """Remove the live line, on a terminal only."""
    if sys.stderr.isatty():
        sys.stderr.write("\r\033[K")


def _links(kind: str, result: PathResult, out: Path) -> dict[str, dict[str, str]]:
    """Each direction's trace written to `out`, and as a link: trace, fitted law, netem line."""
    from bridge.ping.as_link import laws, link_toml, netem_line, semantics_of, traces
    from cosim.links.traces import write_trace

    out.mkdir(parents=True, exist_ok=True)
    period = result.record.period_ns * 1e-9
    found, fits = {}, laws(result)
    for name, delay in traces(result).items():
        file = out / f"{name}.csv"
        write_trace(file, result.sent, delay)
        law = fits[name]
        found[name] = {
            "trace": link_toml(str(file), semantics_of(kind, result)),
            "law": f"# or a law, whose quantiles differ by {1e3 * law.error:.3g} ms in the mean:\n"
            + law.toml(),
            "netem": f"tc qdisc add dev DEV root netem {netem_line(law, period) or '(none)'}",
        }
    return found
