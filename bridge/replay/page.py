"""A comparison of two runs as a page to look at, and as JUnit XML for a CI server."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree

from bridge.replay.diff import RunDifference, SignalDifference
from cosim.base.errors import RunError
from cosim.record import Run
from cosim.record.piecewise import first_step
from cosim.reporting.html import Badge, PageData, PlottedPanel, cards, table, write_page
from cosim.reporting.thinning import thinned

#: Diagrams of the page: the signals that differ most.
PANELS = 6
#: Points of a signal.
POINTS = 2000


def write_diff_page(found: RunDifference, path: Path) -> Path:
    """Write both runs over time, the signals that differ most first.

    Raises CosimError if it cannot be written.
    """
    names = found.names
    runs = dict(zip(names, (Run.open(found.a), Run.open(found.b)), strict=True))
    data = PageData(found.t_end)
    for signal in found.signals[:PANELS]:
        series = []
        for label, run in runs.items():
            name = f"{label}: {signal.name}"
            kept = thinned(run, [signal.name], POINTS)[signal.name]
            data.add_thinned(name, signal.unit, kept, first_step(run, 1.0))
            series.append((name, label))
        data.panels.append(PlottedPanel(signal.name, signal.unit, tuple(series)))
    if found.signals:
        data.start = found.signals[0].at
    badge = Badge(found.verdict, found.reason())
    numbers = [("rows compared", str(found.rows)), ("until", f"{found.t_end:g} s")]
    numbers += [("largest difference", _largest(found.signals[0]))] if found.signals else []
    return write_page(
        path, f"{names[0]} and {names[1]}", f"cosim diff {found.a} {found.b}", badge,
        cards(numbers), data, _tables(found),
    )  # fmt: skip


def _largest(signal: SignalDifference) -> str:
    return f"{signal.largest:.3g} {signal.unit} at {signal.at:g} s"


def _tables(found: RunDifference) -> str:
    head = ["signal", "verdict", "unit", "RMS", "largest", "at", "RMS may be"]
    a, b = found.names
    rows = [
        (s.name, _word(s), s.unit, f"{s.rms:.3g}", f"{s.largest:.3g}", f"{s.at:g} s",
         f"{s.bound_rms:.3g}")
        for s in found.signals
    ]  # fmt: skip
    metrics = [
        (m.label, m.unit, f"{m.a:.5g}", f"{m.b:.5g}", f"{m.b - m.a:.2g}") for m in found.metrics
    ]
    text = f"<h2>Signals</h2>{table(head, rows, 4)}"
    if found.requirements:
        required = [(r.name, r.condition, r.a.text, r.b.text) for r in found.requirements]
        words = ["different" if r.changed else "equal" for r in found.requirements]
        head = ["requirement", "condition", a, b]
        text += f"<h2>Requirements</h2>{table(head, required, marks=words)}"
    if metrics:
        text += f"<h2>Metrics</h2>{table(['metric', 'unit', a, b, 'difference'], metrics, 3)}"
    return text


def _word(signal: SignalDifference) -> str:
    if signal.largest == 0.0:
        return "identical"
    return "not judged" if not signal.judged else "equal" if signal.within else "different"


def write_junit(found: RunDifference, path: Path) -> Path:
    """Write a test case for each signal that is judged, for each requirement, which fails where it
    passes on the first run and not on the second, and one for the length of the runs.

    Raises RunError if the file cannot be written.
    """
    judged = [s for s in found.signals if s.judged]
    lost = [r for r in found.requirements if r.changed and r.a.verdict == "passed"]
    failed = sum(not s.within for s in judged) + len(lost) + (not found.same_span)
    count = len(judged) + len(found.requirements) + 1
    suite = ElementTree.Element(
        "testsuite", name=f"cosim diff {found.a} {found.b}", tests=str(count),
        failures=str(failed), errors="0", skipped="0",
    )  # fmt: skip
    for s in judged:
        case = ElementTree.SubElement(
            suite, "testcase", classname="cosim.signals", name=s.name, time=f"{found.t_end:g}"
        )
        if not s.within:
            message = (
                f"largest {s.largest:.4g} {s.unit} at {s.at:g} s, RMS {s.rms:.4g}; expected at "
                f"most {s.bound:.4g}, RMS {s.bound_rms:.4g}"
            )
            ElementTree.SubElement(case, "failure", message=message)
    for r in found.requirements:
        case = ElementTree.SubElement(
            suite, "testcase", classname="cosim.requirements", name=r.name
        )
        if r in lost:
            ElementTree.SubElement(case, "failure", message=r.text)
    case = ElementTree.SubElement(suite, "testcase", classname="cosim.runs", name="length")
    if not found.same_span:
        ElementTree.SubElement(case, "failure", message=found.reason())
    try:
        ElementTree.ElementTree(suite).write(path, encoding="utf-8", xml_declaration=True)
    except OSError as error:
        raise RunError(f"cannot write {path}: {os.strerror(error.errno or 0)}") from error
    return path
