"""Scheduled execution (FMI 3.0.2 §5): which partitions are activated when, and in which order.

The FMU, ``scheduled3.c``, writes down every call and marks those that the standard does not allow.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import CosimError, FmuError, RunError
from cosim.fmi import FmuComponent, FmuOptions
from cosim.fmi.components import model_name
from cosim.native import shared
from cosim.native.fmu_log import Log
from tests.cli.command import Command
from tests.cosim.fmi.exporter import column, export, plan_of, run

THIRD, FAST, TUNED, MINE, PULSE, DELAY, GO, DONE = range(1, 9)
STEPS, H = 10, 0.1
ISOLATE = pytest.mark.parametrize("isolate", [False, True])

_CLOCKS = (
    (THIRD, 'name="third" priority="2" intervalVariability="constant" supportsFraction="true" '
     'intervalCounter="1" resolution="30"'),
    (FAST, 'name="fast" priority="1" intervalVariability="constant" intervalDecimal="0.05"'),
    (TUNED, 'name="tuned" priority="3" intervalVariability="tunable" supportsFraction="true" '
     'intervalCounter="3" shiftCounter="1" resolution="10"'),
    (MINE, 'name="mine" priority="4" intervalVariability="fixed" supportsFraction="true"'),
    (PULSE, 'name="pulse" priority="5" intervalVariability="changing" supportsFraction="true"'),
    (DELAY, 'name="delay" priority="0" intervalVariability="countdown" supportsFraction="true"'),
    (GO, 'name="go" priority="6" intervalVariability="triggered"'),
)  # fmt: skip


def scheduled3(more: str = "") -> str:
    """The description of the FMU; `more`: another interface."""
    clocks = "".join(f'<Clock valueReference="{r}" causality="input" {x}/>' for r, x in _CLOCKS)
    values = "".join(
        f'<Float64 name="{name}" valueReference="{r}" causality="{causality}" {rest}/>'
        for name, r, causality, rest in (
            ("u_fast", 10, "input", 'variability="discrete" clocks="2" start="0"'),
            ("u", 11, "input", 'variability="discrete" start="0"'),
            ("wait", 12, "parameter", 'variability="fixed" start="20"'),
            ("wrong", 13, "parameter", 'variability="fixed" start="0"'),
            ("y_fast", 20, "output", 'variability="discrete" clocks="2"'),
            ("y", 21, "output", 'variability="discrete"'),
            ("y_done", 22, "output", 'variability="discrete" clocks="8"'),
            ("at_done", 23, "output", 'variability="discrete" clocks="8"'),
            ("y_go", 24, "output", 'variability="discrete" clocks="7"'),
            ("activations", 25, "local", 'variability="discrete"'),
        )
    )  # fmt: skip
    return f"""<fmiModelDescription fmiVersion="3.0" modelName="scheduled" instantiationToken="t">
