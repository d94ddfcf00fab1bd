"""Windows of a measurement, their alarms, and the page of a measured path."""

import io
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from bridge.cli.paths.path import PathRequest, WatchOptions, ping_path
from bridge.ping.exchanges import Arrival, Exchanges, ReceivedAnswer
from bridge.ping.figures import evaluate
from bridge.ping.measure import PingResponder
from bridge.ping.page import PingNotes, write_ping_page
from bridge.ping.udp import UdpPath
from bridge.ping.watch import PingAlarm, PingWatch, append, window_figures
from cosim.base.errors import RunError, ScenarioError
from tests.bridge.ping.test_paths import answering
from tests.cosim.reporting.test_report import data as page_data

PERIOD = 10_000_000


class FakePath:
    """Exchanges as a path of 5 ms each way makes them, with silences and slow stretches."""

    def __init__(self, capacity: int = 10_000, period_ns: int = PERIOD) -> None:
        self.record = Exchanges("fake", capacity, 128, period_ns)

    def ask(self, n: int, *, lost: bool = False, delay: float = 5e-3) -> Exchanges:
        """Ask `n` questions more."""
        for _ in range(n):
            k, wait = self.record.sent, round(delay * 1e9)
            t1 = k * self.record.period_ns
            self.record.asked(t1, t1, 1000)
            if not lost:
                answer = ReceivedAnswer(k, t1 + wait + 7, t1 + wait + 7, 0, k + 1, host=1)
                self.record.answered(answer, Arrival(b"", t1 + 2 * wait))
        return self.record


@contextmanager
def watching(
    *alarms: str, every: float = 1.0
) -> Iterator[tuple[PingWatch, list[str], io.StringIO]]:
    said: list[str] = []
    file = io.StringIO()
    wanted = [PingAlarm.parse(text) for text in alarms]
    with PingWatch(every, PERIOD, wanted, file, said.append) as watch:
        yield watch, said, file


def test_a_window_is_a_measurement_of_its_own() -> None:
    path = FakePath()
    path.ask(100)
    path.ask(100, delay=20e-3)
    window = window_figures(path.record.between(100, 200), 1e9)
    assert window.numbers["p50"] == pytest.approx(40e-3, abs=1e-6)
    assert (window.sent, window.numbers["lost"], window.numbers["outage"]) == (100, 0, 0)
    assert window.length == pytest.approx(1.0)
    assert window.figures is not None and window.figures["answered"] == 100
    assert path.record.sent == 200  # the record itself is as it was


def test_windows_of_a_ring_that_has_turned() -> None:
    path = FakePath(capacity=150)
    path.ask(300)
    np.testing.assert_array_equal(
        path.record.between(200, 260).stamp("t1"), np.arange(200, 260) * PERIOD
    )


def test_a_silence_counts_up_to_the_ends_of_the_window() -> None:
    path = FakePath()
    path.ask(40)
    path.ask(60, lost=True)
    window = window_figures(path.record.between(0, 100), 0.0)
    assert window.numbers["outage"] == pytest.approx(0.61)
    assert window.numbers["lost"] == pytest.approx(0.6)


def test_alarms_begin_once_and_end_once() -> None:
    path = FakePath()
    with watching("p99 > 20 ms", "lost > 1 %") as (watch, said, file):
        for delay in (5e-3, 12e-3, 12e-3, 5e-3):
            path.ask(100, delay=delay)
        watch.finish(path.record)
    assert [line for line in said if "larm" in line.lower()] == [
        "ALARM p99 > 20 ms: p99 is 24.000 ms",
        "alarm p99 > 20 ms: over after 2 s, p99 is 10.000 ms",
    ]
    assert watch.sounded == {"p99 > 20 ms"}
    lines = [json.loads(line) for line in file.getvalue().splitlines()]
    assert [line["alarms"] for line in lines] == [[], ["p99 > 20 ms"], ["p99 > 20 ms"], []]
    assert [line["sent"] for line in lines] == [100] * 4


