"""The files of a failure: the scenario, both runs, commands for a real network, and a test."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.errors import RunError
from cosim.base.files import write_file
from cosim.base.random_numbers import generator
from cosim.engine.simulate import simulate
from cosim.falsify import words
from cosim.falsify.evaluation import Problem
from cosim.falsify.execute import Falsification
from cosim.falsify.page import write_comparison
from cosim.falsify.paths import Candidate, as_law
from cosim.falsify.scenario_text import failing_document, text
from cosim.links.laws import decimal_fraction
from cosim.links.netem import LIMIT
from cosim.links.segments import Segments
from cosim.measure.requirements import of_run
from cosim.record import Run, seal
from cosim.reporting.run_report import write_report
from cosim.scenario.spec import build

FAILING, NETEM, TEST = "failing.toml", "netem.sh", "test_failing.py"
#: The time of a step of netem on a ramp, s.
STAIR = 0.02
#: Folders of the two runs.
RUNS = ("failing", "nominal")


def write(
    state: Falsification, document: Mapping[str, Any], folder: Path, repeat: str
) -> Iterator[tuple[str, Path]]:
    """Write the files of a failure: what each is, and its path.

    `document`: the scenario as parsed, with its settings; `repeat`: the command that searched.
    Raises CosimError.
    """
    problem, small = state.problem, state.small
    assert small is not None and state.found is not None
    nominal = Candidate(problem.nominal.paths, small.axes, small.ticks)
    found: dict[str, dict[str, Any]] = {}
    for name, candidate in zip(RUNS, (small, nominal), strict=True):
        found[name] = failing_document(problem, document, candidate, folder)
    comments = [
        f"{words.sentence(state)}.",
        f"Found by: {repeat}",
        f"Run it: cosim run {folder / FAILING}",
    ]
    write_file(folder / FAILING, text(found["failing"], comments))
    yield "scenario", folder / FAILING
    runs = [_run(found[name], folder / FAILING, folder / name) for name in RUNS]
    _require_failure(state.found.requirement, found["failing"], folder, runs[0])
    yield "report", write_comparison(state, runs[0], runs[1], folder, repeat)
    write_file(folder / NETEM, netem_script(problem, small))
    yield "tc netem", folder / NETEM
    write_file(folder / TEST, test_text(state))
    yield "test", folder / TEST


def _require_failure(name: str, document: Mapping[str, Any], folder: Path, run: Run) -> None:
    """Raise RunError if the run of the file that was written does not violate the requirement."""
    verdicts = {r.name: r.verdict for r in of_run(build(document, folder / FAILING), run)}
    if verdicts[name] != "failed":
        raise RunError(
            f"{folder / FAILING}: {name} is {verdicts[name]} when the file runs alone, expected it "
            "to fail as in the search"
        )


def _run(document: Mapping[str, Any], path: Path, folder: Path) -> Run:
    """Run a document into a folder, also if it fails on the way."""
    with suppress(RunError):
        simulate(build(document, path), folder, force=True)
    run = Run.open(folder)
    report = write_report(run)
    seal(folder, changed=[report.name])
    return run


# ---- a real network -----------------------------------------------------------------------------


def netem_script(problem: Problem, candidate: Candidate) -> str:
    """A shell script that does nearly the same to a real interface, one call a link."""
    lines = [
        "#!/bin/sh",
        "# The network of failing.toml on a real interface, nearly: netem.sh LINK DEV, as root, on",
        "# the host that sends, when the run starts. netem delays packets when they are sent.",
        "set -e",
        'set_to() { tc qdisc replace dev "$dev" root netem "$@"; }',
        'dev=${2:?"expected LINK DEV"}',
        'case "$1" in',
    ]
    for channel, path in zip(problem.channels, problem.kept(candidate), strict=True):
        law = as_law(channel.law(path), channel.nominal, candidate.ticks)
        commands = _netem(law, channel.step * problem.h, candidate.ticks * problem.h)
        lines += [f"'{channel.name}')", *(f"    {x}" for x in commands)]
        lines.append("    ;;")
    return "\n".join([*lines, '*) echo "unknown link $1" >&2; exit 2 ;;', "esac", ""])


def _netem(law: Segments, period: float, end: float) -> Iterator[str]:
    """The commands of one link, whose packets are sent every `period` (s), until `end` (s)."""
    waiting = int(law.maximum / period) + 2
    limit = f"limit {waiting} " if waiting > LIMIT else ""
    now, before = 0.0, law.delay
    for begin, delay in _changes(law, end):
        if begin > now:
            yield f"sleep {begin - now:.6g}"
        now, before = begin, before if delay != delay else delay
        loss = " loss 100%" if delay != delay else ""
        yield f"set_to {limit}delay {1e6 * before:.0f}us{loss}"


def _changes(law: Segments, end: float) -> Iterator[tuple[float, float]]:
    """(when, s, and to what, s, NaN: lost) the delay changes; ramps are stairs."""
    if law.rise is law.fall is None:
        found = {0.0: law.delay}
        for x in law.segments:
            found |= {x.begin: x.value, x.end: law.delay}
        yield from found.items()
        return
    h = decimal_fraction(STAIR)
    delays = law.stream(h, generator(0, "netem")).take(int(end / h) + 1)
    new = np.flatnonzero(np.append(True, ~np.isclose(delays[1:], delays[:-1], equal_nan=True)))
    yield from ((float(k * h), float(delays[k])) for k in new.tolist())


# ---- a test -------------------------------------------------------------------------------------


def test_text(state: Falsification) -> str:
    """A test for pytest that holds the failure, until it is repaired."""
    assert state.found is not None
    name = state.found.requirement
    return f'''"""A network that violates {name}.

Once the controller is repaired, this test fails as XPASS. Then remove the mark.
"""

import pytest
from cosim.base.errors import RunError

FAILS = pytest.mark.xfail(
    raises=(AssertionError, RunError), strict=True, reason="cosim falsify has found this network"
)


@FAILS
def test_{_identifier(name)}_holds(cosim_run):
    run = cosim_run("{FAILING}", set={{"run.seed": 0}})
    assert run.passes("{name}")
'''


def _identifier(name: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in name)