<ScheduledExecution modelIdentifier="scheduled3"/>{more}<ModelVariables>{clocks}
<Clock name="done" valueReference="8" causality="output" intervalVariability="triggered"
 priority="0" clocks="6"/>{values}</ModelVariables><ModelStructure/></fmiModelDescription>"""


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(scheduled3(), tmp_path_factory.mktemp("fmu") / "scheduled3.fmu")


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], list[list[str]]]:
    """The calls so far, in words."""
    path = tmp_path / "calls"
    path.touch()
    monkeypatch.setenv("SCHEDULED_CALLS", str(path))
    return lambda: [line.split() for line in path.read_text().splitlines()]


def activations(calls: list[list[str]]) -> list[tuple[int, float]]:
    assert not [call for call in calls if "ILLEGAL" in call]
    return [(int(call[1]), float(call[2])) for call in calls if call[0] == "Activate"]


def expected(stop: float, tuned: Fraction = Fraction(3, 10)) -> list[tuple[int, float]]:
    """Clocks and times by the definitions of the clocks, in the order of time and priority."""
    end, found = Fraction(stop), []

    def every(clock: int, first: Fraction, interval: Fraction) -> list[tuple[Fraction, int]]:
        return [(first + n * interval, clock) for n in range(int((end - first) / interval) + 1)]

    fasts = every(FAST, Fraction(0), Fraction(1, 20))
    found += every(THIRD, Fraction(0), Fraction(1, 30)) + fasts
    found += every(TUNED, Fraction(1, 10), tuned) + every(MINE, Fraction(1, 20), Fraction(3, 20))
    found += [(t + Fraction(20, 1000), DELAY) for t, _ in fasts[::3]]
    at = Fraction(0)
    for n in range(20):
        at += Fraction(n % 2 + 1, 7)
        found.append((at, PULSE))
    urgent = [DELAY, FAST, THIRD, TUNED, MINE, PULSE, GO]
    found.sort(key=lambda x: (x[0], urgent.index(x[1])))
    return [(clock, float(t)) for t, clock in found if t < end]


@ISOLATE
def test_partitions_are_activated_in_the_order_of_time_and_priority(fmu, calls, isolate) -> None:
    _, engine = run(plan_of(fmu, STEPS, options=FmuOptions(isolate=isolate)))
    engine.close()
    found = activations(calls())
    assert [clock for clock, _ in found] == [clock for clock, _ in expected(1.0)]
    assert [t for _, t in found] == pytest.approx([t for _, t in expected(1.0)], abs=1e-15)


def test_times_of_fractions_are_exact_after_many_ticks(fmu: Path, calls) -> None:
    """Each is the nearest double of n/30 and n/7 s, however many intervals came before, or that of
    another clock at the same time.
    """
    _, engine = run(plan_of(fmu, 3, h=100.0, values={"wait": (1.0,)}))
    engine.close()
    found = activations(calls())
    third = [t for clock, t in found if clock == THIRD]
    assert np.abs(np.array(third) * 30 - np.arange(9000)).max() < 1e-11  # 300 s: 2 bits
    alone = [n for n in range(9000) if n % 3]  # where `fast` does not tick
    assert [third[n] for n in alone] == [n / 30 for n in alone]
    pulse = [t for clock, t in found if clock == PULSE]
    counts = np.cumsum([n % 2 + 1 for n in range(len(pulse))])
    exact = [float(Fraction(int(n), 7)) for n in counts]
    assert [p for p, n in zip(pulse, counts, strict=True) if n % 7] == [
        p for p, n in zip(exact, counts, strict=True) if n % 7
    ]
    assert len(pulse) == 1399


def test_a_clock_that_counts_down_may_have_any_priority(tmp_path: Path, calls) -> None:
    """None of its ticks is at the time of another clock's."""
    late = scheduled3().replace('name="delay" priority="0"', 'name="delay" priority="9"')
    _, engine = run(plan_of(export(late, tmp_path / "x.fmu"), STEPS))
    engine.close()
    assert [clock for clock, _ in activations(calls())] == [clock for clock, _ in expected(1.0)]


def test_inputs_are_set_before_and_outputs_got_after_an_activation(fmu: Path, calls) -> None:
    _, engine = run(plan_of(fmu, 1), {"u_fast": np.array([3.0]), "u": np.array([1.0])})
    engine.close()
    names = [" ".join(call[:2]) for call in calls()]
    start = names.index("ExitInitializationMode 0")
    end = names.index("Activate 1")
    assert names[start + 1 : end] == [
        "GetFloat64 21",  # the output without a clock after initialization
        "SetFloat64 11",  # the input without a clock, once a step
        "SetFloat64 10", "Activate 2", "GetIntervalFraction 6", "GetFloat64 20",
    ]  # fmt: skip
    assert names[-2:] == ["GetFloat64 21", "Terminate 0"]


@ISOLATE
@pytest.mark.parametrize("kind", [None, "continuous"])
def test_outputs_hold_between_activations(fmu: Path, isolate: bool, kind) -> None:
    feed = {"u_fast": np.arange(STEPS, dtype=float), "u": np.ones(STEPS)}
    plan = plan_of(fmu, STEPS, kind=kind, options=FmuOptions(isolate=isolate))
    assert plan.components[0].component.kind == (kind or "sampled")
    rows, engine = run(plan, feed)
    engine.close()
    assert column(plan, rows, "y_fast").tolist() == [0.0, *(2.0 * k for k in range(STEPS))]
    times = [t for clock, t in expected(1.0) if clock == DELAY]
    done = [sum(t < H * (k + 1) - 1e-9 for t in times) for k in range(STEPS)]
    assert column(plan, rows, "y_done").tolist() == [0.0, *map(float, done)]
    assert column(plan, rows, "done").tolist() == [0.0, *map(float, done)]
    assert column(plan, rows, "at_done")[-1] == pytest.approx(times[done[-1] - 1])
    every = [sum(t < H * (k + 1) - 1e-9 for _, t in expected(1.0)) for k in range(STEPS)]
    assert column(plan, rows, "y").tolist() == [0.0, *map(float, every)]


def test_a_wired_clock_activates_at_the_start_of_the_step(fmu: Path, calls) -> None:
    raised = np.repeat([0.0, 1.0, 2.0], [3, 4, STEPS - 7])
    plan = plan_of(fmu, STEPS)
    rows, engine = run(plan, {"go": raised})
    engine.close()
    assert [t for clock, t in activations(calls()) if clock == GO] == pytest.approx([0.3, 0.7])
    assert sorted(set(column(plan, rows, "y_go").tolist())) == pytest.approx([0.0, 0.3, 0.7])


