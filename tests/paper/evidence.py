"""Cases of the reproduction, run once for all tests of a session, whatever process they are in."""

from __future__ import annotations

import fcntl
import json
from pathlib import Path

from cosim.record import Run
from fmus.paper.claim import Claim, ClaimVerdict, Stop, judge
from fmus.paper.claims import SECTIONS, cases
from fmus.paper.reproduction import open_case, run_case

CLAIMS: dict[str, Claim] = {c.name: c for claims in SECTIONS.values() for c in claims}


class Evidence:
    """Runs a case when it is first asked for, with seed 0; keeps it in `folder`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._documents = cases(0)

    def __getitem__(self, name: str) -> Run | Stop:
        return open_case(name, self.folder, self._ended(name))

    def _ended(self, name: str) -> Stop | None:
        """The end of the case; it is run unless another process of these tests has done so."""
        ended = self.folder / f"{name}.json"
        with (self.folder / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not ended.exists():
                stop = run_case(name, self._documents[name], self.folder)
                ended.write_text(json.dumps([stop.time, stop.reason] if stop else None))
        found = json.loads(ended.read_text())
        return Stop(*found) if found else None

    def run(self, name: str) -> Run:
        """A case that ran to its end."""
        found = self[name]
        assert isinstance(found, Run), found
        return found

    def verdict(self, claim: Claim) -> ClaimVerdict:
        """A claim, measured."""
        return judge(claim, {name: self[name] for name in claim.cases})


def about(topic: str, *, broken: bool) -> list[str]:
    """Names of the claims about a topic, with a hypothesis broken or none."""
    return [c.name for c in CLAIMS.values() if topic in c.about and bool(c.breaks) == broken]
