"""``cosim run --live``: what it writes, and what keeps a scenario from being live."""

from __future__ import annotations

import re
import shlex
import warnings
from html import escape, unescape
from importlib import import_module
from pathlib import Path

import pytest

from cosim.live import page as live_page
from cosim.record import Run
from cosim.record.digest import digest
from tests.cli.command import CONFIG, Command

#: The module, which has the name of its function.
BUNDLE = import_module("cosim.live.bundle")
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
    done = cosim("run", CONFIG, *SHORT, "--out", tmp_path / "live")
    assert done.code == 0, done.err
    told = re.search(r"^digest +([0-9a-f]{64})$", done.out, re.MULTILINE)
    assert told is not None and told[1] == digest(Run.open(tmp_path / "live"))
    page = (tmp_path / "live" / "report.html").read_text(encoding="utf-8")
    assert 'id="bundle"' in page and "worker-src blob:" in page and told[1] in page
    assert "links.0.delay.low" in page, "settings are part of the scenario whose keys are moved"
    again = shlex.join(["cosim", "run", str(CONFIG), *SHORT])
    assert escape(again) in page
    assert cosim("report", tmp_path / "live").code == 0
    assert (tmp_path / "live" / "report.html").read_text(encoding="utf-8") == page


def test_the_page_without_it_cannot_compute(cosim: Command, tmp_path: Path) -> None:
    done = cosim("run", CONFIG, "--no-live", *SHORT, "--out", tmp_path / "plain")
    assert done.code == 0 and "digest" not in done.out
    page = (tmp_path / "plain" / "report.html").read_text(encoding="utf-8")
    assert 'id="bundle"' not in page and "worker-src" not in page and "not-live" not in page


def reason(folder: Path) -> str:
    """The reason for which the report of a folder cannot compute."""
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert 'id="bundle"' not in page and "worker-src" not in page
    found = re.search(r'id="not-live">This report cannot compute: (.*?)</p>', page)
    assert found is not None
    return unescape(found[1])


def test_a_component_that_a_page_cannot_compute_is_named(cosim: Command, tmp_path: Path) -> None:
    path = tmp_path / "half.toml"
    path.write_text(HALF, encoding="utf-8")
    done = cosim("run", path, "--live", "--out", tmp_path / "out")
    assert done.code == 2 and re.fullmatch(r"error: half: .*\n", done.err), done.err
    assert not (tmp_path / "out").exists()
    without = cosim("run", path, "--out", tmp_path / "out")
    assert (without.code, without.err) == (0, "") and "digest" not in without.out
    assert f"error: {reason(tmp_path / 'out')}\n" == done.err
    page = (tmp_path / "out" / "report.html").read_bytes()
    assert cosim("report", tmp_path / "out").code == 0
    assert (tmp_path / "out" / "report.html").read_bytes() == page


def test_links_of_another_run_are_not_live(cosim: Command, tmp_path: Path) -> None:
    assert cosim("run", CONFIG, *SHORT, "--no-plot", "--out", tmp_path / "a").code == 0
    done = cosim("run", CONFIG, *SHORT, "--links", tmp_path / "a", "--out", tmp_path / "b")
    assert done.code == 0 and "--links" in reason(tmp_path / "b")


def test_a_page_has_at_most_its_size(
    cosim: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_page, "MOST", 300_000)
    done = cosim("run", CONFIG, *SHORT, "--out", tmp_path / "run")
    assert (done.code, done.err) == (0, "") and "digest" not in done.out
    found = reason(tmp_path / "run")
    assert re.match(r"the page would have 0\.\d\d MB, expected at most 0\.3 MB: .*every", found)
    asked = cosim("run", CONFIG, "--live", *SHORT, "--out", tmp_path / "asked")
    assert (asked.code, asked.err) == (0, f"warning: the report is not live: {found}\n")


def test_what_takes_long_is_live_on_demand(
    cosim: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(BUNDLE, "EFFORT", 4 * 8 - 1)
    assert cosim("run", CONFIG, *SHORT, "--out", tmp_path / "run").code == 0
    assert reason(tmp_path / "run").startswith("4 components")
    assert cosim("run", CONFIG, "--live", *SHORT, "--out", tmp_path / "asked").code == 0
    assert 'id="bundle"' in (tmp_path / "asked" / "report.html").read_text(encoding="utf-8")


def test_an_error_of_the_program_costs_no_run(
    cosim: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise TypeError("wrong")

    monkeypatch.setattr(BUNDLE, "refuse", broken)
    with pytest.raises(RuntimeWarning):  # in tests only, see pyproject.toml
        cosim("run", CONFIG, *SHORT, "--out", tmp_path / "strict")
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        done = cosim("run", CONFIG, *SHORT, "--out", tmp_path / "run")
    assert "a report is not live: an error of this program" in done.err
    assert done.code == 0 and (tmp_path / "run" / "SHA256SUMS").exists()
    assert reason(tmp_path / "run") == "an error of this program, TypeError: wrong"


@pytest.mark.parametrize(
    "other", [("--no-plot",), ("--deploy", "can"), ("--links", "runs/x")], ids=lambda x: x[0]
)
def test_options_that_do_not_go_with_it_are_refused(cosim: Command, other: tuple[str, ...]) -> None:
    done = cosim("run", CONFIG, "--live", *other)
    assert (done.code, done.err) == (
        2, f"error: found --live with {other[0]}; expected one of them\n"
    )  # fmt: skip
