"""MCAP files and bags of ROS, message by message in the order of the file.

MCAP is read without its index, so that a file that was cut off gives what it has. rosbag2 with
sqlite3 storage, and what it has compressed, is read by rosbags, like bags of ROS 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bridge.captures.headers import no_stamp, reader_of
from bridge.captures.samples import ReadingNotes, RecordedSample
from bridge.ping.exchanges import NONE
from cosim.base.errors import ScenarioError
from cosim.base.extras import require

if TYPE_CHECKING:
    from bridge.captures.headers import StampOf


def mcap_samples(path: Path, notes: ReadingNotes) -> Iterator[RecordedSample]:
    """The messages of an MCAP file; `notes` get what is lost where it was cut off.

    Raises ScenarioError for a file that is none.
    """
    require("mcap")
    from mcap.reader import NonSeekingReader

    readers: dict[int, tuple[str, StampOf]] = {}
    count = 0
    with path.open("rb") as file:
        try:
            for schema, channel, message in NonSeekingReader(file).iter_messages(
                log_time_order=False
            ):
                known = readers.get(channel.id)
                if known is None:
                    known = channel.topic, _mcap_reader(schema, channel, notes)
                    readers[channel.id] = known
                count += 1
                topic, stamp = known
                yield RecordedSample(
                    topic, message.log_time, message.sequence, message.publish_time,
                    stamp(message.data), hash(message.data),
                )  # fmt: skip
        except ScenarioError:
            raise
        except Exception as error:  # of mcap's reader, which lets through what it meets
            text = " ".join(str(error).split()) or type(error).__name__
            if not count:
                raise ScenarioError(
                    f"no message can be read ({text}); expected an MCAP file; `mcap recover` may "
                    "repair it",
                    str(path),
                ) from None
            notes.lines.append(
                f"{path.name} is cut off or broken after {count} messages ({text}): what follows, "
                "the rest of this chunk included, is lost; `mcap recover` may find more"
            )


def _mcap_reader(schema: Any, channel: Any, notes: ReadingNotes) -> StampOf:
    encoding = channel.message_encoding
    if encoding not in ("cdr", "ros1", "json"):
        notes.lines.append(
            f"{channel.topic}: messages in {encoding or 'no known encoding'} are not read for "
            "stamps; their publishing times are"
        )
        return no_stamp
    definition = schema.data.decode("utf-8", "replace") if schema is not None else ""
    return _reader(encoding, definition, schema.name if schema is not None else "")


def _reader(encoding: str, definition: str, name: str) -> StampOf:
    if not definition and encoding != "json":
        require("rosbags")
    return reader_of(encoding, definition, name)


def bag_samples(path: Path, notes: ReadingNotes) -> Iterator[RecordedSample]:
    """The messages of a bag: a folder of rosbag2, one of its files, or a ``.bag`` of ROS 1.

    Raises ScenarioError for what is none.
    """
    if path.is_dir() and (files := sorted(path.glob("*.mcap"))):
        for file in files:
            yield from mcap_samples(file, notes)
        return
    require("rosbags")
    yield from _by_rosbags(path, notes)


def _by_rosbags(path: Path, notes: ReadingNotes) -> Iterator[RecordedSample]:
    from rosbags import rosbag1, rosbag2

    opened: Any = rosbag1.Reader(path) if path.suffix == ".bag" else None
    encoding = "ros1" if opened else "cdr"
    count = 0
    try:
        opened = opened or rosbag2.Reader(path)
        with opened as bag:
            stamps: dict[int, Callable[[bytes], int]] = {
                c.id: _bag_reader(c, encoding, notes) for c in bag.connections
            }
            for connection, t_ns, data in bag.messages():
                count += 1
                yield RecordedSample(
                    connection.topic, t_ns, NONE, NONE, stamps[connection.id](data), hash(data)
                )
    except ScenarioError:
        raise
    except Exception as error:  # of rosbags, and of the libraries below it
        text = " ".join(str(error).split()) or type(error).__name__
        if count:
            notes.lines.append(f"{path.name} is broken after {count} messages ({text})")
            return
        raise ScenarioError(
            f"no message can be read ({text}); expected a bag of ROS; `ros2 bag reindex` writes "
            "a missing metadata.yaml",
            str(path),
        ) from None


def _bag_reader(connection: Any, encoding: str, notes: ReadingNotes) -> StampOf:
    if not connection.msgcount:
        notes.lines.append(f"{connection.topic}: the topic has no messages")
    return _reader(encoding, connection.msgdef.data, connection.msgtype)
