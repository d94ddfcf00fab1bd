"""``cosim analyze`` as a user runs it: a scenario, a run folder, and invalid targets."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cosim.analysis import experiments
from cosim.predict import elimination
from cosim.record import Run
from tests.cli.command import CONFIG, Command

TEACHING, MANY = CONFIG.with_name("teaching.toml"), CONFIG.with_name("many.toml")
SHORT = ("--set", "run.stop=3")


def test_a_scenario_gives_numbers_figures_and_json(cosim: Command) -> None:
    done = cosim("analyze", TEACHING, "--png", "--json", "a.json", "--out", "here")
    assert (done.code, done.err) == (0, "")
    for said in ("degree of manipulability", "felt damping, push",
                 "closed form  ", "5.333 N.m.s/rad, O4, Kα/λ_M",
                 "passivity margin, worst posture", "stiffest grip, M_hat = M"):  # fmt: skip
        assert said in done.out
    for name in ("manipulability", "port", "effort"):
        with Image.open(f"here/{name}.png") as picture:
            assert picture.format == "PNG" and np.asarray(picture).std() > 5
    data = json.loads(Path("a.json").read_text("utf-8"))
    numbers = {q["name"]: q for q in data["tests"]}
    assert numbers["push_damping"]["values"][0] == pytest.approx(16 / 3, rel=1e-3)
    assert numbers["push_damping"]["unit"] == "N.m.s/rad" and numbers["push_damping"]["how"]
    assert data["port"]["force"] == "robot.tau_h" and len(data["gain"]) == 2


def test_every_fact_has_a_line_and_its_units(cosim: Command) -> None:
    lines = cosim("analyze", TEACHING).out.splitlines()
    pushed = next(i for i, line in enumerate(lines) if "felt damping, push" in line)
    assert re.search(r"N\.m\.s/rad  \[\d+\]$", lines[pushed])
    assert lines[pushed + 1].startswith("    closed form  ") and "[" not in lines[pushed + 1]
    assert lines[pushed + 1].endswith("5.333 N.m.s/rad, O4, Kα/λ_M")
    assert any("constant push of 1e-06 N.m on every joint" in line for line in lines)
    assert any("‖y‖₂/‖f‖₂ from 0 s to 20 s" in line for line in lines)
    assert not any("closed form, closed form" in line for line in lines)


def test_every_footnote_is_there(cosim: Command) -> None:
    out = cosim("analyze", TEACHING).out
    used = {number for line in out.splitlines() for number in re.findall(r" \[(\d+)\]", line)}
    explained = [line.split("]")[0].strip(" [") for line in out.splitlines() if line[:3] == "  ["]
    assert used == set(explained) and len(explained) == len(set(explained)) > 10


def test_a_run_is_analysed_as_it_was(cosim: Command, tmp_path: Path) -> None:
    cosim("run", CONFIG, *SHORT, "--out", "run", "--no-plot", "--quiet")
    done = cosim("analyze", "run", "--no-tests", "--json", "a.json")
    assert (done.code, done.err) == (0, "")
    run = Run.open("run")
    force = run.array("master.tau_h")
    effort = float(np.sqrt(np.trapezoid((force**2).sum(axis=1), run.t)))
    (said,) = [q for q in json.loads(Path("a.json").read_text())["run"] if q["name"] == "effort"]
    assert said["values"] == [pytest.approx(effort, rel=1e-9)]
    assert "the port, by tests" not in done.out
    assert not Path("run/analysis").exists()
    cosim("analyze", "run", "--no-tests", "--png")
    assert sorted(p.name for p in Path("run/analysis").iterdir()) == [
        "effort.png", "manipulability.png"
    ]  # fmt: skip


def test_a_run_is_tested_through_the_scenario_it_was_made_of(cosim: Command) -> None:
    cosim("run", TEACHING, *SHORT, "--out", "run", "--no-plot", "--quiet")
    done = cosim("analyze", "run")
    assert "felt damping, push" in done.out and "5.333 N.m.s/rad" in done.out


def test_a_run_whose_scenario_is_lost_still_has_its_numbers(cosim: Command) -> None:
    cosim("run", CONFIG, *SHORT, "--out", "run", "--no-plot", "--quiet")
    Path("run/run.json").write_text("{}")
    assert "was altered after the run" in cosim.refused("analyze", "run", "--port", "master")
    done = cosim("analyze", "run", "--port", "master", "--no-verify")
    assert done.code == 0 and "effort ‖f‖₂" in done.out
    assert "note: no closed forms, no test forces: the run's metadata holds no scenario" in done.out
    assert "the port is not defined" in cosim.refused("analyze", "run", "--no-verify")


def test_many_robots_are_not_tested_unless_that_is_asked_for(
    cosim: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their closed forms are there, in as many lines as of a few, and those of all robots."""
    arguments = ("analyze", MANY, "--set", "run.stop='1 s'", "--json", "a.json")
    monkeypatch.setattr(experiments.Bench, "run", None)  # no test is simulated
    done = cosim(*arguments, "--set", "graphs.net.n=260")
    assert (done.code, done.err) == (0, "")
    assert "the port, by closed forms\n" in done.out and "--tests applies them" in done.out
    assert len(done.out.splitlines()) < 80
    found = json.loads(Path("a.json").read_text("utf-8"))
    numbers = {q["name"]: q for q in found["run"] + found["tests"]}
    assert numbers["gain"]["values"][0] > 0 and len(found["port"]["members"]) == 260
    pushed = numbers["push_damping"]
    assert pushed["values"] == [None] and pushed["note"] == "not tested"
    assert pushed["expected"] == [pytest.approx(260 * 208 / 25, rel=0.01)]
    assert numbers["inertia_quickly_known"]["expected"] == pytest.approx([5.73, 0.973], rel=1e-3)

    monkeypatch.setattr(elimination, "QUICK", {True: 519, False: 519})
    done = cosim(*arguments, "--set", "graphs.net.n=260")
    assert "note: no gain, and no closed forms by frequency: 260 robots" in done.out
    numbers = {q["name"] for q in json.loads(Path("a.json").read_text("utf-8"))["tests"]}
    assert numbers == {"push_damping", "margin", "margin_worst"}


def test_another_port_may_be_looked_into(cosim: Command) -> None:
    done = cosim("analyze", CONFIG, *SHORT, "--port", "slave", "--no-tests")
    assert "port slave: slave.tau_h, slave.q, slave.tau_ext" in done.out
    assert "no force acted" in done.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("missing.toml",), "missing.toml: no such file"),
        ((CONFIG, "--port", "mister"), "no component with signals 'mister'; did you mean 'master'"),
        ((CONFIG, "--set", "run.stop=-1"), "must be positive"),
        ((".",), "not a run folder"),
        ((".", "--set", "run.stop=1"), "--set applies to a scenario"),
    ],
)
def test_what_cannot_be_analysed_is_refused(
    cosim: Command, arguments: tuple[str | Path, ...], said: str
) -> None:
    assert said in cosim.refused("analyze", *arguments)


def test_a_signal_that_was_not_recorded_is_refused(cosim: Command) -> None:
    record = 'run.record.signals=["slave.q"]'
    bare = (
        "--set",
        record,
        *(x for key in ("metrics", "require", "figures") for x in ("--set", f"{key}={{}}")),
    )
    cosim("run", CONFIG, *SHORT, *bare, "--out", "run", "--no-plot", "--quiet")
    said = cosim.refused("analyze", "run")
    assert "master.tau_h was not recorded; recorded are slave.q" in said
