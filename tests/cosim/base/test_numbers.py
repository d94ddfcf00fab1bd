"""Which numbers are numbers: the same for files, ``--set``, texts with a unit and options."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from cosim.base import toml
from cosim.base.errors import ScenarioError, UnitError
from cosim.base.units import quantity
from cosim.cli.commands import app
from cosim.loading.files import load, read_document
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build

SCENARIO = "configs/teleoperation.toml"
BAD = ("nan", "inf", "-inf", "5e-324", "1e-160", "1e160", "9223372036854775808", "1" * 400)
#: A place for a number in each kind of file: what comes before it, and the file it belongs to.
SETTINGS = (
    "components.master.period",
    "components.master.parameters.k_p",
    "run.step",
    "run.stop",
    "run.seed",
    "links.0.delay.high",
    "links.0.playout",
    "metrics.sync_error.within",
)


@pytest.mark.parametrize("number", BAD)
@pytest.mark.parametrize("key", SETTINGS)
def test_a_setting_is_a_number_to_compute_with(key: str, number: str) -> None:
    with pytest.raises(ScenarioError, match=r"--set .*: found "):
        load(SCENARIO, [f"{key}={number}"])


@pytest.mark.parametrize("number", BAD)
def test_every_file_is_read_by_the_same_rule(tmp_path: Path, number: str) -> None:
    """Scenarios, deployments, studies, fault scripts, campaigns, graphs, profiles of drives."""
    from bridge.campaign.soak_spec import load_soak
    from bridge.campaign.spec import load_campaign
    from bridge.deployment.spec import load as load_deployment
    from bridge.drives.profile_files import load_profile
    from bridge.faults.load import load as load_faults
    from cosim.comparison.variants_file import read as read_variants
    from cosim.graphs.named import read_graphs
    from cosim.study.study import load_study

    path = tmp_path / "x.toml"
    path.write_text(f"[a]\nb = [1, {{ c = {number} }}]\n")
    readers = (
        load, load_deployment, load_study, load_faults, load_campaign, read_graphs, load_profile,
        read_variants, lambda p: load_soak(SCENARIO, p),
    )  # fmt: skip
    for reader in readers:
        with pytest.raises(ScenarioError, match=r"x\.toml at a\.b\[1\]\.c: found "):
            reader(str(path))


def test_a_parsed_document_is_held_to_it_too() -> None:
    document = read_document(SCENARIO)
    document["run"]["stop"] = float("inf")
    with pytest.raises(ScenarioError, match=r"at run\.stop: found inf; expected a finite number"):
        build(document, SCENARIO)


@pytest.mark.parametrize("text", ["nan s", "inf s", "1e999 s", "1e-200 s", "1e149 h"])
def test_a_text_with_a_unit_is_held_to_it_too(text: str) -> None:
    with pytest.raises(UnitError, match="expected a finite number"):
        quantity(text, "s")


@pytest.mark.parametrize("setting", ["run.stop=1e14", "run.step=1e-140", 'run.stop="1e100 s"'])
def test_a_run_has_no_more_ticks_than_can_be_counted(setting: str) -> None:
    with pytest.raises(ScenarioError, match=r"base steps of .* expected at most 9\.01e"):
        assemble(load(SCENARIO, [setting]))


def test_zero_and_all_of_the_middle_are_numbers() -> None:
    for text in ("0", "0.0", "-0.0", "1e-150", "-1e150"):
        assert toml.parse(f"x = {text}", "here")["x"] == float(text)
    assert toml.parse(f"x = {2**63 - 1}", "here")["x"] == 2**63 - 1


def test_a_deep_or_long_document_is_a_sentence() -> None:
    for text in ("x = " + "[" * 5000, "x = " + "1" * 5000):
        with pytest.raises(ScenarioError, match=r"here: not valid TOML|more than 64 bits"):
            toml.parse(text, "here")


@pytest.mark.parametrize("number", ["nan", "inf", "1e-300"])
@pytest.mark.parametrize(
    "arguments",
    [
        ["soak", SCENARIO, "--hours"],
        ["ping", SCENARIO, "--rate"],
        ["analyze", SCENARIO, "--lowest"],
    ],
)
def test_an_option_is_held_to_it_too(arguments: list[str], number: str) -> None:
    result = CliRunner().invoke(app, [*arguments, number])
    assert result.exit_code == 2, result.output
    assert "Invalid value" in result.output
    assert result.exception is None or isinstance(result.exception, SystemExit)
