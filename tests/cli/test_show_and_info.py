"""``cosim show``, ``cosim info``, ``--version`` and ``--help``."""

from __future__ import annotations

from pathlib import Path

import pytest

import cosim as package
from cosim.cli import info
from fmus.models import operator, planar2r, teleoperation
from tests.cli.command import CONFIG, Command, finished
from tests.cosim.fmi.exporter import clocked3, export


def section(text: str, title: str) -> list[list[str]]:
    """Lines of a section, cut where two spaces or more are."""
    lines = text.split(f"\n{title}\n")[1].split("\n\n")[0].splitlines()
    return [[part.strip() for part in line.split("  ") if part.strip()] for line in lines]


def test_show_prints_the_graph_the_rates_the_order_and_why(cosim: Command) -> None:
    done = cosim("show", CONFIG)
    assert (done.code, done.err) == (0, "")
    assert "base step 0.001 s, 60000 ticks (60 s), algorithm sampled, seed 0" in done.out
    components = {row[0]: row[1:] for row in section(done.out, "components")}
    assert components["master"][:2] == ["continuous", "every 0.001 s (1 tick)"]
    assert components["slave_control"][:2] == ["sampled", "every 0.005 s (5 ticks)"]
    assert components["master"][-1] == "planar2r.fmi2.fmu, FMI 2.0"
    order = section(done.out, "order within tick k")
    assert [row[1] for row in order] == [
        "master_control", "slave_control", "record", "master", "slave",
    ]  # fmt: skip
    assert order[0][2:] == [
        "sample, compute, hold", "k mod 5 = 0", "waits for no other in this tick",
    ]  # fmt: skip


def test_show_says_what_every_input_samples_and_holds(cosim: Command) -> None:
    inputs = {
        row[0]: row[2:] for row in section(cosim("show", CONFIG).out, "what each input samples")
    }
    assert inputs["master_control.q"] == ["master.q", "value at t_k, holds it 0.005 s"]
    assert inputs["master.tau"][0] == "master_control.tau"
    assert inputs["master.tau"][1] == "computed when last due, k mod 5 = 0, holds it 0.001 s"
    link = ["slave_control.xi", "the sample its link holds at t_k, holds it 0.005 s"]
    assert inputs["master_control.xi_in[0]"] == link
    assert inputs["master.tau_ext"] == ["nothing", "keeps 0 0 [N.m]"]


def test_show_says_why_one_waits_for_the_other(cosim: Command) -> None:
    """The operator as its own component, sampled: its torque is of the same tick."""
    Path("operator.toml").write_text(
        '[run]\nstep = 0.001\nstop = 1\n[components.arm]\nmodel = "fmus.models.planar2r"\n'
        'inputs = { tau_ext = "hand.tau_h", tau = "gain.y" }\n'
        '[components.hand]\nmodel = "fmus.models.operator"\n'
        'inputs = { q = "arm.q", dq = "arm.dq" }\n'
        '[components.gain]\nmodel = "tests.cli.components:Half"\ninputs.u = "hand.tau_h"\n',
        encoding="utf-8",
    )
    done = cosim("show", "operator.toml")
    order = section(done.out, "order within tick k")
    assert [row[1] for row in order] == ["hand", "gain", "record", "arm"]
    assert order[1][-1] == "after hand: samples what they compute in this tick"
    assert "tests.cli.components:Half, Python call-back" in done.out


def test_show_of_jacobi_says_that_everybody_is_late(cosim: Command) -> None:
    text = cosim("show", CONFIG, "--set", "run.algorithm=jacobi").out
    assert section(text, "order within tick k")[0][1] == "record"
    assert "jacobi: everybody sees what the tick before left behind" in text
    assert "computed 0.005 s before, from what was known then" in text


def test_show_has_the_links_with_law_and_semantics(cosim: Command) -> None:
    text = cosim("show", CONFIG, "--set", "links.1.semantics=newest-stamp").out
    signal, newest = section(text, "links")
    assert signal[1] == "signal" and signal[2].startswith("uniform low=0.3")
    assert newest[1] == "newest-stamp"
    assert all(row[-1] == "at least 300 ticks old" for row in (signal, newest))


