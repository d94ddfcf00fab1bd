"""``cosim delays from``: a recording as the link of a scenario."""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.ping.predicted import PredictionOptions
from cosim.base.convert import Struct
from cosim.cli.options import Json, write_json

if TYPE_CHECKING:
    from bridge.captures.evaluation import CaptureChoice
    from bridge.captures.reading import ReadRecording
    from bridge.captures.report import CaptureResult


class StreamOptions(Struct, frozen=True):
    """The streams of a recording that are evaluated, and the stamps of their samples."""

    topic: Annotated[
        str,
        typer.Option(metavar="STREAM", help="Topic, flow or frame; default: the only one, or the "
                     "one that both files have most of."),
    ] = ""  # fmt: skip
    back: Annotated[
        str, typer.Option(metavar="STREAM", help="Of two files: the stream that comes back.")
    ] = ""
    stamp: Annotated[
        str, typer.Option(help="Stamp of sending: header, publish, or auto: header if it is there.")
    ] = "auto"
    columns: Annotated[
        str, typer.Option(metavar="SENT,RECEIVED[,NUMBER]", help="csv: the columns.")
    ] = ""
    period: Annotated[
        str,
        typer.Option(
            metavar="TIME", help='Samples have one stamp, and were sent regularly: "5 ms".'
        ),
    ] = ""


class ClockOptions(Struct, frozen=True):
    """Knowledge about the clocks of both ends and the delays between them."""

    clocks: Annotated[
        str, typer.Option(help="Clocks of both ends: same, differ, or auto: as the stamps tell.")
    ] = "auto"
    least: Annotated[
        str, typer.Option(metavar="TIME", help="Least possible delay, where one way hides it.")
    ] = "0"
    most: Annotated[
        str, typer.Option(metavar="TIME", help="Largest possible delay; it bounds the clocks.")
    ] = ""


def delays_from(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE...",
            help="MCAP, bag of ROS (folder, .db3, .bag), pcap, pcapng, candump text (.log), .asc, "
            ".blf, .mf4 or .csv; FILE@CHANNEL: one bus of a log. Two files: that of the sending "
            "end, and that of the receiving one.",
        ),
    ],
    streams: StreamOptions,
    clocks: ClockOptions,
    prediction: PredictionOptions,
    out: Annotated[Path, typer.Option(help="Folder for the tables.")] = Path("delays"),
    json: Json = None,
) -> None:
    """Make links of a recording: delays, losses, clocks, a fitted law and the nearest tc netem.

    \b
    cosim delays from run.mcap                          header stamps against log times
    cosim delays from bag/ --topic /joint_states        one topic of rosbag2
    cosim delays from here.pcap there.pcap              two ends, whose clocks may differ
    cosim delays from gw.log@can0 gw.log@can1           through a gateway, by content
    cosim delays from bus.blf --topic "can0 1A0" --period "5 ms"   one stamp, regular sender
    cosim delays from run.mcap --scenario FILE --compare           and what controllers do on it
    """  # noqa: D301 - a backspace keeps the lines of the help
    from bridge.captures.reading import read_recording
    from bridge.captures.report import capture_values

    prediction.lacking("cosim delays from")
    choice = _choice(streams, clocks)
    columns = [name.strip() for name in streams.columns.split(",")] if streams.columns else []
    wanted = [streams.topic] if streams.topic else []
    if len(files) == 1:
        recording = read_recording(files[0], wanted, columns)
        result = _of_one(recording, choice, out, json)
        if result is None:
            return
    else:
        result = _of_two(files, columns, choice, out)
    shown = _printed(result, prediction, out)
    if json is not None:
        write_json(json, "recording", {**capture_values(result), "prediction": shown})


def _choice(streams: StreamOptions, clocks: ClockOptions) -> CaptureChoice:
    """The options as values in SI. Raises ScenarioError for one that cannot be."""
    from bridge.captures.evaluation import CaptureChoice
    from bridge.captures.judged import ClockKnowledge
    from cosim.base.errors import ScenarioError

    for option, given, words in (
        ("--clocks", clocks.clocks, ("same", "differ", "auto")),
        ("--stamp", streams.stamp, ("header", "publish", "auto")),
    ):
        if given not in words:
            raise ScenarioError(f"{option} {given}; expected {', '.join(words)}")
    least = _time(clocks.least, "--least")
    most = _time(clocks.most, "--most") if clocks.most else inf
    if most <= least:
        raise ScenarioError(f"--most {clocks.most}; expected more than --least {clocks.least}")
    period = round(_time(streams.period, "--period") * 1e9) if streams.period else 0
    if streams.period and period < 1:
        raise ScenarioError(f"--period {streams.period}; expected more than 0")
    known = ClockKnowledge(clocks.clocks, least, most)
    return CaptureChoice(streams.topic, streams.back, streams.stamp, period, known)


