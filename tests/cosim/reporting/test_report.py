"""``report.html``: one file without requests, whose numbers are those of the run."""

from __future__ import annotations

import base64
import json
import re
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.units import printed_unit
from cosim.measure.metric_result import MetricResult
from cosim.record import Run
from cosim.reporting import diagnostics, html, run_report
from cosim.reporting.html import Badge, PageData, PlottedPanel, TimedEvent, histogram
from cosim.reporting.run_report import verdict, write_report
from cosim.reporting.thinning import thin
from fmus.arms import chain
from fmus.models import arm, planar2r
from tests.cli.command import Command
from tests.cli.conftest import cosim as cosim  # the command as a fixture
from tests.system.runs import run as simulated
from tests.system.runs import teleoperation

URDF = Path(__file__).parents[3] / "configs" / "robots" / "openarm_right.urdf"
#: As ``run.json`` has a finding.
FOUND = {
    "rule": "no-integral", "severity": "warning", "where": "master_control", "number": 0.5,
    "unit": "1", "reason": "alpha < 1 & late", "advice": "set alpha",
}  # fmt: skip


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, str]:
    """The report of two seconds of the teleoperator, with a title that could break a page."""
    document = teleoperation(stop=2.0) | {"title": "Master & slave </script><b>"}
    positions = {"y": ["master.q[0]", "slave.q[0]"], "labels": ["master", "slave"]}
    document["figures"] = {"positions": {"panels": [{**positions, "reference": [3.5]}]}}
    further = {"command": "cosim run 'x & y.toml'", "findings": [FOUND]}
    run = simulated(document, tmp_path_factory.mktemp("run") / "run", further)
    path = write_report(run)
    assert path.name == "report.html"
    return run, path.read_text(encoding="utf-8")


def data(text: str) -> Any:
    """What the page draws, decoded as a browser does."""
    (document,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text)
    return json.loads(document)


def decoded(signal: Any) -> tuple[np.ndarray, np.ndarray]:
    rows = np.frombuffer(base64.b64decode(signal["i"]), "<u4")
    return rows * signal["dt"], np.frombuffer(base64.b64decode(signal["y"]), "<f4")


def test_the_page_needs_nothing_from_elsewhere(page: tuple[Run, str]) -> None:
    _, text = page
    own = text.replace(html._asset("uPlot.iife.js"), "")
    assert not re.findall(r"""(?:src|href)\s*=|url\(|@import|https?://(?!www\.w3\.org)""", own)
    assert "default-src 'none'" in text
    assert len(text.encode()) < 600_000
    assert escape("Master & slave </script><b>") in text and "</script><b>" not in text
    assert escape("cosim run 'x & y.toml'") in text


def test_signals_are_those_of_the_run(page: tuple[Run, str]) -> None:
    run, text = page
    found = data(text)
    assert found["end"] == run.t[-1] == 2.0
    assert {n for n in found["signals"] if not n.startswith("age of")} == set(run.names)
    for name in ("master.q[0]", "slave.tau_h[1]"):
        t, y = decoded(found["signals"][name])
        column = run.column(name)
        assert y.tolist() == column[np.round(t * 1000).astype(int)].astype(np.float32).tolist()
        assert (y.min(), y.max()) == (np.float32(column.min()), np.float32(column.max()))
        assert found["signals"][name]["unit"] == printed_unit(run.unit(name))


def test_it_has_what_the_check_before_the_run_found(page: tuple[Run, str]) -> None:
    run, text = page
    row = [FOUND[k] for k in ("severity", "where", "reason", "advice", "rule")]
    assert "".join(f"<td>{escape(str(cell))}</td>" for cell in row) in text
    nothing = diagnostics.findings({**run.metadata, "findings": []})
    assert "no error and no warning" in nothing
    assert "no error" not in diagnostics.findings({})  # nobody has looked
    assert "Not checked." in diagnostics.findings({})