def test_show_has_weights_and_what_is_left_of_an_input(cosim: Command) -> None:
    Path("parts.toml").write_text(
        '[run]\nstep = 0.005\nstop = 1\n[components.a]\nmodel = "tests.cli.components:Half"\n'
        "start.u = [1, 2]\n"
        '[components.b]\nmodel = "tests.cosim.blocks:Gain"\n'
        '[components.d]\nmodel = "tests.cosim.blocks:Wide"\ninputs = { "u[1]" = "e.y[0]" }\n'
        '[components.e]\nmodel = "tests.cosim.blocks:Wide"\n'
        '[topology]\ngraphs = "ring"\ndwell = 0.15\nweights = { "b.u" = [2, 1] }\n',
        encoding="utf-8",
    )
    inputs = section(cosim("show", "parts.toml").out, "what each input samples")
    assert ["a.u", "<-", "nothing", "keeps 1 2 [N.m]"] in inputs
    assert ["b.u", "<-", "edge [2, 1]", "weight of the edge at t_k"] in inputs
    assert ["d.u[1]", "<-", "e.y[0]", "computed in this tick, holds it 0.005 s"] in inputs
    assert ["d.u[0,0], d.u[0,1], d.u[0,2]", "<-", "nothing", "keeps 0 0 0 [mm]"] in inputs


def test_info_says_what_belongs_to_which_clock(cosim: Command) -> None:
    path = export(clocked3(), Path("clocked.fmu"))
    text = cosim("info", "--no-validate", path).out
    kinds = {line.split()[0]: line for line in text.splitlines() if "put " in line}
    assert "Clock constant" in kinds["fast"] and "Clock triggered of fast" in kinds["echo"]
    assert "Float64 of slow, fast" in kinds["y_both"] and "Int32 of echo" in kinds["y_echo"]


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("model", [planar2r, teleoperation, operator])
def test_info_prints_what_an_fmu_has_and_validates_it(
    cosim: Command, model: object, version: str
) -> None:
    path = model.fmu(version)  # type: ignore[attr-defined]
    done = cosim("info", path)
    assert (done.code, done.err) == (0, "")
    facts = {line[:14].strip(): line[14:] for line in done.out.splitlines()[:9]}
    assert facts["FMI"] == f"{version} co-simulation"
    assert facts["platforms"]
    assert facts["kind"] == model.model().kind  # type: ignore[attr-defined]
    for port in (*model.model().inputs(), *model.model().outputs()):  # type: ignore[attr-defined]
        assert any(
            (f"{port.name}[" in line and port.unit in line) or line.split()[:1] == [port.name]
            for line in done.out.splitlines()
        ), port.name
    assert done.out.rstrip().endswith("validation: FMPy found no problems")
    assert "validation" not in cosim("info", path, "--no-validate").out


def test_info_lists_what_validation_finds(cosim: Command, tmp_path: Path) -> None:
    from tests.cli import broken

    files = broken.edited(
        broken.contents(), 'variableNamingConvention="structured"', 'colour="red"'
    )
    broken.written(files, tmp_path / "wrong.fmu")
    done = cosim("info", "wrong.fmu")
    assert (done.code, done.err) == (0, "")  # it runs all the same
    assert "validation: FMPy found 1 problem:" in done.out and "colour" in done.out
    assert cosim("info", "wrong.fmu", "--strict").code == 1


def test_version_and_help(cosim: Command, tmp_path: Path) -> None:
    assert finished("--version", cwd=tmp_path).out == f"cosim {package.__version__}\n"
    for flag in ("--help", "-h"):
        done = cosim(flag)
        assert done.code == 0
        assert all(command in done.out for command in ("run", "show", "info"))
    done = cosim("run", "--help")
    options = ("--set", "--seed", "--out", "--force", "--csv", "--no-plot", "--quiet")
    assert all(option in done.out for option in options)


def test_show_prints_and_draws_a_simulated_bus(cosim: Command, tmp_path: Path) -> None:
    scenario = CONFIG.parent / "can" / "teleoperation-bus.toml"
    picture = tmp_path / "bus.png"
    done = cosim("show", scenario, "--bus", "can0", "--from", "0.1", "--picture", picture)
    assert done.code == 0, done.err
    assert done.out.startswith("0.020 s: load ")
    assert "\n101 " in done.out and "\n102 " in done.out
    assert picture.stat().st_size > 5000
    done = cosim("show", scenario, "--bus", "can1")
    assert done.code != 0
    assert "no bus 'can1'; did you mean 'can0'?" in done.err
    links = (
        '{from="master_control.xi", to="slave_control.xi_in[0]", delay={law="constant", delay=1}}'
    )
    done = cosim("show", scenario, "--bus", "can0", "--set", f"links=[{links}]")
    assert done.code != 0
    assert "bus.can0: found no link on this bus" in done.err


@pytest.mark.parametrize("columns", [40, 80, 120])
def test_info_fits_the_terminal(
    columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def shown(width: int) -> list[str]:
        monkeypatch.setattr(info, "_columns", lambda: width)
        info.info("fmus.models.planar2r", validate=False)
        return capsys.readouterr().out.splitlines()

    whole, folded = shown(0), shown(columns)
    assert max(map(len, whole)) > columns >= max(map(len, folded))
    words = [" ".join(" ".join(lines).split()).replace(" ", "") for lines in (whole, folded)]
    assert words[0] == words[1]  # a long word, as a sum, is in parts
