"""``cosim node`` alone is checked like a rehearsal, before it opens a bus or makes a folder."""

from __future__ import annotations

from typer.testing import CliRunner

from cosim.cli.commands import app
from tests.bridge.deployments import TELEOPERATION, document, written


def refused(folder, found, *options):
    """What it says, of a node that does not start."""
    words = ["node", str(TELEOPERATION), "--deploy", str(written(found, folder))]
    out = folder / "run"
    result = CliRunner().invoke(
        app, [*words, "--node", "master_control", "-i", "virtual", "--out", str(out), *options]
    )
    assert result.exit_code != 0 and not out.exists()
    return f"{result.output} {result.exception or ''}"


def test_two_parties_with_one_identifier_are_refused(tmp_path):
    found = document("can")
    found["messages"]["LINK_2"]["name"] = "LINK_4"
    found["buses"]["right"]["channel"] = found["buses"]["left"]["channel"]
    for message in found["messages"].values():
        message["bus"] = "left"
    assert "identifier 0x" in refused(tmp_path, found)


def test_a_warning_is_said_and_with_strict_it_is_refused(tmp_path):
    found = document("can")
    del found["set"]["components.master_control.parameters.tau_max"]
    text = refused(tmp_path, found, "--strict")
    assert "check: " in text and "the estimates wind up" in text