def _time(text: str, option: str) -> float:
    """A time, s, not negative. Raises ScenarioError."""
    from cosim.base.convert import number
    from cosim.base.errors import ScenarioError

    try:
        value: float | str = float(text)
    except ValueError:
        value = text
    found = number(value, "s", option)
    if found < 0:
        raise ScenarioError(f"{option} {text}; expected 0 or more")
    return found


def _of_one(
    recording: ReadRecording, choice: CaptureChoice, out: Path, json: Path | None
) -> CaptureResult | None:
    """The only usable stream, or None if there are several: they are listed."""
    from bridge.captures.evaluation import of_one_recording, usable_streams
    from cosim.base.copies import replace

    if choice.back:
        from cosim.base.errors import ScenarioError

        raise ScenarioError("found --back with one recording; expected two", recording.name)
    usable = (
        recording.streams.names if choice.period_ns else usable_streams(recording, choice.stamp)
    )
    if choice.topic:
        return of_one_recording(recording, choice, out)
    if len(usable) == 1:
        return of_one_recording(recording, replace(choice, topic=usable[0]), out)
    _list(recording, usable, json)
    return None


def _of_two(
    files: list[str], columns: list[str], choice: CaptureChoice, out: Path
) -> CaptureResult:
    from bridge.captures.evaluation import of_two_recordings, read_ends
    from cosim.base.errors import ScenarioError

    if choice.period_ns:
        raise ScenarioError("found --period with two recordings; expected one of both")
    return of_two_recordings(*read_ends(files, columns), choice, out)


def _list(recording: ReadRecording, usable: list[str], json: Path | None) -> None:
    """The streams of a recording, and which of them have two stamps."""
    from bridge.captures.evaluation import summary_of_clocks
    from bridge.ping.listening import stream_figures, stream_lines, stream_values

    heard = {name: recording.rows(name).heard() for name in recording.streams.names}
    figures = {name: stream_figures(rows) for name, rows in heard.items() if rows.shape[0] >= 3}
    clocks = summary_of_clocks(recording, usable)
    if json is not None:
        values = {name: stream_values(f) for name, f in figures.items()}
        write_json(json, "recording", {"streams": values, "usable": usable, "clocks": clocks})
    for name, f in figures.items():
        typer.echo("\n".join(stream_lines(name, f)))
    few = [name for name in heard if name not in figures]
    if few:
        typer.echo(f"fewer than three samples: {', '.join(few)}")
    for line in [*recording.notes.said(), *clocks]:
        typer.echo(f"warning: {line}" if line[0] != " " else line)
    if usable:
        typer.echo(f"{len(usable)} of {len(heard)} streams have a stamp of sending: choose one by")
        typer.echo(f"  cosim delays from {recording.name} --topic {usable[0]!r}")
    else:
        typer.echo(
            "no stream has a stamp of sending: a link needs the recording of the other end as a "
            "second file, or --topic STREAM --period TIME of a regular sender"
        )


def _printed(result: CaptureResult, prediction: PredictionOptions, out: Path) -> object:
    """Print the result and what it predicts, which is returned for JSON."""
    import numpy as np

    from bridge.captures.report import capture_lines, link_lines
    from bridge.ping.predicted import predicted_on
    from bridge.ping.prediction import PathTrace

    for line in capture_lines(result):
        typer.echo(line)
    for link in result.links:
        typer.echo("\n".join(link_lines(link)))
    there, back = result.links[0], result.links[-1]
    sent = there.way.seconds
    rows = np.searchsorted(back.way.seconds, sent, side="right") - 1
    trace = PathTrace(sent, there.delay, back.delay[np.maximum(rows, 0)], there.semantics)
    shown = predicted_on(prediction, trace, out)
    if prediction.scenario is not None and len(result.links) == 1 and not prediction.link:
        typer.echo("links of both directions are given the delays of this one")
    for line in shown.text(prediction, out):
        typer.echo(line)
    return shown.data
