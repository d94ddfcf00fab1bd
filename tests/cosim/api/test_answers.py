"""Questions about a run: the answer, and the numbers that decide it."""

from __future__ import annotations

from html import unescape
from math import exp, pi, sqrt
from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.base.component import Port
from cosim.base.errors import ScenarioError, UnitError

LINK = "plant.x->watch.x"


class Oscillator:
    """x(t) = 1 - e^-t cos 3t and y = -x, both exact: what is to be found out follows on paper."""

    kind = "sampled"
    inputs = ()
    outputs = (Port("x", (2,), "rad"), Port("one", (2,), "rad"))
    parameters = ()

    def initialize(self, values):
        pass

    def initial(self, u):
        return self.step(0.0, 0.0, u)

    def step(self, t, h, u):
        x = 1 - exp(-t) * np.cos(3 * t)
        return {"x": np.array([x, -x]), "one": np.array([1.0, -1.0])}

    def get_state(self):
        return None

    def set_state(self, state):
        pass


@cosim.component(inputs={"x": (2, "rad")}, outputs={"y": (2, "rad")})
def watch(x):
    return {"y": x}


def scenario(**changes):
    return {
        "title": "an oscillation",
        "run": {"step": "1 ms", "stop": "8 s", **changes},
        "components": {"plant": {"model": Oscillator}, "watch": {"model": watch}},
        "links": [
            {"from": "plant.x", "to": "watch.x", "delay": {"law": "constant", "delay": "0.3 s"}}
        ],
        "metrics": {
            "near": {"kind": "error", "of": ["plant.x"], "target": "plant.one", "within": 0.05},
            "nearer": {"kind": "error", "of": ["plant.x"], "target": [1, -1], "within": 1e-9},
            "peak": {"kind": "peak", "of": ["plant.x"]},
        },
    }


@pytest.fixture(scope="module")
def run():
    return cosim.run(scenario())


#: x is greatest where its derivative e^-t (cos 3t + 3 sin 3t) is first 0 after the start.
AT = (pi - np.arctan(1 / 3)) / 3
MOST = exp(-AT) * 3 / sqrt(10)


def last_outside(band):
    t = np.arange(8001) * 1e-3
    return t[np.flatnonzero(np.exp(-t) * np.abs(np.cos(3 * t)) >= band)[-1] + 1]


@pytest.mark.parametrize("to", ["plant.one", [1.0, -1.0], ["1 rad", "-1 rad"]])
def test_a_signal_settles_at_the_time_at_which_it_does(run, to):
    at = last_outside(0.05)
    assert run.settles("plant.x", to, band="0.05 rad", within=at)
    late = run.settles("plant.x", to, band=0.05, within=at - 1e-3)
    assert not late and f"after {at:g} s; expected within {at - 1e-3:g} s" in repr(late)
    assert repr(late).startswith("no: plant.x stays within 0.05 rad of ")


def test_one_number_is_the_target_of_every_entry(run):
    answer = run.settles("plant.x", 1.0, band=0.05, within="8 s")
    assert not answer  # the second entry goes to -1
    assert "plant.x is 1.99986 rad" in answer.text and "away from 1.0 at the end" in answer.text
    assert run.settles("plant.x[0]", "57.29577951 deg", band="1 deg", within="8 s")


def test_a_bound_is_on_the_greatest_magnitude(run):
    assert run.stays_below("plant.x", 1 + MOST + 1e-6)
    answer = run.stays_below("plant.x", f"{1 + MOST - 1e-6} rad")
    assert not answer
    assert f"is {1 + MOST:.5g}"[:8] in answer.text and "plant.x[" in answer.text
    assert f"at {1e3 * AT:.0f} ms" in answer.text


@pytest.mark.parametrize("to", ["plant.one", [1.0, -1.0]])
def test_the_overshoot_is_that_beyond_the_target(run, to):
    assert run.overshoot_stays_below("plant.x", MOST + 1e-6, to=to)
    answer = run.overshoot_stays_below("plant.x", MOST - 1e-5, to=to)
    assert not answer and f"by {MOST:.4f}"[:9] in answer.text


def test_what_stops_short_of_its_target_does_not_overshoot(run):
    answer = run.overshoot_stays_below("plant.x", 1e-9, to=[2.0, -2.0])
    assert answer and "by 0 rad at all times" in answer.text
    away = run.overshoot_stays_below("plant.x", 0.5, to=[-1.0, 1.0])  # it goes the other way
    assert away


def test_the_age_of_a_link_is_what_its_receiver_holds(run):
    assert run.age_stays_below(LINK, "301 ms")
    answer = run.age_stays_below(LINK, 0.3)
    assert not answer and f"the greatest age of {LINK} is 0.3 s" in answer.text
    with pytest.raises(ScenarioError, match=r"no link 'plant.x->watch.y'; did you mean"):
        run.age_stays_below("plant.x->watch.y", 1)


