"""``cosim run --live``: what it writes, and what keeps a scenario from being live."""

from __future__ import annotations

import re
import shlex
from html import escape
from pathlib import Path

import pytest

from cosim.live import digest
from cosim.record import Run
from tests.cli.command import CONFIG, Command

HALF = """
[run]
step = "1 ms"
stop = "0.1 s"
[components.half]
model = "tests.cli.components:Half"
period = "1 ms"
"""


SHORT = ("--set", "components.master.parameters.k_p=12", "--set", "run.stop='0.5 s'")


def test_the_page_has_the_scenario_and_the_digest_is_told(cosim: Command, tmp_path: Path) -> None:
    done = cosim("run", CONFIG, "--live", *SHORT, "--out", tmp_path / "live")
    assert done.code == 0, done.err
    told = re.search(r"^digest +([0-9a-f]{64})$", done.out, re.MULTILINE)
    assert told is not None and told[1] == digest(Run.open(tmp_path / "live"))
    page = (tmp_path / "live" / "report.html").read_text(encoding="utf-8")
    assert 'id="bundle"' in page and "worker-src blob:" in page and told[1] in page
    assert "links.0.delay.low" in page, "settings are part of the scenario whose keys are moved"
    again = shlex.join(["cosim", "run", str(CONFIG), "--live", *SHORT])
    assert escape(again) in page
    assert cosim("report", tmp_path / "live").code == 0
    assert (tmp_path / "live" / "report.html").read_text(encoding="utf-8") == page


def test_the_page_of_other_runs_is_as_it_was(cosim: Command, tmp_path: Path) -> None:
    done = cosim("run", CONFIG, *SHORT, "--out", tmp_path / "plain")
    assert done.code == 0 and "digest" not in done.out
    page = (tmp_path / "plain" / "report.html").read_text(encoding="utf-8")
    assert 'id="bundle"' not in page and "worker-src" not in page


def test_a_component_that_a_page_cannot_compute_is_named(cosim: Command, tmp_path: Path) -> None:
    path = tmp_path / "half.toml"
    path.write_text(HALF, encoding="utf-8")
    done = cosim("run", path, "--live", "--out", tmp_path / "out")
    assert done.code == 2 and re.fullmatch(r"error: half: .*\n", done.err), done.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "other", [("--no-plot",), ("--deploy", "can"), ("--links", "runs/x")], ids=lambda x: x[0]
)
def test_options_that_do_not_go_with_it_are_refused(cosim: Command, other: tuple[str, ...]) -> None:
    done = cosim("run", CONFIG, "--live", *other)
    assert (done.code, done.err) == (
        2, f"error: found --live with {other[0]}; expected one of them\n"
    )  # fmt: skip
