"""docs/hardware.md, the comments of the deployments and the software say the same."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bridge.cli import doctor_deploy
from bridge.commission import steps
from bridge.commission.line_drives import line_drives
from bridge.deployment import spec as deployments
from bridge.deployment.drive_sequences import FEED_NS, feed_ns
from tests.bridge.commission.bench import bench
from tests.bridge.commission.test_steps import checked

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "hardware.md").read_text("utf-8")
DEPLOYMENTS = sorted((ROOT / "configs" / "deploy").glob("*.toml"))
TEXTS = [*ROOT.glob("configs/**/*.toml"), *ROOT.glob("docs/*.md")]


def header(path: Path) -> str:
    """The comment at the beginning of a file, as one line."""
    lines = path.read_text("utf-8").split("\n\n")[0].splitlines()
    return " ".join(line.lstrip("# ") for line in lines if line.startswith("#"))


def rows(page: str) -> list[str]:
    """The steps in the table of the page."""
    table = page.split("| step | what is proven |")[1].split("\n\n")[0]
    return [line.split("|")[1].strip() for line in table.splitlines()[2:]]


def test_the_steps_of_the_page_are_those_of_the_command(tmp_path: Path) -> None:
    with bench("damiao", tmp_path) as b:
        names = list(checked(b))
    said = ["bus", "drive"]
    for name in names:
        step = name.partition(": ")[2].split(" of ")[0] or name
        known = step in ("drive 1 on bus left", "TIMEOUT (9)")  # both are of the step `drive`
        said += [] if known else [step]
    assert rows(PAGE) == said


@pytest.mark.parametrize(
    "text",
    [
        f"| direction | {steps.WIGGLE * 100:g} % of the torque",
        f"for {steps.LONG:g} s or {steps.FAR:g} rad at most",
        f"press it within {steps.PRESS:g} s",
        f"First run with {doctor_deploy.FIRST * 100:g} % of the torque",
        "The exit status is 0 only if every step is proven, 3 if nothing is\n   wrong",
    ],
)
def test_the_numbers_of_the_page_are_those_of_the_command(text: str) -> None:
    assert text in PAGE


def test_drives_are_fed_as_often_as_the_page_says() -> None:
    assert "feeds the drive's watchdog five times in its time" in " ".join(PAGE.split())
    for path in DEPLOYMENTS:
        for drive in line_drives(deployments.load(path)):
            timeout = drive.foreign.profile.timeout
            assert feed_ns([drive.foreign]) == pytest.approx(timeout / 5 * 1e9)
            assert FEED_NS[0] <= timeout / 5 * 1e9 <= FEED_NS[1]


@pytest.mark.parametrize("path", DEPLOYMENTS, ids=lambda path: path.stem)
def test_a_deployment_says_what_its_drives_need_and_where_it_is_described(path: Path) -> None:
    """Drives whose settings no frame writes are configured once; all are enabled by their node."""
    profiles = [drive.foreign.profile for drive in line_drives(deployments.load(path))]
    own = [profile for profile in profiles if profile.vendor]
    if own:
        assert "docs/hardware.md" in header(path) or "As openarm.toml" in header(path)
    by_hand = any(profile.watchdog.write is None for profile in own)
    assert ("Configure each drive once" in header(path)) == by_hand


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_text_says_that_drives_are_enabled_by_others(path: Path) -> None:
    text = " ".join(line.lstrip("# ") for line in path.read_text("utf-8").splitlines())
    wrong = r"nodes? (does|do) not enable|has to be enabled by|a node enables the others"
    assert not re.search(wrong, text)
