"""What the loop and the plan may cost, in numbers of calls and instructions: no clock is read."""

import subprocess
import sys
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest

from benchmarks.cases import rings
from benchmarks.scaling import document
from cosim.checks.preflight import check
from cosim.engine.engine import Engine
from cosim.fmi.file.description import read_cached
from cosim.loading.files import load
from cosim.native.enums import Code
from cosim.scenario.assemble import assemble
from cosim.schedule.plan import compile_plan
from tests.bridge.zenoh.rehearsed import CONFIGS
from tests.cosim.scenarios import plan, scenario


def calls_in(function):
    """How many Python functions `function` calls."""
    found = []
    sys.setprofile(lambda frame, event, _: event == "call" and found.append(frame.f_code.co_name))
    try:
        function()
    finally:
        sys.setprofile(None)
    return len(found)


def instructions_in(function):
    """How many instructions of the interpreter `function` takes."""
    n = 0

    def trace(frame, event, _):
        nonlocal n
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        n += event == "opcode"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        function()
    finally:
        sys.settrace(before)
    return n


@pytest.mark.parametrize("choice", ["fmi2", "fmi3"])
def test_native_components_run_without_any_python(choice):
    p = rings(3, 5000).plan(choice, 5000)
    record = np.empty((5001, p.n_signals))
    with Engine(p) as engine:
        engine.initialize()
        few = calls_in(lambda: engine.run(10, record))
        many = calls_in(lambda: engine.run(4000, record))
        assert many == few


def test_a_python_component_costs_its_call_backs_and_no_more():
    p = plan({"clock": {"model": "Clock"}}, stop=500.0)
    with Engine(p) as engine:
        engine.initialize()
        few, many = (calls_in(lambda n=n: engine.run(n)) for n in (10, 110))
    each = (many - few) / 100
    assert each == int(each)
    assert 0 < each <= 4  # the call-back, the step, and storing what it gave


def chain(n):
    """`n` sampled components in a row, a plant behind every one, and a link back to its own."""
    components, links = {}, []
    for i in range(n):
        source = {"inputs": {"u": f"c{i - 1:03}.y"}} if i else {}
        components[f"c{i:03}"] = {"model": "Gain", **source}
        components[f"p{i:03}"] = {"model": "Integrator"}
        links.append({"from": f"c{i:03}.y", "to": f"p{i:03}.u"})
    return plan(components, links)


@pytest.mark.parametrize("algorithm", ["sampled", "jacobi", "gauss-seidel"])
def test_a_plan_costs_as_much_as_it_has_components(algorithm):
    def cost(n):
        p = chain(n)
        return instructions_in(
            lambda: compile_plan(p.h, p.ticks, p.components, p.wires, p.links, algorithm)
        )

    assert cost(20) > 10_000  # there is something to count
    assert cost(80) / cost(20) < 4.8  # linear: 4, quadratic: 16


def test_names_are_connected_in_time_that_grows_with_them():
    def cost(n):
        made = _scenario(n)
        return instructions_in(lambda: assemble(made))

    assert cost(40) / cost(10) < 4.8


def test_the_check_takes_time_that_grows_with_the_robots():
    def cost(n):
        settings = (f"graphs.net.n={n}", "run.stop=1")
        made = load(CONFIGS / "many.toml", settings)
        p = assemble(made)
        return instructions_in(lambda: check(made, p))

    cost(10)  # imports SciPy
    assert cost(40) / cost(10) < 3.4  # 2.7, for what does not grow with them counts, too


def _scenario(n):
    names = [f"c{i:03}" for i in range(n)]
    components = {
        name: {"model": "Integrator", "inputs": {"u": f"{names[i - 1]}.y"}}
        for i, name in enumerate(names)
    }
    return scenario(components)


def test_an_input_is_copied_once_however_it_is_written():
    wide = {"model": "Wide"}
    entries = {f"u[{i},{j}]": f"a.y[{i},{j}]" for i in range(2) for j in range(3)}
    scaled = {k: {"from": v, "gain": 2.0} for k, v in entries.items()}
    for inputs, code in ((entries, Code.COPY), (scaled, Code.SCALE)):
        p = plan({"a": wide, "b": {**wide, "inputs": inputs}})
        found = [o for o in p.operations if o.code in (Code.COPY, Code.SCALE)]
        assert [(o.code, o.count) for o in found] == [(code, 6)]


def test_the_ring_that_is_measured_has_one_copy_and_one_step_each():
    p = rings(12, 100).plan("kernel", 100)
    codes = [o.code for o in p.operations]
    assert codes.count(Code.COPY) == codes.count(Code.STEP) == 12
    assert len(codes) == 25  # and one record
    assert len(document(5, links=True)["links"]) == 5


def test_an_fmu_in_the_cache_is_neither_unpacked_nor_parsed_twice(monkeypatch):
    rings(1, 100).plan("fmi2", 100)
    read_cached.cache_clear()
    parsed = []
    parse = ElementTree.parse
    monkeypatch.setattr(ElementTree, "parse", lambda path: parsed.append(path) or parse(path))
    monkeypatch.setattr(zipfile, "ZipFile", None)  # whoever unpacks now, fails
    made = rings(12, 100).plan("fmi2", 100)
    assert len(made.components) == 12
    assert len(parsed) == 1


def test_a_start_without_links_loads_no_law_and_no_recorder():
    code = "import sys, cosim.scenario.assemble, cosim.engine.engine; print(*sys.modules)"
    found = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout.split()
    assert "cosim.engine.engine" in found
    links = {name for name in found if name.startswith("cosim.links.")}
    assert links == {"cosim.links.keys"}
    assert not {"pyarrow", "matplotlib", "scipy", "fmpy", "typer", "cosim.record"} & set(found)
