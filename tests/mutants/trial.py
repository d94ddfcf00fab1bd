"""One run of the tests in a process forked from one that has imported what they import.

The child writes each event as a line to a pipe: which test begins, how long it took, which failed.
So the parent knows the test at which a child crashed or stood still.
"""

from __future__ import annotations

import json
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

#: A test may take this many times what it took in the unchanged program, and this many s more.
TIMES, MORE = 5.0, 5.0


@dataclass(slots=True)
class Outcome:
    """What one run told: the failed test or ``""``, and of each test (wall time, CPU time) in s."""

    failed: str = ""
    seconds: dict[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Selection:
    """Which tests run and in which order: `rank` of a test, `left_out`, wall times known, s."""

    rank: Callable[[str], Any]
    left_out: frozenset[str]
    known: Mapping[str, tuple[float, float]]


class Reporter:
    """The pytest plugin of the child: orders the tests, limits their time, writes the events."""

    def __init__(self, pipe: int, selection: Selection) -> None:
        self._pipe, self._selection = pipe, selection

    def say(self, event: str, test: str, *numbers: float) -> None:
        os.write(self._pipe, (json.dumps([event, test, *numbers]) + "\n").encode())

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        chosen = self._selection
        items[:] = [item for item in items if item.nodeid not in chosen.left_out]
        items.sort(key=lambda item: chosen.rank(item.nodeid))
        for item in items:
            if item.nodeid in chosen.known:
                limit = MORE + TIMES * chosen.known[item.nodeid][0]
                item.add_marker(pytest.mark.timeout(limit), append=False)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Any:
        self.say("begins", item.nodeid)
        wall, cpu = time.monotonic(), sum(os.times()[:4])
        done = yield
        self.say("took", item.nodeid, time.monotonic() - wall, sum(os.times()[:4]) - cpu)
        return done

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.say("failed", report.nodeid)


def run(tests: Sequence[str], selection: Selection, log: Path, limit: float) -> Outcome:
    """Run the tests until one fails; a run that lasts longer than `limit` s is ended and failed."""

    def child(pipe: int) -> int:
        words = ["-x", "-q", "-p", "no:cacheprovider", "--hypothesis-profile=mutants", *tests]
        return int(pytest.main(words, plugins=[Reporter(pipe, selection)]))

    code, lines = forked(child, log, limit)
    outcome, current = Outcome(), "collection"
    for event, test, *numbers in map(json.loads, lines):
        if event == "begins":
            current = test
        elif event == "took":
            outcome.seconds[test] = (numbers[0], numbers[1])
        else:
            outcome.failed = outcome.failed or test
    if code and code != pytest.ExitCode.NO_TESTS_COLLECTED and not outcome.failed:
        outcome.failed = f"{current} (no end)" if code < 0 else current
    return outcome


def forked(work: Callable[[int], int], log: Path, limit: float) -> tuple[int, list[str]]:
    """Call `work` in a child with a pipe; return its exit code and the lines it wrote.

    What it prints is written to `log`. The code is negative where a signal ended it; after `limit`
    s it is killed, with all that it started.
    """
    reading, writing = os.pipe()
    sys.stdout.flush()
    process = os.fork()
    if not process:
        _work(work, log, writing)
    os.close(writing)
    text, end = b"", time.monotonic() + limit
    while select.select([reading], [], [], max(0.0, end - time.monotonic()))[0]:
        chunk = os.read(reading, 65536)
        if not chunk:
            break
        text += chunk
    else:
        _end(process)
    os.close(reading)
    code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    _end(process)
    return code, text.decode().splitlines()


def _work(work: Callable[[int], int], log: Path, pipe: int) -> None:
    """The child's side: never returns."""
    code = 1
    try:
        os.setsid()
        handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        os.dup2(handle, 1)
        os.dup2(handle, 2)
        code = work(pipe)
    except Exception as error:
        print(f"{type(error).__name__}: {error}", flush=True)
    finally:
        sys.stdout.flush()
        os._exit(code)


def _end(group: int) -> None:
    """End the child and the processes that it started and left."""
    try:
        os.killpg(group, signal.SIGKILL)
    except ProcessLookupError:
        return
