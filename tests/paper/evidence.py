"""Cases of the reproduction, run once for all tests of a session."""

from __future__ import annotations

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
        self._found: dict[str, Run | Stop] = {}

    def __getitem__(self, name: str) -> Run | Stop:
        if name not in self._found:
            stop = run_case(name, self._documents[name], self.folder)
            self._found[name] = open_case(name, self.folder, stop)
        return self._found[name]

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
