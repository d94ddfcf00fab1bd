"""Programs as python-can's users write them, unchanged, on the interface ``cosim``."""

from __future__ import annotations

import asyncio
import re
import threading
from pathlib import Path

import can
import cantools
import pytest

from bridge.simulated_can import pace
from tests.bridge.simulated_can.benches import Bench, bench, everything, message

__all__ = ["bench"]

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "can.md").read_text(encoding="utf-8")


def installed() -> bool:
    return "cosim" in can.VALID_INTERFACES


needs_entry_point = pytest.mark.skipif(
    not installed(), reason="installed before the entry point was there: pip install -e . again"
)


def test_a_notifier_gives_all_listeners_the_same_messages(bench: Bench) -> None:
    sender, receiver = bench.bus(), bench.bus()
    reader, heard = can.BufferedReader(), []
    with can.Notifier(receiver, [reader, heard.append], timeout=0.05):
        for identifier in (3, 1, 2):
            sender.send(message(identifier))
        found = [reader.get_message(5) for _ in range(3)]
    assert [m and m.arbitration_id for m in found] == [3, 1, 2]
    assert heard == found


def test_an_asyncio_program_reads_the_bus(bench: Bench) -> None:
    sender, receiver = bench.bus(), bench.bus()

    async def run() -> can.Message:
        reader = can.AsyncBufferedReader()
        loop = asyncio.get_running_loop()
        with can.Notifier(receiver, [reader], timeout=0.05, loop=loop):
            sender.send(message(5))
            return await asyncio.wait_for(reader.get_message(), 5)

    assert asyncio.run(run()).arbitration_id == 5


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".log", ".csv"])
def test_a_logger_writes_exact_times(bench: Bench, tmp_path: Path, suffix: str) -> None:
    sender, receiver = bench.bus(), bench.bus()
    path = tmp_path / f"bus{suffix}"
    with can.Logger(path) as log:
        for _ in range(3):
            sender.send(message(0x123, b"\x55" * 8))
            found = receiver.recv(1)
            assert found is not None
            found.channel = 0
            log(found)
    with can.LogReader(path) as reader:
        read = [m.timestamp for m in reader]
    assert [t - read[0] for t in read] == pytest.approx([0, 112e-6, 224e-6], abs=1.01e-6)


def test_cantools_codes_messages_of_the_bus(bench: Bench) -> None:
    database = cantools.database.load_file(ROOT / "configs" / "can" / "link2.dbc")
    layout = database.get_message_by_name("XI_1")
    names = [signal.name for signal in layout.signals]
    sender, receiver = bench.bus(), bench.bus()
    values = {name: 1.0 if name == "xi1" else 0.0 for name in names}
    sender.send(message(layout.frame_id, layout.encode(values, strict=False)))
    (found,) = everything(receiver)
    decoded = database.decode_message(found.arbitration_id, found.data)
    assert isinstance(decoded, dict)
    assert decoded["xi1"] == 1.0


def test_a_bus_forwards_by_iteration(bench: Bench) -> None:
    sender, receiver = bench.bus(), bench.bus()
    sender.send(message(1))
    sender.send(message(2))
    assert [next(iter(receiver)).arbitration_id for _ in range(2)] == [1, 2]


def test_threads_that_answer_each_other_take_the_same_simulated_time_always(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Time stands while one of them computes; both requests of a round are arbitrated."""
    monkeypatch.setattr(pace, "PATIENCE_NS", 10 * 10**9)  # also where the machine stands still

    def run(name: str) -> list[tuple[float, int]]:
        bench.name = name
        log, ready = [], threading.Barrier(3)
        master = bench.bus()

        def server(identifier: int) -> None:
            bus = bench.bus()
            ready.wait()
            for _ in range(20):
                request = bus.recv(1)
                while request and request.arbitration_id != 0x10:
                    request = bus.recv(1)
                bus.send(message(identifier, b"\1\2\3"))
            bus.shutdown()

        threads = [threading.Thread(target=server, args=(n,)) for n in (0x21, 0x20)]
        for thread in threads:
            thread.start()
        ready.wait()
        for _ in range(20):
            master.send(message(0x10))
            for _ in range(2):
                answer = master.recv(1)
                assert answer is not None
                log.append((answer.timestamp, answer.arbitration_id))
        for thread in threads:
            thread.join(10)
            assert not thread.is_alive()
        return log

    first = run("first")
    assert [identifier for _, identifier in first] == [0x20, 0x21] * 20
    assert run("second") == first


def test_a_thread_that_waits_hears_that_its_bus_was_shut_down(bench: Bench) -> None:
    bus, errors = bench.bus(), []

    def wait() -> None:
        try:
            bus.recv()
        except can.CanOperationError as error:
            errors.append(str(error))

    thread = threading.Thread(target=wait)
    thread.start()
    bus.shutdown()
    thread.join(10)
    assert not thread.is_alive()
    assert "shut down" in errors[0]


@needs_entry_point
def test_canopen_reads_the_object_of_a_node(bench: Bench) -> None:
    canopen = pytest.importorskip("canopen")
    dictionary = canopen.ObjectDictionary()
    variable = canopen.objectdictionary.ODVariable("value", 0x2000)
    variable.data_type = canopen.objectdictionary.UNSIGNED32
    variable.access_type = "rw"
    dictionary.add_object(variable)
    options = {"interface": "cosim", "channel": bench.name, "bitrate": 500_000}
    master, slave = canopen.Network(), canopen.Network()
    for network in (master, slave):
        network.NOTIFIER_CYCLE = 0.05
        network.connect(**options, speed="simulated")
    try:
        slave.create_node(2, dictionary)
        remote = master.add_node(2, dictionary)
        remote.sdo["value"].raw = 12345
        assert remote.sdo["value"].raw == 12345
        assert master.bus.time > 4 * 111 / 500_000  # four frames of eight bytes
    finally:
        master.disconnect()
        slave.disconnect()


@needs_entry_point
def test_the_example_of_the_page_runs() -> None:
    (example,) = re.findall(r"```python\n(import can\n.*?)```", PAGE, re.DOTALL)
    assert len(example.splitlines()) <= 12
    exec(compile(example, "docs/can.md", "exec"), {})


@needs_entry_point
def test_the_bus_of_a_program_in_wall_time_has_the_date(bench: Bench) -> None:
    options = {"interface": "cosim", "channel": bench.name, "bitrate": 500_000}
    with can.Bus(**options, speed=0.001) as sender, can.Bus(**options) as receiver:
        start = sender.time  # type: ignore[attr-defined]
        sender.send(message(0x123))
        sender.send(message(0x123))
        first, second = receiver.recv(5), receiver.recv(5)
        assert first is not None
        assert second is not None
        assert second.timestamp - first.timestamp == pytest.approx(48 / 500_000, abs=1e-6)
        assert start <= first.timestamp
        assert start > 1e9
