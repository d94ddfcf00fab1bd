"""Every master computes the engine's results or is listed with a reason. No times are evaluated."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from benchmarks import entrants, others
from benchmarks.apart import Apart
from benchmarks.cases import Choice
from benchmarks.ours import Ours
from benchmarks.peers import Absent, silence
from benchmarks.race import Contestant, Session, race

TICKS = 30
WITH_PYTHON_API = ("FMPy", "FMPy container", "FMPy container, one call")
#: HELICS has threads of its own and may hang: it is tested in a process that can be ended.
HERE = [e for e in entrants.ENTRANTS if e.name != "HELICS"]


def begun(name: str, case: str, choice: Choice, *, recorded: bool) -> Session:
    request = {"entrant": name, "case": case, "fmi": choice, "recorded": recorded, "ticks": TICKS}
    session, _ = entrants.begin(request)
    assert session is not None
    return session


@pytest.fixture(scope="module", params=[("ring2", "fmi2"), ("ring2", "fmi3"), ("wide4", "fmi2")])
def expected(request: pytest.FixtureRequest) -> tuple[str, Choice, bytes]:
    case, choice = request.param
    plan = next(c for c in entrants.peer_cases(1.0) if c.name == case).plan(choice, TICKS)
    session = Ours(plan)
    session.run(TICKS)
    found = session.outputs()
    session.close()
    return case, choice, found


@pytest.mark.parametrize("name", [e.name for e in HERE])
def test_a_master_computes_the_same_bytes_or_says_why_it_is_absent(
    name: str, expected: tuple[str, Choice, bytes]
) -> None:
    case, choice, bytes_ = expected
    try:
        with silence():
            session = begun(name, case, choice, recorded=entrants.entrant(name).records)
    except Absent as absent:
        assert str(absent)
        assert name not in WITH_PYTHON_API
        return
    try:
        assert session.run(TICKS) > 0.0
        assert session.outputs() == bytes_
    except Absent as absent:  # mosaik is looked for when it runs
        assert "does not import" in str(absent)
    finally:
        session.close()


@pytest.fixture(scope="module")
def apart() -> Iterator[Apart]:
    request = {"entrant": "engine", "case": "ring2", "fmi": "fmi2"}
    process = Apart({**request, "recorded": False, "ticks": TICKS})
    yield process
    process.close()


def test_a_process_apart_runs_and_is_ended_when_it_takes_too_long(apart: Apart) -> None:
    assert apart.run(TICKS) > 0.0
    session = begun("engine", "ring2", "fmi2", recorded=False)
    session.run(TICKS)
    assert apart.outputs() == session.outputs()
    session.close()
    assert apart.memory() > 10.0
    apart.limit = 0.05
    with pytest.raises(Absent, match=r"took more than 0\.05 s"):
        apart.run(10**9)
    with pytest.raises(Absent):
        apart.run(1)


def test_helics_in_its_process_agrees_or_is_named() -> None:
    request = {"entrant": "HELICS", "case": "ring2", "fmi": "fmi2"}
    process = None
    try:
        process = Apart({**request, "recorded": True, "ticks": TICKS}, limit=10.0)
        assert process.run(TICKS) > 0.0
        session = begun("engine", "ring2", "fmi2", recorded=False)
        session.run(TICKS)
        assert process.outputs() == session.outputs()
    except Absent as absent:
        assert str(absent)
    finally:
        if process is not None:
            process.close()


class Tired:
    """A session that fails after `good` blocks."""

    def __init__(self, good: int) -> None:
        self.blocks, self.good = 0, good

    def run(self, ticks: int) -> float:
        self.blocks += 1
        if self.blocks > self.good:
            raise Absent("too tired")
        return 1e-3 * ticks

    def outputs(self) -> bytes:
        return b"0"

    def recorded(self, n: int) -> bytes:
        return b""

    def close(self) -> None:
        self.blocks = -1


def test_who_fails_on_the_way_is_named_and_the_others_go_on() -> None:
    makers = {"fresh": lambda: Tired(99), "tired": lambda: Tired(2), "ill": lambda: Tired(0)}
    contestants = [Contestant(name, make, "fresh") for name, make in makers.items()]
    timings = race(contestants, ticks=20, fmu_steps=1, rounds=4, check=1)
    fresh, tired, ill = (timing.facts() for timing in timings)
    assert fresh["blocks"] == 4
    assert tired == {"runner": "tired", "absent": "too tired"}
    assert ill["absent"] == "too tired"


def test_the_quickest_peer_is_found_among_those_that_ran() -> None:
    rows = [
        {"runner": "engine", "ratio_min": 1.0},
        {"runner": "a, one call", "ratio_min": 2.0},
        {"runner": "b", "ratio_min": 3.0},
        {"runner": "c", "absent": "not installed"},
        {"runner": "engine, recording", "ratio_min": 1.0},
        {"runner": "b, in the engine, recording", "ratio_min": 5.0},
        {"runner": "b, recording", "ratio_min": 40.0},
    ]
    text = others.goals([{"title": "2 coupled", "fmi": "fmi2", "rows": rows}])
    (line,) = text.splitlines()[2:]
    cells = [cell.strip() for cell in line.split("|")[2:-1]]
    assert cells == ["b: 3×", "a, one call: 2×", "b: 40×", "b, in the engine: 5×"]


def test_everybody_is_asked_and_only_who_records_is_asked_to_record() -> None:
    case = entrants.peer_cases(0.01)[1]
    labels = [c.label for c in others.contestants(case, "fmi2", 10, 1)]
    assert {e.name for e in entrants.ENTRANTS} <= set(labels)
    recording = {label.removesuffix(", recording") for label in labels if "recording" in label}
    assert recording == {e.name for e in entrants.ENTRANTS if e.records}
