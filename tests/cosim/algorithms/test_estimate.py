"""Errors by step doubling: known errors and orders are found, and the run does not change."""

import json
from dataclasses import replace
from math import inf, isnan

import pytest
from typer.testing import CliRunner

from benchmarks.cases import rings
from cosim.base.errors import RunError
from cosim.cli.commands import app
from cosim.estimate.local_error import estimate
from cosim.record.folder import TRAJECTORIES
from tests.cosim.algorithms.test_gauss_seidel import OSCILLATOR
from tests.cosim.scenarios import plan

SOLVERS = "tests.cosim.algorithms.solvers"
FINE = {"step": 0.01, "stop": 8.0}


def of(components, **args):
    """The estimate for a document, and its components by name."""
    keys = {k: args.pop(k) for k in ("samples", "tolerance") if k in args}
    found = estimate(lambda: plan(components, **{**FINE, **args}), **keys)
    return found, {c.name: c for c in found.components}


def test_the_error_of_holding_a_neighbours_output_is_found():
    # x' = v, v held: after one step x is wrong by h^2/2 |v'| = h^2/2 |x|, and v by h^2/2 |v|.
    found, by = of(OSCILLATOR)
    assert found.samples == 40
    for name in "xv":
        worst = by[name].worst
        assert worst.largest == pytest.approx(0.01**2 / 2 * worst.scale, rel=0.02)
        assert worst.order == pytest.approx(1.0, abs=0.01)
        assert worst.rms < worst.largest


@pytest.mark.parametrize(("solver", "order"), [("Decay", 1), ("Midpoint", 2), ("Classical", 4)])
@pytest.mark.parametrize("period", [1, 3])
def test_the_order_of_a_components_own_solver_is_observed(solver, order, period):
    spec = {"model": f"{SOLVERS}:{solver}", "start": {"x": 1.0}, "period": 0.1 * period}
    found, by = of({"a": spec}, step=0.1, stop=6.0)
    worst = by["a"].worst
    assert worst.order == pytest.approx(order, abs=0.25)
    H = 0.1 * period
    factorial = {1: 2, 2: 6, 4: 120}[order]
    assert worst.largest == pytest.approx(H ** (order + 1) / factorial, rel=0.3)
    assert worst.time == 0.0
    assert by["a"].step == pytest.approx(H)
    assert found.left_out == {}


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
@pytest.mark.parametrize("algorithm", ["sampled", "jacobi", "gauss-seidel"])
def test_the_advised_step_keeps_the_tolerance(tolerance, algorithm):
    found, _ = of(OSCILLATOR, tolerance=tolerance, algorithm=algorithm)
    again, by = of(OSCILLATOR, tolerance=tolerance, algorithm=algorithm, step=found.advised)
    assert max(c.worst.relative for c in by.values()) <= tolerance
    assert again.advised >= found.advised


def test_what_only_holds_sampled_inputs_has_no_error():
    components = {
        "plant": {"model": "Integrator", "inputs": {"u": "control.y"}, "start": {"x": 1.0}},
        "control": {"model": "Gain", "inputs": {"u": "plant.y"}, "parameters": {"gain": -0.5}},
    }
    found, by = of(components)
    assert by["plant"].worst.relative < 1e-15
    assert isnan(by["plant"].worst.order)
    assert (by["plant"].advised, found.advised) == (inf, inf)


def test_who_cannot_go_back_is_named_with_the_reason():
    components = {
        **OSCILLATOR,
        "stateless": {"model": f"{SOLVERS}:Stateless", "inputs": {"u": "x.y"}},
        "forgetful": {"model": f"{SOLVERS}:Forgetful", "inputs": {"u": "x.y"}},
    }
    found, by = of(components)
    assert "no get_state and no set_state" in found.left_out["stateless"]
    assert "does not continue as before" in found.left_out["forgetful"]
    assert set(by) == {"x", "v"}
    assert found.samples == 1  # from the second point on it is another trajectory


@pytest.mark.slow
def test_an_fmu_is_as_its_kernel_and_one_without_states_is_left_out():
    ring = rings(3, 300)
    by = {c: estimate(lambda c=c: ring.plan(c)) for c in ("fmi2", "fmi3", "kernel")}
    assert by["fmi2"] == by["fmi3"] == by["kernel"]
    assert [c.worst.order for c in by["fmi2"].components] == pytest.approx([1.0] * 3, abs=0.3)

    def crippled():
        made = ring.plan("fmi2")
        for name, flag in (
            ("f00", "canGetAndSetFMUstate"),
            ("f01", "canHandleVariableCommunicationStepSize"),
        ):
            fmu = made.component(name).component
            fmu.description = replace(fmu.description, flags={**fmu.description.flags, flag: False})
        return made

    found = estimate(crippled)
    assert "canGetAndSetFMUstate" in found.left_out["f00"]
    assert "canHandleVariable" in found.left_out["f01"]
    assert [c.name for c in found.components] == ["f02"]


def test_a_part_that_fails_says_so():
    def make():
        made = plan(OSCILLATOR, **FINE)
        x = made.component("x").component
        step = x.step

        def choosy(t, h, u):
            if h < 0.01:
                raise ValueError("too short")
            return step(t, h, u)

        x.step = choosy
        return made

    with pytest.raises(RunError, match=r"x: a part of a step .* too short"):
        estimate(make)


def test_the_command_prints_writes_and_changes_nothing(tmp_path):
    text = ["[run]", "step = 0.01", "stop = 2.0"]
    for name, source, gain in (("x", "v", 1.0), ("v", "x", -1.0)):
        text += [f"[components.{name}]", 'model = "tests.cosim.blocks:Integrator"']
        text += ["start = { x = 1.0 }", f'inputs.u = {{ from = "{source}.y", gain = {gain} }}']
    scenario = tmp_path / "loop.toml"
    scenario.write_text("\n".join(text))
    rows = {}
    for option in ((), ("--estimate-error", "--tolerance", "1e-6")):
        folder = tmp_path / f"run{len(option)}"
        args = ["run", str(scenario), "--out", str(folder), "--no-plot", *option]
        result = CliRunner().invoke(app, args, catch_exceptions=False)
        assert result.exit_code == 0
        rows[bool(option)] = (folder / TRAJECTORIES).read_bytes()
        assert (folder / "estimate.json").exists() == bool(option)
    assert rows[True] == rows[False]
    assert "local error of a step, at 40 points" in result.output
    assert "run.step = 0.001 keeps the tolerance; 0.01 s does not" in result.output
    written = json.loads((folder / "estimate.json").read_text())
    assert [c["name"] for c in written["components"]] == ["v", "x"]
