"""Memory and open files of the processes that run tests, in a line each at the end of a run."""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

#: What a process may take at its end, MiB, and its open files; more is marked in the line.
MOST_MEMORY, MOST_FILES = 600, 60


class Footprint:
    """A plugin of pytest: each process measures itself, the one that reports prints all lines.

    Processes of xdist hand their numbers to the reporting process.
    """

    def __init__(self) -> None:
        self.found: dict[str, Mapping[str, Any]] = {}

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Measure this process when its last test has ended."""
        if sys.platform != "linux":
            return
        output = getattr(session.config, "workeroutput", None)
        if output is not None:
            output["footprint"] = measured()
        elif not self.found:
            self.found["pytest"] = measured()

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Keep what a process of xdist has measured; one that crashed has nothing."""
        found = getattr(node, "workeroutput", {}).get("footprint")
        if found:
            self.found[node.gateway.id] = found

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print a line for each process."""
        for name, found in sorted(self.found.items()):
            terminalreporter.write_line(line(name, found))


def measured() -> dict[str, Any]:
    """Memory of this process now and at its most, MiB, and its open files by kind."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    sizes = dict(row.split(":", 1) for row in status.splitlines() if row.endswith("kB"))
    now, peak = (int(sizes[key].split()[0]) >> 10 for key in ("VmRSS", "VmHWM"))
    return {"now": now, "peak": peak, "files": dict(open_files())}


def open_files() -> Counter[str]:
    """Open files of this process, by kind: sockets, pipes, or the ending of the file's name."""
    kinds: Counter[str] = Counter()
    for number in os.listdir("/proc/self/fd"):
        try:
            target = os.readlink(f"/proc/self/fd/{number}")
        except OSError:  # the folder itself
            continue
        place, colon, _ = target.partition(":")
        kinds[place if colon and "/" not in place else Path(target).suffix or target] += 1
    return kinds


def line(name: str, found: Mapping[str, Any]) -> str:
    """One process in words."""
    files = found["files"]
    kinds = ", ".join(f"{n} {kind}" for kind, n in sorted(files.items(), key=lambda x: -x[1])[:4])
    count = sum(files.values())
    large = " (too large)" if found["now"] > MOST_MEMORY or count > MOST_FILES else ""
    return (
        f"{name}: {found['now']} MiB at the end, {found['peak']} at most, "
        f"{count} open files ({kinds}){large}"
    )
