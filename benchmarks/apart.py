"""A session in a process of its own, on a leash: what crashes or hangs there is named, and ends.

    python apart.py                 reads requests, one JSON a line, and answers each with one

The process times itself, so the way there and back is not in any number.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from pathlib import Path
from typing import Any, final

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

from benchmarks.peers import Absent, silence


@final
class Apart:
    """A master in another process, as a session. Raises Absent when it fails or takes too long.

    `limit`: s that anything asked of it may take. `facts`: what the process said when it was ready.
    """

    def __init__(self, request: dict[str, Any], limit: float = 20.0) -> None:
        self.limit = limit
        self._process = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        self.facts = self.ask({"do": "make", **request})

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """The answer to a request; the process is ended if there is none."""
        process = self._process
        assert process.stdin is not None and process.stdout is not None
        try:
            print(json.dumps(request), file=process.stdin, flush=True)
        except (OSError, ValueError) as error:  # a closed pipe, or ours to it
            raise Absent("its process ended") from error
        if not select.select([process.stdout], [], [], self.limit)[0]:
            self._end()
            raise Absent(f"took more than {self.limit:g} s and was stopped")
        line = process.stdout.readline()
        if not line:
            self._end()
            raise Absent(f"its process ended with status {process.returncode}")
        answer: dict[str, Any] = json.loads(line)
        if "absent" in answer:
            self._end()
            raise Absent(answer["absent"])
        return answer

    def run(self, ticks: int) -> float:
        """Go on for `ticks` ticks; returns s."""
        return float(self.ask({"do": "run", "ticks": ticks})["seconds"])

    def outputs(self) -> bytes:
        """All outputs as they are."""
        return bytes.fromhex(self.ask({"do": "outputs"})["hex"])

    def recorded(self, n: int) -> bytes:
        """Not asked for: outputs are compared."""
        return b""

    def memory(self) -> float:
        """Greatest resident memory of the process so far, MB."""
        return float(self.ask({"do": "memory"})["peak_mb"])

    def close(self) -> None:
        """End the process."""
        self._end()

    def _end(self) -> None:
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()


def answer(sessions: list[Any], request: dict[str, Any]) -> dict[str, Any]:
    """What the process says to a request."""
    from benchmarks.entrants import begin
    from benchmarks.stages import peak

    if request["do"] == "make":
        session, facts = begin(request)
        sessions.append(session)
        return facts
    if request["do"] == "run":
        return {"seconds": sessions[0].run(request["ticks"])}
    if request["do"] == "memory":
        return {"peak_mb": peak()}
    return {"hex": sessions[0].outputs().hex()}


def main() -> None:
    """Answer until nobody asks; what libraries print goes nowhere."""
    channel = os.fdopen(os.dup(1), "w")
    sessions: list[Any] = []
    with silence():
        for line in sys.stdin:
            try:
                found = answer(sessions, json.loads(line))
            except Absent as absent:
                found = {"absent": str(absent)}
            except Exception as error:  # a foreign master may raise anything: that is its reason
                found = {"absent": f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"}
            print(json.dumps(found), file=channel, flush=True)
    os._exit(0)


if __name__ == "__main__":
    main()