def test_a_receiver_that_waits_for_its_first_sample_holds_nothing_for_so_long():
    late = cosim.run(scenario(stop="0.25 s"))
    assert not late.age_stays_below(LINK, "10 s")  # nothing came
    first = cosim.run(scenario(stop="0.31 s"))
    assert first.age_stays_below(LINK, 0.3005) and not first.age_stays_below(LINK, 0.2995)
    document = scenario(stop="1 s")
    document["links"][0]["loss"] = {"law": "outage", "length": "0.5 s", "every": "9 s", "start": 0}
    document["links"][0]["semantics"] = "newest-stamp"
    lossy = cosim.run(document)  # the first sample is sent at 0.5 s
    answer = lossy.age_stays_below(LINK, "0.7 s")
    assert not answer and "is 0.799 s at 0.799 s" in answer.text
    assert lossy.age_stays_below(LINK, "0.8 s")


def test_metrics_with_a_band_are_requirements(run):
    assert run.passes("near")
    every = run.passes()
    assert not every and every.text.startswith("nearer: ")
    assert "expected below 1e-09 rad" in every.text
    with pytest.raises(
        ScenarioError, match=r"no requirement, or metric with the key 'within', 'peak'"
    ):
        run.passes("peak")


def test_a_run_that_ended_as_it_should_has_no_faults(run, tmp_path):
    assert run.has_no_faults()

    class Failing(Oscillator):
        def step(self, t, h, u):
            return super().step(t, h, u) | ({"x": np.full(2, np.nan)} if t > 0.1 else {})

    document = scenario()
    document["components"]["plant"]["model"] = Failing
    with pytest.raises(cosim.CosimError):
        cosim.run(document, out=tmp_path / "run")
    answer = cosim.open(tmp_path / "run").has_no_faults()
    assert not answer and answer.text.startswith("failed: ") and "plant" in answer.text


@pytest.mark.parametrize(
    ("facts", "says"),
    [
        ({"verdict": "failed", "reasons": ["slave: OVERRUN"]}, "failed: slave: OVERRUN"),
        ({"verdict": "inconclusive", "reasons": []}, "inconclusive: "),
        ({"verdict": "passed", "nodes": {"slave": {"reasons": ["stale"]}}}, "slave: stale"),
    ],
)
def test_a_rehearsal_with_a_verdict_or_a_fault_state_is_no_run_without_faults(facts, says):
    from cosim.api.answers import no_faults

    assert no_faults({"status": "finished", "rehearsal": {"verdict": "passed"}})
    answer = no_faults({"status": "finished", "rehearsal": facts})
    assert not answer and says in answer.text


def test_runs_are_identical_to_the_bit_or_it_is_said_where_not(run, tmp_path):
    again = cosim.run(scenario(), out=tmp_path / "again")
    assert run.is_identical_to(again) and run.is_identical_to(tmp_path / "again")
    shorter = cosim.run(scenario(stop="7 s"))
    answer = run.is_identical_to(shorter)
    assert not answer and "found 8001 rows, expected 7001" in answer.text
    fewer = cosim.run(scenario(record={"signals": ["plant.x"]}))
    answer = run.is_identical_to(fewer)
    assert not answer and "only one of the two runs has plant.one[0]" in answer.text
    document = scenario()
    document["links"][0]["delay"]["delay"] = "0.301 s"
    answer = run.is_identical_to(cosim.run(document))
    assert not answer and "most of all watch." in answer.text


def test_wrong_questions_are_answered_with_a_sentence(run):
    with pytest.raises(ScenarioError, match=r"no signal 'plant.z' was recorded"):
        run.settles("plant.z", 0.0, band=1, within=1)
    with pytest.raises(ScenarioError, match=r"no signal 'plant.two' was recorded"):
        run.settles("plant.x", "plant.two", band=1, within=1)
    with pytest.raises((ScenarioError, UnitError), match=r"N.m"):
        run.stays_below("plant.x", "3 N.m")
    with pytest.raises(ScenarioError, match="has size 2, but its target has size 3"):
        run.settles("plant.x", [1, 2, 3], band=1, within=1)
    with pytest.raises(ScenarioError, match="expected a width above 0"):
        run.settles("plant.x", 0.0, band=0, within=1)


def test_a_report_is_written_and_tells_the_command_that_repeats_the_run(tmp_path):
    root = Path(__file__).parents[3]
    file = root / "configs" / "teleoperation.toml"
    run = cosim.run(file, stop="20 ms", set={"links[0].delay.high": "1 s"}, seed=3)
    assert run.t[-1] == 0.02
    page = unescape(run.report().read_text(encoding="utf-8"))
    sets = """--set 'run.stop="20 ms"' --set 'links.0.delay.high="1 s"' --set run.seed=3"""
    assert f"cosim run {file} {sets}" in page
    made = cosim.run(scenario(stop="20 ms"))
    assert "Repeat it" not in made.report().read_text(encoding="utf-8")  # no command does
