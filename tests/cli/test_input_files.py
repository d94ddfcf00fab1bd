"""Inputs that are no files, or nothing but levels: a sentence at once."""

from __future__ import annotations

import json
import os
import warnings
from pathlib import Path

import pytest

from cosim.checks.preflight import check
from cosim.loading.files import load
from cosim.scenario.assemble import assemble
from tests.cli.command import CONFIG, Command


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from cosim.engine.simulate import simulate

    folder = tmp_path_factory.mktemp("runs") / "run"
    simulate(load(CONFIG, ["run.stop=0.1"]), folder)
    (folder / "SHA256SUMS").unlink()
    return folder


@pytest.mark.parametrize("words", [("check",), ("run",), ("show",), ("sweep",), ("info",)])
@pytest.mark.parametrize("what", ["a pipe", "a device"])
def test_what_is_no_file_is_not_read(cosim: Command, words: tuple[str, ...], what: str) -> None:
    os.mkfifo("pipe.toml")
    path = "pipe.toml" if what == "a pipe" else "/dev/zero"
    assert f"it is {what}, not a file" in cosim.refused(*words, path)


def test_an_fmu_that_is_a_pipe_is_not_read(cosim: Command) -> None:
    os.mkfifo("pipe.fmu")
    assert "it is a pipe, not a file" in cosim.refused("run", "pipe.fmu")


@pytest.mark.parametrize("text", [".".join(["a"] * 1000) + " = 1", "a = " + "[" * 60 + "]" * 60])
def test_tables_in_each_other_have_an_end(cosim: Command, text: str) -> None:
    Path("deep.toml").write_text(text, encoding="utf-8")
    assert (
        cosim.refused("check", "deep.toml") == "deep.toml: found more than 50 tables in each other"
    )


@pytest.mark.parametrize(
    ("entry", "value", "place"),
    [
        ("step", "text", "step"), ("links", [], "links"), ("ended", {"a": 1}, "ended"),
        ("findings", [{"rule": 3}], "findings[0].rule"), ("order", None, "order"),
        ("scenario", {"components": {"a": 1}}, "scenario.components[...]"),
        ("versions", {"numpy": 2}, "versions[...]"), ("scenario", 7, "scenario"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("command", ["report", "show"])
def test_an_entry_of_another_type_is_named(
    cosim: Command, run_folder: Path, command: str, entry: str, value: object, place: str
) -> None:
    file = run_folder / "run.json"
    kept = file.read_bytes()
    file.write_text(json.dumps(json.loads(kept) | {entry: value}))
    try:
        done = cosim(command, run_folder)
    finally:
        file.write_bytes(kept)
    assert done.code == 2
    assert f"{file} at {place}: " in done.err and "Traceback" not in done.err


def test_a_controller_without_gain_is_checked_without_a_warning_of_numpy() -> None:
    """Its arm feels no damping, and the port is not passive."""
    zero = [f"components.{side}_control.parameters.K=0" for side in ("master", "slave")]
    scenario = load(CONFIG, zero)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        found = {f.rule: f.reason for f in check(scenario, assemble(scenario))}
    assert "0 N.m.s/rad" in found["felt-damping"] and "not passive" in found["passivity"]
