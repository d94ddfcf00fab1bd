"""Exports for plotting tools contain every slot and every number of the journals."""

from __future__ import annotations

import json
import socket
import sys

import numpy as np
import pytest

from bridge.monitor.figure import draw
from bridge.monitor.sinks import address
from bridge.monitor.topics import Feed, TopicSource
from bridge.native.journal import Journal
from bridge.recording.live_run import LiveRun
from bridge.rehearsal.supervisor import NODES
from cosim.base.errors import ScenarioError
from tests.bridge.watching import folder_of

WALL = 10**18


class Kept:
    """A sink that keeps everything."""

    def __init__(self, rate=float("inf")):
        self.rate, self.samples = rate, []

    def put(self, sample):
        self.samples.append(sample)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    place = tmp_path_factory.mktemp("made") / "run"
    return place, folder_of(place, wall_ns=WALL)


@pytest.fixture
def watched(made):
    with LiveRun.open(made[0]) as found:
        yield found


def rows_of(place, life):
    return Journal.open(place / NODES / f"{life}.journal")


def expected(system, rows, node):
    """What the topics of a node have to say, in the order of its slots."""
    slots = system.nodes[node].plan.slots()
    for row in rows:
        yield (
            WALL + int(row["deadline_ns"]),
            {n: row["signals"][s.start : s.start + s.size].tolist() for n, s in slots.items()},
        )


def test_mcap_is_the_journals_exactly(made, watched, tmp_path):
    pytest.importorskip("foxglove")
    reader = pytest.importorskip("mcap.reader")
    from bridge.monitor.sinks import Mcap

    place, system = made
    with Mcap(tmp_path / "run.mcap") as sink:
        slots = Feed(watched, [sink]).new()
    found: dict[str, list] = {}
    with (tmp_path / "run.mcap").open("rb") as file:
        for schema, channel, message in reader.make_reader(file).iter_messages():
            assert schema.encoding == "jsonschema" and channel.message_encoding == "json"
            found.setdefault(channel.topic, []).append(
                (message.log_time, json.loads(message.data), json.loads(schema.data))
            )
    assert slots == sum(len(rows_of(place, n)) for n in system.nodes)
    for node in system.nodes:  # components are called as their nodes here
        rows = rows_of(place, node)
        for (t, said, schema), (due, values) in zip(
            found[f"/{node}"], expected(system, rows, node), strict=True
        ):
            assert t == due
            assert set(said) == set(schema["properties"])
            for name, numbers in values.items():
                port = name.partition(".")[2]
                assert (said[port] if isinstance(said[port], list) else [said[port]]) == numbers
        for (t, said, _), row in zip(found[f"/nodes/{node}"], rows, strict=True):
            assert t == WALL + row["deadline_ns"]
            assert all(said[k] == row[k] for k in ("slot", "woke_ns", "done_ns", "scale"))
            for inlet, held in zip(system.nodes[node].inlets, row["inlets"], strict=True):
                assert tuple(said["inputs"][inlet.target.name].values()) == held.item()
    unit = found["/master"][0][2]["properties"]["q"]["description"]
    assert unit == "rad"


def test_an_mcap_file_is_not_overwritten_unasked(tmp_path):
    pytest.importorskip("foxglove")
    from bridge.monitor.sinks import Mcap

    path = tmp_path / "run.mcap"
    path.write_bytes(b"mine")
    with pytest.raises(ScenarioError, match="the file exists"):
        Mcap(path)
    assert path.read_bytes() == b"mine"
    with Mcap(path, replace=True):
        pass
    assert path.read_bytes() != b"mine"


def test_without_the_sdk_it_is_said_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "foxglove", None)
    from bridge.monitor.sinks import Foxglove, Mcap

    with pytest.raises(ScenarioError, match=r"install cosim-bridge\[foxglove\]"):
        Mcap(tmp_path / "run.mcap")
    with pytest.raises(ScenarioError, match=r"install cosim-bridge\[foxglove\]"):
        Foxglove("127.0.0.1:8765")


def test_new_rows_are_given_once_and_in_order_of_time(made, watched):
    kept = Kept()
    feed = Feed(watched, [kept])
    assert feed.new() > 0 and feed.new() == 0
    times = [s.t_ns for s in kept.samples]
    assert times == sorted(times)
    place, system = made
    for node in system.nodes:
        slots = [s.content["slot"] for s in kept.samples if s.topic.name == f"/nodes/{node}"]
        assert slots == rows_of(place, node)["slot"].tolist()


def test_rows_that_come_later_are_given_later(made, tmp_path):
    place = tmp_path / "run"
    folder_of(place)
    path = place / NODES / "master.journal"
    rows = Journal.open(path).copy()
    writer = Journal.create(path, rows.dtype, len(rows))
    kept = Kept()
    with LiveRun.open(place) as watched:
        feed = Feed(watched, [kept])
        for part in np.array_split(rows, 7):
            for values in part:
                writer.append(*values)
            feed.new()
    writer.close()
    slots = [s.content["slot"] for s in kept.samples if s.topic.name == "/nodes/master"]
    assert slots == rows["slot"].tolist()


def test_a_live_view_gets_a_part_of_the_slots(made, watched):
    kept = Kept(rate=100.0)
    Feed(watched, [kept]).new()
    assert len([s for s in kept.samples if s.topic.name == "/master"]) == 200
    slots = [s.content["slot"] for s in kept.samples if s.topic.name == "/nodes/master_control"]
    assert slots == list(range(0, 400, 2))  # of 200 Hz


def test_a_number_that_is_not_finite_is_null(made):
    place, system = made
    row = rows_of(place, "master")[:1].copy()
    slot = system.nodes["master"].plan.slots()["master.q"]
    row["signals"][0, slot.start : slot.start + 2] = np.nan, np.inf
    sample = TopicSource(system.nodes["master"], 0).samples(row, float("inf"))[0]
    assert sample.content["q"] == [None, None]
    json.dumps(sample.content, allow_nan=False)


def test_foxglove_is_served_on_this_machine():
    pytest.importorskip("foxglove")
    from bridge.monitor.sinks import Foxglove

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
    with (
        Foxglove(f"127.0.0.1:{port}"),
        socket.create_connection(("127.0.0.1", port), 5.0) as client,
    ):
        client.sendall(
            b"GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
            b"Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
        )
        assert b"101" in client.recv(200)


@pytest.mark.parametrize("text", ["", "host", "host:", ":9", "host:0", "host:99999", "a:b"])
def test_what_is_no_address(text):
    with pytest.raises(ScenarioError, match="expected HOST:PORT"):
        address(text)
    assert address("127.0.0.1:9870") == ("127.0.0.1", 9870)


def test_the_figure_is_a_png_and_needs_slots(made, watched, tmp_path):
    path = draw(watched, tmp_path / "run.png")
    assert path.read_bytes().startswith(b"\x89PNG")
    for tail in watched.lives.values():
        tail.close()
    watched.lives.clear()
    with pytest.raises(ScenarioError, match="no node has completed a slot"):
        draw(watched, tmp_path / "none.png")