def test_controllers_have_a_row_for_each_recorded_signal(page: tuple[Run, str]) -> None:
    run, text = page
    part = text[text.index("Controllers</summary>") :]
    x = run.column("slave_control.theta_hat[1]")
    cells = re.search(r"<td>slave_control.theta_hat\[1\]</td>(.*?)</tr>", part)
    assert cells is not None
    numbers = re.findall(r"<td[^>]*>(.*?)</td>", cells[1])
    last = np.ptp(x[int(len(x) * 0.9) :])
    rms = np.sqrt(np.mean(x**2))
    assert numbers[:-1] == [
        "kg·m²",
        *(f"{v:.4g}" for v in (x[0], x[-1], x.min(), x.max(), rms, last)),
    ]
    assert "<td>master.q[0]</td>" not in part  # a plant's


def test_a_signal_that_a_limit_cuts_off_is_seen_at_it() -> None:
    x = np.clip(np.linspace(-1.0, 1.0, 201), -0.25, 0.25)
    cut, still = diagnostics._SignalRange(201), diagnostics._SignalRange(5)
    for part in (x[:70], x[70:]):
        cut.add(part)
    still.add(np.zeros(5))
    at_greatest = int((np.abs(x) == cut.magnitude).sum())
    assert [*cut.texts("N", at_greatest)][-1] == f"{100 * 152 / 201:.3g} %"
    assert [*still.texts("N", 5)][-1] == "–"


def test_delays_of_used_samples_stand_beside_the_configured_law(page: tuple[Run, str]) -> None:
    text = page[1]
    name = "master_control.xi → slave_control.xi_in[0]"
    row = re.search(rf"<td>{re.escape(name)}</td><td>(.*?)</td><td[^>]*>(.*?) to (.*?) s<", text)
    assert row is not None and row[1] == "0.3 to 1.2\u00a0s, held 30\u00a0ms"
    assert 0.3 <= float(row[2]) < float(row[3]) <= 1.2


@pytest.mark.parametrize(
    ("law", "text"),
    [
        ({"law": "constant", "delay": 0.02, "hold": None}, "20 ms"),
        (
            {"law": "gamma", "shift": 3e-3, "shape": 0.5, "sha256": "x"},
            "gamma, shift 3 ms, shape 0.5",
        ),
        ({"law": "trace", "file": "a/b.csv", "repeat": True}, "trace, b.csv, repeat"),
        ({"law": "markov", "levels": [0.05, 2.0]}, "markov, levels 50 ms / 2 s"),
        ({"law": "sum", "of": [{"law": "constant", "delay": 0.2}]}, "sum, of (200 ms)"),
        ({}, ""),
    ],
)
def test_a_delay_law_has_units(law: Any, text: str) -> None:
    assert diagnostics.configured_delay(law) == text


def test_diagrams_are_those_that_the_scenario_declares(page: tuple[Run, str]) -> None:
    first = data(page[1])["panels"][0]
    assert [s["name"] for s in first["series"]] == ["master.q[0]", "slave.q[0]"]
    assert [s["label"] for s in first["series"]] == ["master", "slave"]
    assert (first["reference"], first["unit"]) == ([3.5], "rad")


def test_ages_of_links_are_those_of_their_tables(page: tuple[Run, str]) -> None:
    found = data(page[1])
    t, age = decoded(found["signals"]["age of master_control.xi->slave_control.xi_in[0]"])
    held = age[np.isfinite(age)]
    assert 0.3 <= held.min() < held.max() <= 1.2 + 1e-6  # the law's
    assert t[-1] == pytest.approx(1.995)


def test_arms_move_as_the_run_does(page: tuple[Run, str]) -> None:
    run, text = page
    found = data(text)
    assert [a["name"] for a in found["arms"]] == ["master", "slave"]
    for arm_ in found["arms"]:
        assert arm_["planar"] and arm_["reach"] == 2.0
        for i, frames in enumerate(arm_["q"]):
            q = np.frombuffer(base64.b64decode(frames), "<f4")
            times = np.minimum(np.arange(len(q)) * found["frame"], run.t[-1])
            truth = np.interp(times, run.t, run.column(f"{arm_['name']}.q[{i}]"))
            assert q == pytest.approx(truth, abs=1e-6)


