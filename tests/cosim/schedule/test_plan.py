"""Plan: order within a tick, rates, shapes and units; and every way a scenario can be wrong."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import PlanError, ScenarioError
from cosim.engine.engine import Engine
from cosim.native.enums import Code
from cosim.scenario.assemble import assemble
from tests.cosim.oracle import execute
from tests.cosim.scenarios import document, plan, scenario


def run(p):
    record = np.empty((p.ticks + 1, p.n_signals))
    with Engine(p) as engine:
        engine.initialize()
        engine.run(p.ticks, record)
        record[p.ticks] = engine.signals
    return record


def column(p, record, name):
    slot = p.slots()[name]
    return record[:, slot.start : slot.start + slot.size].squeeze()


CHAIN = {
    "plant": {"model": "Integrator", "inputs": {"u": "b.y"}, "start": {"x": 1.0}},
    "a": {"model": "Gain", "parameters": {"gain": 2.0}, "inputs": {"u": "plant.y"}},
    "b": {"model": "Gain", "parameters": {"gain": -0.5}, "inputs": {"u": "a.y"}},
}


def test_sampled_components_compute_in_dependency_order_without_hidden_delay():
    p = plan(CHAIN)
    assert p.order == ("a", "b")
    x = column(p, run(p), "plant.y")
    # x' = -x sampled and held over h = 1/4: x_k = (1 - h)^k; any hidden sample would show.
    assert x == pytest.approx(0.75 ** np.arange(9), rel=1e-15)


def test_jacobi_shows_everybody_the_previous_tick():
    p = plan(CHAIN, algorithm="jacobi")
    x = column(p, run(p), "plant.y")
    a = column(p, run(p), "a.y")
    assert p.order == ()
    assert a[1:] == pytest.approx(2 * x[:-1])
    assert x[:4] == pytest.approx([1, 1, 1, 1 - 0.25])


@given(st.permutations(list(CHAIN)))
def test_listing_order_does_not_matter(names):
    p = plan({name: CHAIN[name] for name in names})
    assert run(p).tobytes() == run(plan(CHAIN)).tobytes()


@pytest.mark.parametrize("algorithm", ["sampled", "jacobi"])
def test_the_engine_equals_the_oracle_to_the_bit(algorithm):
    components = {
        "plant": {"model": "Integrator", "inputs": {"u": "fast.y"}, "start": {"x": 0.3}},
        "slow": {"model": "Integrator", "inputs": {"u": "plant.y"}, "period": 0.75},
        "fast": {
            "model": "Gain",
            "parameters": {"gain": -0.7},
            "inputs": {"u": {"from": "slow.y", "gain": 1.1, "offset": -0.2}},
        },
        "late": {"model": "Gain", "period": 0.5},
        "later": {"model": "Gain", "inputs": {"u": "late.y"}},
    }
    links = [
        {"from": "fast.y", "to": "late.u", "delay": {"law": "uniform", "low": 0.25, "high": 2.0}},
    ]
    one, two = (plan(components, links, stop=50.0, algorithm=algorithm) for _ in range(2))
    assert run(one).tobytes() == execute(two).tobytes()


def test_slow_plants_publish_at_the_end_of_their_interval():
    p = plan(
        {
            "clock": {"model": "Clock"},
            "slow": {"model": "Integrator", "period": 1.0, "inputs": {"u": "one.y"}},
            "one": {"model": "Gain", "inputs": {"u": "slow.y"}, "parameters": {"gain": 0.0}},
        },
        stop=3.0,
    )
    p.component("slow").component.step = lambda t, h, u: {"y": 10 * t + h}
    y = column(p, run(p), "slow.y")
    # computed for [0, 1) and there from t = 1 on
    assert y.tolist() == [0] * 4 + [1] * 4 + [11] * 4 + [21]


def test_time_is_a_product_and_never_a_sum():
    p = plan({"clock": {"model": "Clock"}}, step=0.1, stop=1000.0)
    run(p)
    steps = p.component("clock").component.steps
    assert steps == [(k * 0.1, 0.1) for k in range(10000)]


def test_a_loop_is_printed():
    with pytest.raises(PlanError) as error:
        plan(
            {
                "a": {"model": "Gain", "inputs": {"u": "c.y"}},
                "b": {"model": "Gain", "inputs": {"u": "a.y"}},
                "c": {"model": "Gain", "inputs": {"u": "b.y"}},
                "d": {"model": "Gain", "inputs": {"u": "c.y"}},
            }
        )
    assert "a.y -> b.u, b.y -> c.u, c.y -> a.u" in str(error.value)
    assert "d." not in str(error.value)


def test_a_link_of_at_least_a_tick_breaks_a_loop_and_one_without_delay_does_not():
    components = {
        "a": {"model": "Gain", "inputs": {"u": "b.y"}},
        "b": {"model": "Gain"},
    }
    link = {"from": "a.y", "to": "b.u"}
    late = plan(components, [{**link, "delay": {"law": "constant", "delay": 0.25}}])
    assert late.order == ("b", "a")
    with pytest.raises(PlanError, match="wait for each other"):
        plan(components, [{**link, "delay": {"law": "constant", "delay": 0.0}}])


def test_a_link_without_delay_is_a_wire():
    components = {"plant": CHAIN["plant"], "a": CHAIN["a"], "b": {**CHAIN["b"], "inputs": {}}}
    link = {"from": "a.y", "to": "b.u", "delay": {"law": "constant", "delay": 0.0}}
    by_link, by_wire = plan(components, [link]), plan(CHAIN)
    assert run(by_link).tobytes() == run(by_wire).tobytes()


def test_neighbouring_copies_become_one():
    wide = {"model": "Wide"}
    p = plan({"a": wide, "b": {**wide, "inputs": {"u": "a.y"}}})
    rows = plan({"a": wide, "b": {**wide, "inputs": {"u[0]": "a.y[0]", "u[1]": "a.y[1]"}}})
    copies = [[o for o in x.operations if o.code == Code.COPY] for x in (p, rows)]
    assert copies[0] == copies[1]
    assert copies[0][0].count == 6


def test_units_are_converted_on_the_wire():
    components = {
        "other": {"model": "Milliseconds", "inputs": {"u": "clock.y[0]"}},
        "clock": {"model": "Clock"},
    }
    p = plan(components)
    # clock.y is in s, u in ms: t = 0.25 s arrives as 250 ms
    assert column(p, run(p), "other.u")[1] == pytest.approx(250.0, rel=1e-15)


def test_units_that_measure_different_things_do_not_connect():
    with pytest.raises(
        ScenarioError, match=r"clock.y\[0\] is in \[s\], mm.u\[0,0\] expects \[mm\]"
    ):
        plan(
            {
                "mm": {"model": "Wide", "inputs": {"u[0,0]": "clock.y[0]"}},
                "clock": {"model": "Clock"},
            }
        )


WRONG = [
    ({"a": {"model": "Gain", "inputs": {"u": "b.y"}}}, "no component 'b'"),
    ({"a": {"model": "Gain", "inputs": {"v": "a.y"}}}, "no input of a 'v'"),
    ({"a": {"model": "Gain", "inputs": {"u": "a.u"}}}, "a.u is not an output"),
    ({"a": {"model": "Gain", "inputs": {"u": "a"}}}, "'a' is not an endpoint"),
    ({"a": {"model": "Gain", "period": 0.3}}, "not a multiple of the base step 0.25 s"),
    ({"a": {"model": "Gain", "period": 0.1}}, "not a multiple"),
    ({"a": {"model": "Gain", "parameters": {"gian": 1}}}, "did you mean 'gain'"),
    ({"a": {"model": "Gain", "parameters": {"gain": [1, 2]}}}, "expected shape a single number"),
    ({"a": {"model": "Gain", "parameters": {"gain": "1 s"}}}, r"[s] cannot feed [1]"),
    ({"a": {"model": "Gain", "preset": "big"}}, "no preset 'big'"),
    ({"a": {"model": "Gain", "sizes": {"n": 3}}}, "at components.a.sizes"),
    ({"a": {"model": "tests.cosim.blocks:Gone"}}, "has no 'Gone'"),
    ({"a": {"model": "tests.cosim.nowhere:Gain"}}, "cannot import"),
    (
        {"a": {"model": "../other.ssp"}},
        "cannot import '../other.ssp': that is not a valid name of a module",
    ),
    ({"a": {"model": "tests.cosim.blocks"}}, "no function fmu"),
    ({"a": {"model": "nowhere/plant.fmu"}}, "no such file"),
    ({"a": {"model": "Wide", "inputs": {"u[2]": "a.y[0]"}}}, "outside of a.u, which has shape"),
    ({"a": {"model": "Wide", "inputs": {"u[0]": "a.y"}}}, "has shape [2, 3], a.u[0] expects [3]"),
    ({"a": {"model": "Wide", "parameters": {"how": 0.5}}}, "is an integer"),
    (
        {"a": {"model": "Wide", "inputs": {"u": "b.y", "u[0]": "b.y[0]"}}, "b": {"model": "Wide"}},
        "a.u[0,0] is fed twice",
    ),
    (
        {"a": {"model": "Gain", "inputs": {"u": "b.y"}, "start": {"u": 1}}, "b": {"model": "Gain"}},
        "a start value would not be used",
    ),
]


@pytest.mark.parametrize(("components", "message"), WRONG, ids=[m for _, m in WRONG])
def test_what_does_not_fit_is_refused_with_its_place(components, message):
    with pytest.raises(Exception) as error:
        plan(components)
    assert message in str(error.value)
    assert "test.toml at components." in str(error.value) or "fed twice" in message


def test_options_are_arguments_and_a_path_is_relative_to_the_scenario(tmp_path):
    (tmp_path / "hand.csv").write_text("t,push\n0,1\n0.5,3\n1.0,-2\n")
    replay = {
        "model": "fmus.models.replay:Replay",
        "options": {"path": "hand.csv", "signals": {"y": "push"}, "units": {"y": "1"}},
    }
    components = {"hand": replay, "gain": {"model": "Gain", "inputs": {"u": "hand.y"}}}
    p = assemble(scenario(components, path=tmp_path / "test.toml"))
    assert column(p, run(p), "gain.y")[:5].tolist() == [1.0, 1.0, 3.0, 3.0, -2.0]


def test_an_fmu_takes_no_options():
    with pytest.raises(ScenarioError, match=r"at components.a.options: only a Python component"):
        plan({"a": {"model": "fmus.models.xi", "options": {"n": 3}}})


def test_run_times_must_be_whole_ticks():
    with pytest.raises(ScenarioError, match=r"run.stop: 2.1 s is not a multiple"):
        plan(CHAIN, stop=2.1)
    with pytest.raises(ScenarioError, match="must be positive"):
        plan(CHAIN, step=-1.0)


def test_two_links_may_not_share_a_name():
    components = {"a": {"model": "Gain"}, "b": {"model": "Gain"}, "c": {"model": "Gain"}}
    links = [{"from": "a.y", "to": "b.u", "name": "x"}, {"from": "a.y", "to": "c.u", "name": "x"}]
    with pytest.raises(ScenarioError, match="a second link has the name 'x'"):
        plan(components, links)


def test_seeds_follow_names_and_not_positions():
    components = {name: {"model": "Gain"} for name in "abc"}
    law = {"law": "uniform", "low": 0.25, "high": 5.0}
    links = [{"from": "a.y", "to": f"{x}.u", "delay": law} for x in "bc"]
    tables = []
    for order in itertools.permutations(links):
        p = plan(components, order)
        tables.append({x.name: x.table.stream().rows(200).tolist() for x in p.links})
    assert tables[0] == tables[1]
    assert tables[0]["a.y->b.u"] != tables[0]["a.y->c.u"]


def test_a_document_is_only_data():
    assert scenario(CHAIN).run == scenario(document(CHAIN)["components"]).run
