"""``cosim monitor --web``: the page has the values of the journals, and only its user sees it."""

from __future__ import annotations

import http.client
import json
import re
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

from bridge.monitor.journal_signals import JournalSignals
from bridge.monitor.live_page import STEP, LivePage
from bridge.recording.live_run import LiveRun
from cosim.base.clock import monotonic_ns
from tests.bridge.watching import folder_of
from tests.cli.command import CALL


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found: Path = tmp_path_factory.mktemp("web") / "run"
    folder_of(found)
    return found


def test_a_new_page_gets_what_there_is_and_then_what_is_new(folder: Path) -> None:
    with LiveRun.open(folder) as watched:
        page = LivePage(watched)
        first = page.news(monotonic_ns())
        held = JournalSignals(watched.system, watched.everything())
        rows = np.searchsorted(held.t, np.array(first["t"]) - 1e-9)
        assert len(rows) == round(2.0 / STEP) and np.diff(first["t"]) == pytest.approx(STEP)
        for name in ("master.q[0]", "slave_control.tau[1]", "lateness of master"):
            wanted = held.array(name)[rows, 0]
            found = np.array(first["signals"][name], dtype=float)
            assert np.array_equal(found, wanted, equal_nan=True), name
        assert first["ended"] and "has ended" in first["head"]
        assert [table["title"] for table in first["tables"]][:2] == [
            "nodes",
            "inputs from other nodes",
        ]
        json.dumps(first, allow_nan=False)
        later = page.news(monotonic_ns(), first["t"][-4])
        assert later["t"] == first["t"][-3:]
        assert page.news(monotonic_ns(), first["now"])["t"] == []


def test_the_page_has_diagrams_and_arms_of_signals_that_come(folder: Path) -> None:
    with LiveRun.open(folder) as watched:
        text = LivePage(watched).text()
    (document,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text)
    data = json.loads(document)
    assert data["live"] == "events" and "connect-src 'self'" in text
    assert [arm["name"] for arm in data["arms"]] == ["master", "slave"]
    assert data["arms"][0]["q"] == ["master.q[0]", "master.q[1]"]
    drawn = {s["name"] for panel in data["panels"] for s in panel["series"]}
    assert drawn | set(data["arms"][1]["q"]) <= set(data["signals"])
    assert "lateness of slave_control" in drawn


@pytest.fixture
def address(folder: Path) -> Iterator[str]:
    with subprocess.Popen(
        [*CALL, "monitor", str(folder), "--web", "0"], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        yield process.stdout.readline().split()[-1]
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 130


def test_only_who_has_the_address_is_answered(address: str, folder: Path) -> None:
    parts = urlsplit(address)
    assert parts.hostname == "127.0.0.1"

    def get(path: str, **headers: str) -> http.client.HTTPResponse:
        connection = http.client.HTTPConnection("127.0.0.1", parts.port or 0, timeout=20)
        connection.request("GET", path, headers=headers)
        return connection.getresponse()

    for path in ("/", "/events", "/report", "/?token=x"):
        assert get(path).status == 403, path
    assert get(f"/?{parts.query}", Host="evil.example").status == 400
    entered = get(f"/?{parts.query}")
    cookie = entered.headers["Set-Cookie"].partition(";")[0]
    assert (
        entered.status == 303
        and "HttpOnly; Path=/; SameSite=strict" in entered.headers["Set-Cookie"]
    )
    page = get("/", Cookie=cookie)
    assert page.status == 200 and "frame-ancestors" in page.headers["Content-Security-Policy"]
    assert get("/report", Cookie=cookie).status == 204
    (folder / "report.html").write_text("<p>the report</p>", encoding="utf-8")
    assert get("/report", Cookie=cookie).read() == b"<p>the report</p>"
    streams = [get("/events", Cookie=cookie) for _ in range(8)]
    news = json.loads(streams[0].readline().removeprefix(b"data: "))
    assert news["ended"] and len(news["t"]) == round(2.0 / STEP)
    assert get("/events", Cookie=cookie).status == 503
    assert get("/", Cookie=cookie, **{"X": "y"}).status == 200
    connection = http.client.HTTPConnection("127.0.0.1", parts.port or 0, timeout=20)
    connection.request("POST", "/", headers={"Cookie": cookie})
    assert connection.getresponse().status == 405