def test_a_window_waits_for_its_last_answers_and_none_is_left_out() -> None:
    path = FakePath()
    with watching() as (watch, said, file):
        watch.show(path.ask(199))  # the answers have a second
        assert not watch._waiting and not said
        watch.show(path.ask(102))
        assert len(watch._waiting) + len(said) == 2
        path.ask(30)
        watch.finish(path.record)
    sent = [json.loads(line)["sent"] for line in file.getvalue().splitlines()]
    assert sent == [100, 100, 100, 31]


def test_a_window_without_answers_sounds_every_alarm() -> None:
    path = FakePath()
    with watching("lost > 50 %", "max > 1 s", "outage > 0.5 s") as (watch, said, _):
        path.ask(100)
        path.ask(100, lost=True)
        watch.finish(path.record)
    assert len(watch.sounded) == 3
    assert any(line.endswith("100 questions, none answered") for line in said)
    assert sum("still sounding" in line for line in said) == 3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("p98 > 1 ms", "expected QUANTITY > VALUE UNIT"),
        ("p99 < 1 ms", "expected QUANTITY > VALUE UNIT"),
        ("p99 > 1", "expected QUANTITY > VALUE UNIT"),
        ("p99 > 1 kg", "cannot feed"),
        ("lost > 1 ms", "expected %"),
        ("p99 > 1e ms", "1e"),
    ],
)
def test_an_alarm_that_cannot_be_read_is_refused(text: str, said: str) -> None:
    with pytest.raises(ScenarioError, match=said):
        PingAlarm.parse(text)


@pytest.mark.parametrize("every", [0.05, 1e5])
def test_windows_of_too_few_or_too_many_questions_are_refused(every: float) -> None:
    with pytest.raises(ScenarioError, match="expected 10 to"), watching(every=every):
        pass


def test_a_file_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match="cannot be written"):
        append(tmp_path / "file" / "watch.jsonl")


def test_the_command_watches_and_exits_with_1_after_an_alarm(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import typer

    end = UdpPath(("127.0.0.1", 0), listen=True)
    with answering(PingResponder(end)), pytest.raises(typer.Exit) as exited:
        watch = WatchOptions(0.1, ("max > 0.001 us", "lost > 99 %"))
        where = f"127.0.0.1:{end.port}"
        request = PathRequest("udp", where, 500, 100, 0.3, tmp_path, watch=watch)
        ping_path(request, tmp_path / "said.json")
    end.close()
    assert exited.value.exit_code == 1
    printed = capsys.readouterr()
    assert json.loads((tmp_path / "said.json").read_text("utf-8"))["alarms"] == ["max > 0.001 us"]
    assert printed.out.count(" 50 questions") == 3
    assert len((tmp_path / "watch.jsonl").read_text().splitlines()) == 3
    assert (tmp_path / "report.html").is_file()


def test_the_page_shows_delays_losses_and_outages(tmp_path: Path) -> None:
    path = FakePath()
    path.ask(100)
    path.ask(50, lost=True)
    path.ask(100, delay=8e-3)
    found = evaluate(path.record)
    notes = PingNotes(
        {"there": {"trace": "delay = <1>"}}, "cosim ping udp x", ("a line",), ("settles",),
        ("OK    paper",),
    )  # fmt: skip
    page = write_ping_page(tmp_path / "report.html", found, notes).read_text()
    data = page_data(page)
    assert [p["title"] for p in data["panels"]] == ["Delay of each question", "Lost questions"]
    assert {"round trip", "there", "back", "lost"} == set(data["signals"])
    [event] = data["events"]
    assert event == {"label": "outage", "t": pytest.approx(0.99), "to": pytest.approx(1.5)}
    for text in ("delay = &lt;1&gt;", "cosim ping udp x", "settles", "OK    paper", "a line"):
        assert text in page
    assert re.search(r"Lost</span><b>20.000%", page)