def test_an_arm_from_a_urdf_is_drawn_by_its_table() -> None:
    options = {"urdf": str(URDF), **_ends(URDF)}
    drawn = arm.drawing(options, Path())
    assert drawn is not None and drawn.joints == 7 and not drawn.planar
    table = chain.of_values(
        {k: np.array(v) for k, v in arm.prepare(options, Path()).values.items()}
    )
    q = np.linspace(-1, 1, 7)
    R, p = np.eye(3), np.zeros(3)
    for i, (turned, place) in enumerate(chain.placements(table, q)):
        p = p + R @ np.array(drawn.origins[i])
        R = R @ np.reshape(drawn.rotations[i], (3, 3)) @ _rz(q[i])
        assert turned == pytest.approx(R) and place == pytest.approx(p)
    assert arm.drawing({}, Path()) is None
    assert planar2r.drawing({}, Path()).data()["reach"] == 2.0


def _ends(urdf: Path) -> dict[str, str]:
    from cosim.base import toml

    scenario = toml.read(urdf.parents[1] / "openarm.toml")
    return {k: scenario["components"]["master"]["options"][k] for k in ("base", "tip")}


def _rz(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


SETTLED = MetricResult("e", "error", 0.1, "rad", parts={"settle_s": 3.25})
NEVER = MetricResult("e", "error", 0.1, "rad", parts={"settle_s": float("inf")})


@pytest.mark.parametrize(
    ("facts", "results", "word", "reason"),
    [
        ({"status": "finished"}, (), "finished", "no bound to judge by"),
        ({"status": "finished"}, (SETTLED,), "passed", "within it from 3.25 s on"),
        ({"status": "finished"}, (SETTLED, NEVER), "failed", "error: never within its bound"),
        ({"status": "stopped", "error": "RunError: x"}, (SETTLED,), "error", "x"),
        ({"status": "running"}, (), "error", "the run is running"),
    ],
)
def test_verdicts(page: Any, facts: Any, results: Any, word: str, reason: str) -> None:
    from cosim.reporting.recorded import recorded_scenario

    found = verdict(facts, recorded_scenario(page[0]), results)
    assert found.word == word and reason in found.reason
    assert f'class="verdict {word}"' in found.html


def test_events_diagrams_and_distributions() -> None:
    page = PageData(2.0, events=[TimedEvent(1.0, "drop", 1.5), TimedEvent(0.5, "stop")])
    values = np.sin(np.arange(50_000) / 500)
    page.add("x", "m", values, 1e-3, 500)
    page.panels.append(PlottedPanel("x", "m", (("x", "x"),)))
    found = json.loads(page.text())
    assert found["events"] == [{"t": 1.0, "label": "drop", "to": 1.5}, {"t": 0.5, "label": "stop"}]
    t, y = decoded(found["signals"]["x"])
    assert len(y) <= 500 and np.round(t * 1000).astype(int).tolist() == thin(values, 500).tolist()
    drawn = histogram("x", "m", values, {"p50": 0.0})
    assert sum(int(n) for n in re.findall(r": (\d+)</title>", drawn)) == values.size
    assert histogram("x", "m", np.array([np.nan]), {}) == ""
    assert "p50 0" in drawn


def test_the_command_writes_it_again(cosim: Command) -> None:
    from tests.cli.command import CONFIG

    assert cosim("run", CONFIG, "--set", "run.stop=0.2", "--out", "here", "--no-plot").code == 0
    assert not Path("here/report.html").exists()
    done = cosim("report", "here", "--pdf")
    assert (done.code, done.err) == (0, "") and "here/report.html" in done.out
    assert Path("here/positions.pdf").read_bytes().startswith(b"%PDF")
    Path("here/report.html").write_text("old")
    assert cosim("report", "here").code == 0  # its sum is written anew
    assert cosim("diff", "here", "here").code == 0
    assert "no such run folder" in cosim.refused("report", "gone")


def test_a_verdict_is_text() -> None:
    assert Badge("error", "why & how").html.endswith("why &amp; how</p>")


def test_a_comparison_marks_the_best_and_the_worst_cells() -> None:
    from types import SimpleNamespace

    from cosim.comparison.page import _marks
    from cosim.comparison.rows import ComparisonRow
    from cosim.comparison.spec import PortMeasure
    from cosim.comparison.variants import MetricColumn
    from cosim.measure.metrics import Measure

    def row(value: float, stable: bool = True) -> ComparisonRow:
        verdict_ = SimpleNamespace(ended=True, stable=stable)
        outcome: Any = SimpleNamespace(verdict=verdict_, numbers={"x": (value, "s")}, errors={})
        return ComparisonRow("lan", "free", "law", False, (outcome,))

    column = MetricColumn("x", "x", "", Measure("x", "peak", ("a.q",)), ())
    never = float("inf")
    assert _marks([row(3.0), row(1.0), row(2.0), row(0.5, stable=False)], column, "s") == {
        0: " worst", 1: " best",
    }  # fmt: skip
    assert _marks([row(3.0), row(never), row(1.0), row(never)], column, "s") == {
        1: " worst", 2: " best", 3: " worst",
    }  # fmt: skip
    assert _marks([row(1.0), row(1.0)], column, "s") == {}
    assert _marks([row(1.0)], column, "s") == {}
    port = MetricColumn("x", "x", "", PortMeasure(kind="damping"), ())
    assert _marks([row(1.0), row(2.0)], port, "s") == {}


def test_two_runs_side_by_side(cosim: Command) -> None:
    from xml.etree import ElementTree

    from tests.cli.command import CONFIG

    short = ("run", CONFIG, "--set", "run.stop=1", "--no-plot", "--quiet")
    cosim(*short, "--out", "a")
    cosim(*short, "--out", "b", "--set", "components.master.start.q=[0, 0]")
    done = cosim("diff", "a", "b", "--html", "d.html", "--junit", "d.xml")
    assert done.code == 1
    suite = ElementTree.parse("d.xml").getroot()
    cases = {c.get("name"): c.find("failure") for c in suite}
    assert int(suite.get("tests", "")) == len(cases)
    assert int(suite.get("failures", "")) == sum(f is not None for f in cases.values()) > 0
    failure = cases["master.q[0]"]
    assert failure is not None and "largest 1.111 rad at 0.777 s" in failure.get("message", "")
    found = data(Path("d.html").read_text(encoding="utf-8"))
    first = found["panels"][0]["series"]
    assert [s["label"] for s in first] == ["a", "b"]
    assert len(found["panels"]) == 6 and {s["name"] for s in first} <= set(found["signals"])
    assert 'class="verdict different"' in Path("d.html").read_text(encoding="utf-8")
    assert cosim("diff", "a", "a", "--junit", "e.xml").code == 0
    assert ElementTree.parse("e.xml").getroot().get("failures") == "0"


def test_on_paper_rows_stay_whole_and_headings_stay_with_their_text() -> None:
    """A table that must not break at all goes to the next page and leaves its heading alone."""
    style = html.page_text("t", "", Badge("finished", ""), "", PageData(1.0), "")
    paper = style.split("@media print", 1)[1].split("\n}", 1)[0]
    whole = re.findall(r"([^{}]*)\{ break-inside: avoid; \}", paper)
    assert [x.strip() for x in whole[0].split(",")] == ["figure", ".card", ".aside", "tr"]
    assert re.search(r"h2, h3[^{}]*\{ break-after: avoid; \}", paper)
    assert ".top { grid-template-columns: minmax(0, 1fr); }" in paper


def test_a_component_has_one_colour_in_every_diagram_and_in_the_picture() -> None:
    """Where each curve is of another arm; else colours are those of the order of the curves."""
    inputs = {"law": {"q": "slave.q"}, "both": {"a": "slave.q", "b": "master.q"}}
    components = {name: {"inputs": wires} for name, wires in inputs.items()} | {"master": {}}
    signals = {
        "apart": ("law.x", "master.q[0]"),
        "one arm": ("slave.q[0]", "law.x"),
        "no arm": ("master.q[0]", "hand.f"),
        "two arms feed it": ("both.x",),
    }
    panels = [
        html.PlottedPanel(title, "m", tuple((name, name) for name in names))
        for title, names in signals.items()
    ]
    facts = {"scenario": {"components": components}}
    found = run_report.coloured(panels, ["master", "slave"], facts)
    assert [panel.colours for panel in found] == [(1, 0), (), (), ()]
    assert [one.get("colour") for one in found[0].data()["series"]] == [1, 0]
