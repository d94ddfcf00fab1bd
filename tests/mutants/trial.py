"""One run of the tests in a process forked from one that has imported what they import.

The child writes each event as a line to a pipe: which test begins, how long it took, which failed,
which blocks of C code were executed. So the parent knows the test at which a child crashed or stood
still.
"""

from __future__ import annotations

import json
import os
import select
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from tests.children import fork
from tests.mutants.blocks import Marks

#: A test may take this many times what it took in the unchanged program, and this many s more.
TIMES, MORE = 5.0, 5.0


@dataclass(slots=True)
class Outcome:
    """Results of one run.

    `failures`: the failed tests, the first one first; `seconds`: of each test (wall time, processor
    time), s; `executed`: of each test the numbers of the blocks, ``""`` for those before all tests.
    """

    failures: list[str] = field(default_factory=list)
    seconds: dict[str, tuple[float, float]] = field(default_factory=dict)
    executed: dict[str, list[int]] = field(default_factory=dict)

    def blocks(self) -> set[int]:
        """The blocks that any of the tests executes, or what they import."""
        return {number for numbers in self.executed.values() for number in numbers}


@dataclass(frozen=True, slots=True)
class Selection:
    """The tests that run, and their order.

    `rank` orders them; `kept`: those that run, or None for all; `known`: (wall time, processor
    time) of each, s; `marks` says which blocks a test executes.
    """

    rank: Callable[[str], Any] = lambda test: 0
    kept: frozenset[str] | None = None
    known: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    marks: Marks | None = None


class Reporter:
    """The pytest plugin of the child: orders the tests, limits their time, writes the events."""

    def __init__(self, pipe: int, selection: Selection) -> None:
        self._pipe, self._selection = pipe, selection

    def say(self, event: str, test: str, *numbers: float) -> None:
        os.write(self._pipe, (json.dumps([event, test, *numbers]) + "\n").encode())

    def executed(self, test: str) -> None:
        if self._selection.marks is not None:
            self.say("executed", test, *self._selection.marks.take())

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        chosen = self._selection
        if chosen.kept is not None:
            items[:] = [item for item in items if item.nodeid in chosen.kept]
        items.sort(key=lambda item: chosen.rank(item.nodeid))
        for item in items:
            if item.nodeid in chosen.known:
                limit = MORE + TIMES * chosen.known[item.nodeid][0]
                item.add_marker(pytest.mark.timeout(limit), append=False)
        self.executed("")

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Any:
        self.say("begins", item.nodeid)
        wall, cpu = time.monotonic(), sum(os.times()[:4])
        done = yield
        self.say("took", item.nodeid, time.monotonic() - wall, sum(os.times()[:4]) - cpu)
        self.executed(item.nodeid)
        return done

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self.say("failed", report.nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.say("failed", report.nodeid)


def run(
    tests: Sequence[str], selection: Selection, log: Path, limit: float, *, to_the_end: bool = False
) -> Outcome:
    """Run the tests until one fails, or `to_the_end`; at most `limit` s, or they have failed.

    Raises SystemExit where pytest refuses to begin, which is no test's doing.
    """

    def child(pipe: int) -> int:
        words = ["-q", "-p", "no:cacheprovider", "--hypothesis-profile=mutants", *tests]
        # The thread of this process's faulthandler, which a test's end would wait for, is not here.
        words += ["-p", "no:faulthandler"]
        words += [f"--basetemp={log.with_suffix('.tmp')}"]  # others may tidy up the usual one
        words += [] if to_the_end else ["-x"]
        return int(pytest.main(words, plugins=[Reporter(pipe, selection)]))

    code, lines = forked(child, log, limit)
    if code == pytest.ExitCode.USAGE_ERROR:
        raise SystemExit(f"pytest does not begin:\n{log.read_text(errors='replace')[-2000:]}")
    outcome, current = Outcome(), "collection"
    for event, test, *numbers in map(json.loads, lines):
        if event == "begins":
            current = test
        elif event == "took":
            outcome.seconds[test] = (numbers[0], numbers[1])
        elif event == "executed":
            outcome.executed[test] = numbers
        elif test not in outcome.failures:
            outcome.failures.append(test)
    if code < 0:
        outcome.failures.append(f"{current} (no end)")
    elif code and code != pytest.ExitCode.NO_TESTS_COLLECTED and not outcome.failures:
        outcome.failures.append(current)
    return outcome


def forked(work: Callable[[int], int], log: Path, limit: float) -> tuple[int, list[str]]:
    """Call `work` in a child with a pipe; return its exit code and the lines it wrote.

    What it prints is written to `log`. The code is negative where a signal ended it; after `limit`
    s it is killed, with all that it started.
    """
    reading, writing = os.pipe()
    process = fork(lambda: _work(work, log, writing))
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


def _work(work: Callable[[int], int], log: Path, pipe: int) -> int:
    os.setsid()
    handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    os.dup2(handle, 1)
    os.dup2(handle, 2)
    return work(pipe)


def _end(group: int) -> None:
    """End the child and the processes that it started and left."""
    try:
        os.killpg(group, signal.SIGKILL)
    except ProcessLookupError:
        return
