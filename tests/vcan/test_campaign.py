"""Faults that only a kernel's CAN can have, and processes that die, in rehearsals on vcan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.vcan.rehearsals import CALM, ROOT, bring_up, cosim, settings

CAMPAIGN = ROOT / "configs" / "faults" / "campaign.toml"
#: Whose end the script says, although a shared CPU makes everybody late.
SCRIPTS = ("bus-down", "babble", "kill", "corrupt")


#: The drive notices within the run that its controller was killed.
CHANGES = (*CALM, 'run.stop="8 s"', 'deploy.nodes.slave.drive.watchdog="1 s"')


@dataclass(frozen=True)
class Judged:
    """A line a run, by its script; where the run folders are; all that was said."""

    lines: dict[str, str]
    folder: Path
    text: str


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Judged:
    """Four rehearsals."""
    bring_up()
    tmp = tmp_path_factory.mktemp("campaign")
    words = [word for script in SCRIPTS for word in ("--only", script)]
    words += settings(*CHANGES)
    done = cosim(tmp / "lib", "campaign", str(CAMPAIGN), "--out", str(tmp / "runs"), *words)
    lines = {line.split()[0]: line for line in done.stdout.splitlines() if line.strip()}
    return Judged(lines, tmp / "runs", done.stdout + done.stderr)


@pytest.mark.parametrize("script", SCRIPTS)
def test_it_comes_to_what_it_should(campaign: Judged, script: str) -> None:
    """No corrupt frame accepted, no torque beyond limits, replayed, ended as the campaign says."""
    assert script in campaign.lines, campaign.text
    assert campaign.lines[script].rstrip().endswith("yes"), campaign.text


def test_no_run_folder_is_lost(campaign: Judged) -> None:
    folders = {path.parent.name for path in campaign.folder.glob("*/run.json")}
    assert folders == set(SCRIPTS), campaign.text
