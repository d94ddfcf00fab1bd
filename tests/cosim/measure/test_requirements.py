"""Requirements of a scenario, wherever they are shown: everywhere with the same words."""

from __future__ import annotations

import json
import re
from math import exp, inf
from pathlib import Path
from xml.etree import ElementTree

import pytest

import cosim
from cosim.base.errors import RunError, ScenarioError
from cosim.checks.preflight import check
from cosim.loading.files import load
from cosim.measure.metrics import MetricResult
from cosim.measure.robustness import Robustness, worst
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import as_data
from cosim.study import memory
from cosim.study.run_point import RunMeasures, needed_columns, recorded_columns
from tests.cli.command import Command
from tests.cosim.study.studies import SCENARIO

#: x = 0.99^k at 10 ms, as e^-t; the second requirement fails, the third is not decided.
REQUIRED = """
[require.falls]
eventually = "plant.y <= 0.1"
[require.small]
always = "abs(plant.y) <= 0.5"
after = "0.5 s"
[require.rests]
metric = "rest.settle_s <= 3 s"
"""
X = 0.99


@pytest.fixture
def command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Command:
    """The command, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return Command(monkeypatch, capsys)


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("require") / "loop.toml"
    path.write_text(SCENARIO + REQUIRED, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def run(scenario: Path) -> cosim.RunResult:
    return cosim.run(scenario)


def test_margins_follow_on_paper(run: cosim.RunResult) -> None:
    found = run.requirements
    assert found["falls"].value == pytest.approx(0.1 - X**400, abs=1e-12)
    assert (found["falls"].time, found["falls"].verdict) == (4.0, "passed")
    assert found["small"].value == pytest.approx(0.5 - X**50, abs=1e-12)
    assert (found["small"].time, found["small"].verdict) == (0.5, "failed")
    k = next(k for k in range(400) if X**k < 0.1)
    assert found["rests"].value == pytest.approx(3.0 - k * 0.01)
    assert found["rests"].unit == "s"
    assert exp(-4) == pytest.approx(X**400, rel=0.03)


def test_answers_name_the_margin(run: cosim.RunResult) -> None:
    assert run.passes("falls") and run.passes("rests", "falls")
    answer = run.passes()
    assert not answer
    assert answer.text == "small: failed, margin -0.105, worst at 500 ms"
    assert run.passes("rest")  # a metric with a band
    with pytest.raises(ScenarioError, match=r"no requirement, or metric .*'fals'; did you mean"):
        run.passes("fals")


def test_a_run_says_the_same_everywhere(
    command: Command, scenario: Path, tmp_path: Path, run: cosim.RunResult
) -> None:
    folder, data = tmp_path / "run", tmp_path / "run.json"
    done = command("run", str(scenario), "--out", str(folder), "--json", str(data))
    assert done.code == 0
    lines = [result.line for result in run.requirements.values()]
    for line in lines:
        assert f"requirement            {line}" in done.out
    kept = json.loads((folder / "run.json").read_text())["requirements"]
    assert json.loads(data.read_text())["requirements"] == kept
    page = (folder / "report.html").read_text()
    for result in run.requirements.values():
        assert kept[result.name] == result.as_data()
        assert result.text in page and result.verdict in page
    assert "small: failed, margin -0.105, worst at 500 ms" in page  # the verdict on the run


def test_strict_is_exit_code_1_for_what_does_not_pass(
    command: Command, scenario: Path, tmp_path: Path
) -> None:
    words = ("run", str(scenario), "--out", str(tmp_path / "run"), "--force", "--strict", "-q")
    assert command(*words).code == 1
    assert command(*words, "--set", 'require.small.after="1 s"').code == 0


def test_what_cannot_be_read_is_bad_input(command: Command, scenario: Path, tmp_path: Path) -> None:
    words = ("run", str(scenario), "--out", str(tmp_path / "run"))
    done = command(*words, "--set", 'require.small.always="abs(plnt.y) <= 1"')
    assert done.code == 2 and "did you mean 'plant.y'?" in done.err
    assert done.err.startswith(f"error: {scenario} at require.small.always: ")
    assert not (tmp_path / "run").exists()
    assert command("check", str(scenario), "--set", "require.small.after=-1").code == 2


def test_a_run_that_diverges_violates_all(scenario: Path, tmp_path: Path) -> None:
    with pytest.raises(RunError) as stopped:
        cosim.run(
            scenario,
            out=tmp_path / "run",
            set={"components.gain.parameters.gain": 1e3, "run.stop": 20},
        )
    found = cosim.open(tmp_path / "run").requirements
    at = f"{stopped.value.time:.4g} s"
    assert {(r.verdict, r.value) for r in found.values()} == {("failed", -inf)}
    assert {r.text for r in found.values()} == {f"failed, the run stopped at {at}"}


def test_a_requirement_whose_signal_was_not_recorded_is_inconclusive(scenario: Path) -> None:
    run = cosim.run(scenario)
    facts = run.folder / "run.json"
    document = json.loads(facts.read_text())
    document["scenario"]["require"]["small"]["always"] = "abs(other.y) <= 1"
    facts.write_text(json.dumps(document))
    found = cosim.open(run.folder).requirements["small"]
    assert found.verdict == "inconclusive" and not found.recorded
    assert "no recorded signal 'other.y'" in found.text


def test_a_settle_time_that_a_short_run_cannot_tell_is_inconclusive(scenario: Path) -> None:
    short = cosim.run(scenario, set={"run.stop": 2})
    assert short.requirements["rests"].text == (
        "inconclusive: rest has not settled at the end of the run at 2 s"
    )
    late = cosim.run(scenario, set={"run.stop": 2, "require.rests.metric": "rest.settle_s <= 1 s"})
    assert (late.requirements["rests"].verdict, late.requirements["rests"].value) == (
        "failed", -inf,
    )  # fmt: skip


def test_a_metric_that_has_been_computed_is_not_computed_again(tmp_path: Path) -> None:
    """A result that is given counts, of the requirement that is about it, and of no other one."""
    path = tmp_path / "loop.toml"
    path.write_text(f"{SCENARIO}\n{REQUIRED}")
    loaded = load(path)
    plan = assemble(loaded)
    wanted = RunMeasures.of(loaded, plan)
    signals = memory.record(plan, needed_columns(wanted.signals, recorded_columns(loaded, plan)))
    given = [MetricResult("rest", "rest", 0.0, "1", parts={"settle_s": 1.25})]
    before, after = (
        {r.name: r.evaluate(signals, wanted.end, known).value for r in wanted.requirements}
        for known in ((), given)
    )
    assert after["rests"] == 3.0 - 1.25 != before["rests"]
    assert {k: x for k, x in after.items() if k != "rests"} == {
        k: x for k, x in before.items() if k != "rests"
    }


def test_a_scenario_without_requirements_says_nothing_of_them(tmp_path: Path) -> None:
    path = tmp_path / "loop.toml"
    path.write_text(SCENARIO)
    assert "require" not in as_data(load(path))
    assert cosim.run(path).requirements == {}


def test_a_difference_shows_a_changed_verdict(
    command: Command, scenario: Path, tmp_path: Path
) -> None:
    a, b = tmp_path / "a", tmp_path / "b"
    for folder, gain in ((a, 1.0), (b, 2.0)):
        setting = f"components.gain.parameters.gain={gain}"
        assert command("run", str(scenario), "-q", "--set", setting, "--out", str(folder)).code == 0
    xml, page = tmp_path / "d.xml", tmp_path / "d.html"
    done = command("diff", str(b), str(a), "--junit", str(xml), "--html", str(page))
    assert "changed verdict: " in done.out
    cases = {c.get("name"): c for c in ElementTree.parse(xml).getroot().iter("testcase")}
    assert cases["small"].get("classname") == "cosim.requirements"
    failure = cases["small"].find("failure")
    assert failure is not None and "changed: passed, margin 0.1358" in failure.get("message", "")
    assert cases["falls"].find("failure") is None
    assert "Requirements" in page.read_text()


STUDY = """
scenario = "loop.toml"
[vary.gain]
path = "components.gain.parameters.gain"
values = [0.5, 1.0, 2.0]
[stable]
requirements = ["small", "own"]
[require.own]
always = "plant.y >= -0.1"
"""


def test_a_study_has_margins_as_columns_and_verdicts_as_criterion(scenario: Path) -> None:
    study = scenario.parent / "study.toml"
    study.write_text(STUDY, encoding="utf-8")
    table = cosim.sweep(study, scenario.parent / "sweep")
    assert table.units["small.margin"] == "1" and table.units["rests.margin"] == "s"
    for record in table.records:
        expected = 0.5 - (1 - record["gain"] * 0.01) ** 50
        assert record["small.margin"] == pytest.approx(expected, abs=1e-9)
        assert record["stable"] == (expected >= 0)
    other = study.with_name("wrong.toml")
    other.write_text(STUDY.replace('"small", "own"', '"smal"'), encoding="utf-8")
    with pytest.raises(ScenarioError, match="stable: no requirement 'smal'; did you mean 'small'"):
        cosim.sweep(other, study.parent / "wrong")


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ('always = "plant.y <= 9"\nafter = "5 s"', "its interval begins at 5 s, but the run takes"),
        ('always = "plant.y <= 9"\nwithin = "5 s"', "its intervals reach to 5 s"),
        ('always = "abs(plant.y) >= -1"', "cannot fail: its margin is at least 1"),
        ('eventually = "norm(plant.y) <= -1"', "cannot hold: its margin is at most -1"),
        ('always = "plant.y >= 2 and plant.y <= 1"', "cannot hold: its conditions contradict"),
        ('metric = "rest.settle_s <= -1 s"', "cannot hold"),
        ('always = "plant.y <= 9"', ""),
        ('formula = "eventually plant.y >= 2 and eventually plant.y <= 1"', ""),
        ('formula = "always (not plant.y >= 2 or eventually plant.y <= 1)"', ""),
    ],
)
def test_a_check_warns_of_what_is_decided_before(tmp_path: Path, keys: str, reason: str) -> None:
    path = tmp_path / "loop.toml"
    path.write_text(f"{SCENARIO}\n[require.one]\n{keys}\n")
    loaded = load(path)
    found = [f for f in check(loaded, assemble(loaded)) if f.rule == "requirement"]
    assert [f.severity for f in found] == (["warning"] if reason else [])
    assert not reason or (reason in found[0].reason and found[0].where == "require.one")


def test_limits_of_torques_bound_what_a_requirement_can_see() -> None:
    path = Path("configs/teleoperation.toml")
    settings = ["components.master_control.parameters.tau_max=40"]
    settings += ['require={ one = { always = "abs(master_control.tau[1]) <= 50 N.m" } }']
    loaded = load(Path(__file__).parents[3] / path, settings)
    found = [f for f in check(loaded, assemble(loaded)) if f.rule == "requirement"]
    assert "cannot fail: its margin is at least 10 N.m" in found[0].reason


def test_the_worst_verdict_is_that_of_all() -> None:
    def of(*verdicts: str) -> str | None:
        return worst(Robustness("a", v, 0.0, "m", 0.0, "") for v in verdicts)  # type: ignore[arg-type]

    assert of() is None
    assert of("passed", "inconclusive") == "inconclusive"
    assert of("inconclusive", "failed", "passed") == "failed"


def test_a_comparison_has_a_column_for_each_margin(tmp_path: Path) -> None:
    """That of a requirement is the margin which the same case has by itself."""
    root = Path(__file__).parents[3]
    text = (root / "configs/teleoperation.toml").read_text()
    (tmp_path / "teleoperation.toml").write_text(
        f'{text}\n[require.calm]\nalways = "norm(master.dq) <= 9 rad/s"\n'
        '[require.own]\nalways = "abs(master_control.tau) <= 9 N.m"\n'
    )
    found = cosim.compare(
        tmp_path / "teleoperation.toml",
        variants=root / "configs/compare/bilateral.toml",
        controllers=["pd"], operators=["light"], links=["paper"],
        set={"run.stop": "2 s"},
    )  # fmt: skip
    numbers = found.outcomes[0].numbers
    assert numbers["calm.margin"][1] == "rad/s" and abs(numbers["calm.margin"][0]) < 9
    assert "own.margin" not in numbers  # a controller's signal, which not every variant has


def test_the_example_of_the_page_prints_what_the_page_shows(
    command: Command, tmp_path: Path
) -> None:
    root = Path(__file__).parents[3]
    page = (root / "docs/requirements.md").read_text(encoding="utf-8")
    example = page.split("```toml\n")[1].partition("```")[0]
    text = (root / "configs/teaching.toml").read_text(encoding="utf-8")
    (tmp_path / "teaching.toml").write_text(f"{text}\n{example}", encoding="utf-8")
    done = command("run", "teaching.toml", "--no-plot")
    printed = [x for x in done.out.splitlines() if x.startswith("requirement ")]
    assert len(printed) == 4
    assert [f"    {line}" for line in printed] == re.findall(r"^ {4}requirement .*$", page, re.M)