def test_a_step_without_an_activation_calls_nothing(tmp_path: Path, calls) -> None:
    """Values must not be got after others were set without an activation in between."""
    keep = scheduled3()
    for r, attributes in _CLOCKS:
        if r != TUNED:
            keep = keep.replace(f'<Clock valueReference="{r}" causality="input" {attributes}/>', "")
    for name in ("u_fast", "y_fast", "y_done", "at_done", "y_go", "done"):
        start = keep.index(f'name="{name}"')
        begin = keep.rindex("<", 0, start)
        keep = keep[:begin] + keep[keep.index("/>", start) + 2 :]
    path = export(keep, tmp_path / "x.fmu")
    _, engine = run(plan_of(path, 3), {"u": np.ones(3)})
    engine.close()
    names = [" ".join(call[:2]) for call in calls()]
    after = names[names.index("ExitInitializationMode 0") + 2 :]
    assert after == ["SetFloat64 11", "Activate 3", "GetFloat64 21", "Terminate 0"]
    assert activations(calls()) == [(TUNED, 0.1)]


def test_an_interval_is_given_as_the_fraction_that_it_is(fmu: Path, calls) -> None:
    _, engine = run(plan_of(fmu, STEPS, values={"tuned": (0.2,)}))
    engine.close()
    assert ["SetIntervalFraction", "2", "10"] in calls()
    tuned = [t for clock, t in activations(calls()) if clock == TUNED]
    assert tuned == pytest.approx([0.1, 0.3, 0.5, 0.7, 0.9], abs=1e-15)


def test_an_interval_that_is_no_fraction_is_refused(fmu: Path) -> None:
    with pytest.raises(CosimError, match=r"0.25 s of clock 'tuned' is no multiple .* 1/10 s"):
        run(plan_of(fmu, 1, values={"tuned": (0.25,)}))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (1, r"asked for its next interval and gave none"),
        (2, r"asked for its next interval and gave none"),
        (3, r"fmi3ActivateModelPartition returned error \(no more\) at tick 2"),
    ],
)
@ISOLATE
def test_what_goes_wrong_is_a_sentence(fmu, calls, wrong: int, message: str, isolate) -> None:
    options = FmuOptions(isolate=isolate)
    with pytest.raises(RunError, match=message):
        run(plan_of(fmu, STEPS, values={"wrong": (float(wrong),)}, options=options))


def test_a_call_back_outside_of_an_activation_does_nothing() -> None:
    update = shared.library().engine_clock_update
    update(None)
    update(c.byref(Log()))


def test_a_clock_needs_a_priority_and_an_fmu_a_clock(tmp_path: Path) -> None:
    path = export(scheduled3().replace('priority="5"', ""), tmp_path / "x.fmu")
    with pytest.raises(CosimError, match="clock 'pulse' has the priority ''; expected a whole"):
        run(plan_of(path, 1))
    none = scheduled3().replace('causality="input" name', 'causality="local" name')
    path = export(none, tmp_path / "y.fmu")
    with pytest.raises(FmuError, match="has no input clock"):
        FmuComponent(path)


def test_it_is_chosen_where_there_is_another_interface(tmp_path: Path) -> None:
    saved = 'modelIdentifier="scheduled3" canGetAndSetFMUState="true"'
    more = 'canHandleVariableCommunicationStepSize="true"'
    both = scheduled3(f"<CoSimulation {saved}/>")
    both = both.replace('<ScheduledExecution modelIdentifier="scheduled3"',
                        f"<ScheduledExecution {saved} {more}")  # fmt: skip
    path = export(both, tmp_path / "x.fmu")
    assert FmuComponent(path).description.interface == "CoSimulation"
    chosen = FmuComponent(path, options=FmuOptions(interface="ScheduledExecution"))
    assert chosen.description.scheduled
    assert model_name(chosen) == "x.fmu, FMI 3.0 scheduled execution"


def test_commands_know_it(fmu: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    cosim = Command(monkeypatch, capsys)
    found = cosim("info", fmu, "--no-validate")
    assert found.code == 0 and "3.0 scheduled execution" in found.out
    scenario = tmp_path / "x.toml"
    scenario.write_text(
        'run = { step = 0.1, stop = 1.0 }\n[components.x]\nkind = "scheduled execution"\n'
        f'model = "{fmu}"\nparameters = {{ tuned = "200 ms" }}\n'
    )
    assert cosim("run", scenario, "--no-plot", "--out", tmp_path / "run").code == 0
