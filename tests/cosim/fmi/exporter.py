"""FMUs of C files and model descriptions written here: no code is shared with the runner."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from time import sleep

import numpy as np

from cosim.base.component import Kind
from cosim.engine.engine import Engine
from cosim.fmi import FmuComponent, FmuOptions
from cosim.schedule.parts import Slot, Step
from cosim.schedule.plan import Plan, compile_plan
from fmus.build.toolchain import compile_shared, shared_suffix

SOURCES = Path(__file__).parent / "c"
FOLDER = tempfile.TemporaryDirectory(prefix="exported-")
TYPES3 = ("Float64", "Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64",
          "UInt64", "Enumeration", "Boolean")  # fmt: skip

VARIABLE = 'canHandleVariableCommunicationStepSize="true"'
_ENUMERATION = '<Item name="slow" value="1"/><Item name="fast" value="2"/>'
UNITS = """<UnitDefinitions>
<Unit name="Nm"><BaseUnit kg="1" m="2" s="-2"/></Unit>
<Unit name="turns"><BaseUnit rad="1" factor="6.283185307179586"/>
<DisplayUnit name="half turns" factor="2"/></Unit>
<Unit name="Cel"><BaseUnit K="1" offset="273.15"/></Unit></UnitDefinitions>"""


def passing3() -> str:
    """Every type of FMI 3.0, in and out; a matrix of n x n; String, Binary, enumeration."""
    variables = []
    for i, kind in enumerate(TYPES3):
        extra = ' declaredType="Mode"' if kind == "Enumeration" else ""
        start = "1" if kind == "Enumeration" else "false" if kind == "Boolean" else "0"
        variables += [
            f'<{kind} name="u_{kind}" valueReference="{100 + i}" causality="input" start="{start}"'
            f"{extra}/>",
            f'<{kind} name="y_{kind}" valueReference="{200 + i}" causality="output"{extra}/>',
        ]
    return f"""<fmiModelDescription fmiVersion="3.0" modelName="passing" instantiationToken="t">
<CoSimulation modelIdentifier="passing3" canHandleVariableCommunicationStepSize="true"/>
{UNITS}<TypeDefinitions><EnumerationType name="Mode">{_ENUMERATION}<Item name="too much" value="3"/>
</EnumerationType></TypeDefinitions><ModelVariables>{"".join(variables)}
<UInt64 name="n" valueReference="300" causality="structuralParameter" variability="fixed"
 start="2"/>
<Float64 name="A" valueReference="301" causality="input" start="1 2 3 4" unit="Nm">
<Dimension valueReference="300"/><Dimension valueReference="300"/></Float64>
<Float64 name="B" valueReference="302" causality="output" unit="Nm">
<Dimension valueReference="300"/><Dimension valueReference="300"/></Float64>
<Float64 name="factor" valueReference="303" causality="parameter" variability="fixed" start="1"
 min="0" max="10" unit="turns"/>
<Enumeration name="mode" valueReference="304" causality="parameter" variability="fixed" start="1"
 declaredType="Mode"/>
<Boolean name="flip" valueReference="305" causality="structuralParameter" variability="fixed"
 start="false"/>
<String name="label" valueReference="120" causality="input"><Start value="x"/></String>
<String name="said" valueReference="220" causality="output"/>
<Binary name="blob" valueReference="121" causality="input"><Start value="00ff"/></Binary>
<Binary name="sent" valueReference="221" causality="output"/>
</ModelVariables><ModelStructure/></fmiModelDescription>"""


def events3(clock: str = 'intervalVariability="constant" intervalDecimal="0.2"') -> str:
    """Event mode, a clock that ticks every 0.2 s, a clocked and a discrete input."""
    names = ("sampled", "ticks", "changes", "bells", "integral", "calls")
    outputs = "".join(
        f'<Float64 name="{name}" valueReference="{10 + i}" causality="output"/>'
        for i, name in enumerate(names)
    )
    return f"""<fmiModelDescription fmiVersion="3.0" modelName="events" instantiationToken="t">
<CoSimulation modelIdentifier="events3" canHandleVariableCommunicationStepSize="true"
 hasEventMode="true" canReturnEarlyAfterIntermediateUpdate="true"/>
<ModelVariables><Clock name="clock" valueReference="1" causality="input" {clock}/>
<Float64 name="clocked" valueReference="2" causality="input" variability="discrete" clocks="1"
 start="0"/>
<Float64 name="discrete" valueReference="3" causality="input" variability="discrete" start="0"/>
{outputs}<Float64 name="half" valueReference="20" causality="parameter" variability="fixed"
 start="0"/></ModelVariables><ModelStructure/></fmiModelDescription>"""


def clocked3(variables: str = "", flags: str = "") -> str:
    """Two input clocks (0.1 s; 0.3 s from 0.1 s on), two that the FMU ticks, variables of each."""
    clocks = "".join(
        f'<Clock name="{name}" valueReference="{i}" causality="{causality}" {more}/>'
        for i, name, causality, more in (
            (1, "fast", "input", 'intervalVariability="constant" intervalDecimal="0.1"'),
            (2, "slow", "input",
             'intervalVariability="constant" intervalDecimal="0.3" shiftDecimal="0.1"'),
            (4, "echo", "output", 'intervalVariability="triggered" clocks="1"'),
            (3, "bell", "output", 'intervalVariability="triggered"'),
        )
    )  # fmt: skip
    inputs = "".join(
        f'<Float64 name="u_{name}" valueReference="{9 + i}" causality="input" clocks="{i}" '
        'variability="discrete" start="0"/>'
        for i, name in ((1, "fast"), (2, "slow"), (3, "bell"))
    )
    outputs = "".join(
        f'<{kind} name="{name}" valueReference="{r}" causality="output" clocks="{clocks}" '
        'variability="discrete"/>'
        for kind, name, r, clocks in (
            ("Float64", "y_fast", 20, "1"), ("Float64", "y_slow", 21, "2"),
            ("Float64", "y_bell", 22, "3"), ("Float64", "heard", 23, "3"),
            ("Float64", "y_both", 24, "2 1"), ("Int32", "y_echo", 40, "4"),
        )
    )  # fmt: skip
    return f"""<fmiModelDescription fmiVersion="3.0" modelName="clocked" instantiationToken="t">
<CoSimulation modelIdentifier="clocked3" canHandleVariableCommunicationStepSize="true"
 hasEventMode="true" {flags}/>
<ModelVariables>{clocks}{inputs}{outputs}<Float64 name="time" valueReference="30"
 causality="output"/>{variables}</ModelVariables><ModelStructure/></fmiModelDescription>"""


def timed3(flags: str = VARIABLE, variables: str = "", clock: str = "") -> str:
    """A changing clock, one that counts down, one triggered from outside, and one from inside."""
    clocks = "".join(
        f'<Clock name="{name}" valueReference="{i}" intervalVariability="{kind}" {clock} {more}/>'
        for i, name, kind, more in (
            (1, "pulse", "changing", 'causality="input"'),
            (2, "start", "triggered", 'causality="input"'),
            (3, "delay", "countdown", 'causality="input"'),
            (4, "done", "triggered", 'causality="output" clocks="3"'),
        )
    )
    values = "".join(
        f'<Float64 name="{name}" valueReference="{r}" causality="{causality}" '
        f'variability="discrete" clocks="{clock}" {more}/>'
        for name, r, causality, clock, more in (
            ("u_pulse", 10, "input", 1, 'start="0"'), ("u_start", 11, "input", 2, 'start="0"'),
            ("y_pulse", 20, "output", 1, ""), ("at_pulse", 21, "output", 1, ""),
            ("y_done", 22, "output", 4, ""), ("at_done", 23, "output", 4, ""),
        )
    )  # fmt: skip
    parameters = "".join(
        f'<Float64 name="{name}" valueReference="{r}" causality="parameter" variability="fixed" '
        f'start="{start}"/>'
        for name, r, start in (("wait", 12, 0.15), ("lenient", 13, 0))
    )
    return f"""<fmiModelDescription fmiVersion="3.0" modelName="timed" instantiationToken="t">
<CoSimulation modelIdentifier="timed3" hasEventMode="true" {flags}/>
<ModelVariables>{clocks}{values}{parameters}<Float64 name="time" valueReference="24"
 causality="output"/>{variables}</ModelVariables><ModelStructure/></fmiModelDescription>"""


def nasty2(attributes: str = "") -> str:
    """Every type of FMI 2.0; `how` and `when` it goes wrong."""

    def scalar(name: str, reference: int, causality: str, typed: str, variability: str = "") -> str:
        more = f'variability="{variability}"' if variability else ""
        return (
            f'<ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}" '
            f"{more}>{typed}</ScalarVariable>"
        )

    variables = (
        scalar("u", 0, "input", '<Real start="1" unit="Nm"/>'),
        scalar("y", 1, "output", '<Real unit="Nm"/>'),
        scalar("when", 2, "parameter", '<Real start="0" unit="s"/>', "fixed"),
        scalar("how", 3, "parameter", '<Integer start="0" min="0" max="20"/>', "fixed"),
        scalar("count", 4, "input", '<Integer start="0"/>', "discrete"),
        scalar("mode", 5, "input", '<Enumeration declaredType="Mode" start="1"/>', "discrete"),
        scalar("flag", 6, "input", '<Boolean start="false"/>', "discrete"),
        scalar("label", 7, "parameter", '<String start="x"/>', "fixed"),
        scalar("counted", 14, "output", "<Integer/>", "discrete"),
        scalar("chosen", 15, "output", '<Enumeration declaredType="Mode"/>', "discrete"),
        scalar("up", 16, "output", "<Boolean/>", "discrete"),
        scalar("said", 17, "output", "<String/>", "discrete"),
    )
    return f"""<fmiModelDescription fmiVersion="2.0" modelName="nasty" guid="t">
<CoSimulation modelIdentifier="nasty2" canHandleVariableCommunicationStepSize="true" {attributes}/>
{UNITS}<TypeDefinitions><SimpleType name="Mode"><Enumeration>{_ENUMERATION}</Enumeration>
</SimpleType></TypeDefinitions><ModelVariables>{"".join(variables)}</ModelVariables>
<ModelStructure/></fmiModelDescription>"""


def sloped2(attributes: str = 'canInterpolateInputs="true"') -> str:
    """Two lags x' = u - x that take slopes of u; a discrete Real and an Integer input do not."""

    def scalar(name: str, reference: int, causality: str, typed: str, variability: str) -> str:
        return (
            f'<ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}" '
            f'variability="{variability}">{typed}</ScalarVariable>'
        )

    pairs = "".join(
        scalar(f"{name}[{i}]", first + i, causality, typed, "continuous")
        for name, first, causality, typed in (
            ("u", 0, "input", '<Real start="0" unit="m"/>'),
            ("x", 10, "output", '<Real unit="m"/>'),
            ("slope", 12, "output", "<Real/>"),
        )
        for i in range(2)
    )
    return f"""<fmiModelDescription fmiVersion="2.0" modelName="sloped" guid="t">
<CoSimulation modelIdentifier="sloped2" canHandleVariableCommunicationStepSize="true" {attributes}/>
<ModelVariables>{pairs}{scalar("held", 2, "input", '<Real start="0"/>', "discrete")}
{scalar("count", 3, "input", '<Integer start="0"/>', "discrete")}
{scalar("slopes", 14, "output", "<Real/>", "continuous")}
{scalar("most", 4, "parameter", '<Real start="1e9"/>', "fixed")}
</ModelVariables><ModelStructure/></fmiModelDescription>"""


def strict2(attributes: str = "") -> str:
    """An FMU that writes down its calls and goes wrong as it is told: see ``strict2.c``."""

    def scalar(name: str, reference: int, causality: str, typed: str, more: str = "") -> str:
        return (
            f'<ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}" '
            f"{more}>{typed}</ScalarVariable>"
        )

    fixed = 'variability="fixed"'
    variables = (
        scalar("u", 0, "input", '<Real start="0"/>'),
        scalar("gain", 1, "parameter", '<Real start="2"/>', fixed),
        scalar("when", 2, "parameter", '<Real start="1e9"/>', fixed),
        scalar("x", 3, "local", '<Real start="1"/>', 'initial="exact"'),
        scalar("y", 4, "output", "<Real/>"),
        scalar("rate", 5, "parameter", '<Real start="0"/>', 'variability="tunable"'),
        scalar("how", 10, "parameter", '<Integer start="0"/>', fixed),
        scalar("status", 11, "parameter", '<Integer start="0"/>', fixed),
    )
    return f"""<fmiModelDescription fmiVersion="2.0" modelName="strict" guid="t">
<CoSimulation modelIdentifier="strict2" canHandleVariableCommunicationStepSize="true" {attributes}/>
<ModelVariables>{"".join(variables)}</ModelVariables><ModelStructure/></fmiModelDescription>"""


def strict3(attributes: str = "") -> str:
    """The same in FMI 3.0: see ``strict3.c``."""
    fixed = 'causality="parameter" variability="fixed"'
    return f"""<fmiModelDescription fmiVersion="3.0" modelName="strict" instantiationToken="t">
<CoSimulation modelIdentifier="strict3" canHandleVariableCommunicationStepSize="true" {attributes}/>
<ModelVariables><Float64 name="u" valueReference="0" causality="input" start="0"/>
<Float64 name="gain" valueReference="1" {fixed} start="2"/>
<Float64 name="when" valueReference="2" {fixed} start="1e9"/>
<Float64 name="x" valueReference="3" causality="local" initial="exact" start="1"/>
<Float64 name="y" valueReference="4" causality="output"/>
<Float64 name="rate" valueReference="5" causality="parameter" variability="tunable" start="0"/>
<Int32 name="how" valueReference="10" {fixed} start="0"/>
<Int32 name="status" valueReference="11" {fixed} start="0"/>
</ModelVariables><ModelStructure/></fmiModelDescription>"""


#: Variables of ``exchange_model.h``: name, value reference, causality and start; and integers.
_EXCHANGE = (
    ("x0", 0, "output", "1"), ("x1", 1, "output", "0"), ("der(x0)", 2, "local", ""),
    ("der(x1)", 3, "local", ""), ("u", 4, "input", "0"), ("mu", 5, "parameter", "1"),
    ("period", 6, "parameter", "0.25"), ("when", 7, "parameter", "1e9"), ("at", 8, "output", ""),
    ("z", 9, "local", ""),
)  # fmt: skip
_EXCHANGE_WHOLE = (
    ("model", 20, "parameter", "0"), ("status", 21, "parameter", "0"),
    ("last", 22, "parameter", "1000"), ("gear", 23, "input", "0"), ("events", 24, "output", ""),
    ("heard", 25, "output", ""),
)  # fmt: skip


def exchange2(attributes: str = "", more: str = "") -> str:
    """An FMU for model exchange, see ``exchange_model.h``; `more`: another interface."""

    def scalar(name: str, reference: int, causality: str, start: str, kind: str) -> str:
        varies = {"parameter": "fixed"}.get(
            causality, "continuous" if kind == "Real" else "discrete"
        )
        derived = 'derivative="1"' if reference == 2 else 'derivative="2"' if reference == 3 else ""
        initial = ' initial="exact"' if reference < 2 else ""
        begin = f'start="{start}"' if start else ""
        return (
            f'<ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}" '
            f'variability="{varies}"{initial}><{kind} {begin} {derived}/></ScalarVariable>'
        )

    variables = "".join(
        [scalar(*v, kind="Real") for v in _EXCHANGE]
        + [scalar(*v, kind="Integer") for v in _EXCHANGE_WHOLE]
    )
    return f"""<fmiModelDescription fmiVersion="2.0" modelName="exchange" guid="t"
 numberOfEventIndicators="1"><ModelExchange modelIdentifier="exchange2" {attributes}/>{more}
<ModelVariables>{variables}</ModelVariables><ModelStructure><Derivatives><Unknown index="3"/>
<Unknown index="4"/></Derivatives></ModelStructure></fmiModelDescription>"""


def exchange3(attributes: str = 'needsCompletedIntegratorStep="true"', more: str = "") -> str:
    """The same in FMI 3.0."""

    def variable(name: str, reference: int, causality: str, start: str, kind: str) -> str:
        varies = {"parameter": "fixed"}.get(
            causality, "continuous" if kind == "Float64" else "discrete"
        )
        derived = f'derivative="{reference - 2}"' if reference in (2, 3) else ""
        initial = 'initial="exact"' if reference < 2 else ""
        begin = f'start="{start}"' if start else ""
        return (
            f'<{kind} name="{name}" valueReference="{reference}" causality="{causality}" '
            f'variability="{varies}" {initial} {begin} {derived}/>'
        )

    variables = "".join(
        [variable(*v, kind="Float64") for v in _EXCHANGE]
        + [variable(*v, kind="Int32") for v in _EXCHANGE_WHOLE]
    )
    return f"""<fmiModelDescription fmiVersion="3.0" modelName="exchange" instantiationToken="t">
<ModelExchange modelIdentifier="exchange3" {attributes}/>{more}<ModelVariables>{variables}
</ModelVariables><ModelStructure><ContinuousStateDerivative valueReference="2"/>
<ContinuousStateDerivative valueReference="3"/><EventIndicator valueReference="9"/>
</ModelStructure></fmiModelDescription>"""


@lru_cache
def library(identifier: str) -> bytes:
    """The compiled C file."""
    output = Path(FOLDER.name) / f"{identifier}{shared_suffix()}"
    return compile_shared([SOURCES / f"{identifier}.c"], output).read_bytes()


def export(description: str, path: Path, sources: bool = False) -> Path:
    """An FMU of a description, with its binary or, instead, its source."""
    identifier = description.split('modelIdentifier="')[1].split('"')[0]
    two = 'fmiVersion="2.0"' in description
    folder = "linux64" if two else "x86_64-linux"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        if sources:
            archive.write(SOURCES / f"{identifier}.c", f"sources/{identifier}.c")
        else:
            archive.writestr(
                f"binaries/{folder}/{identifier}{shared_suffix()}", library(identifier)
            )
    return path


def plan_of(
    path: Path,
    steps: int,
    h: float = 0.1,
    values: dict[str, tuple[float, ...]] | None = None,
    start: dict[str, tuple[float, ...]] | None = None,
    options: FmuOptions | None = None,
    kind: Kind | None = None,
    period: int = 1,
) -> Plan:
    """A plan of one FMU called `x`, alone."""
    component = FmuComponent(path, "x", kind, options)
    at = 0
    slots: dict[str, list[Slot]] = {"inputs": [], "outputs": []}
    for side, ports in (("inputs", component.inputs), ("outputs", component.outputs)):
        for p in ports:
            slots[side].append(Slot(f"x.{p.name}", "x", p.name, at, p.shape, p.unit))
            at += p.size
    step = Step("x", component, component.kind, period, values or {}, tuple(slots["inputs"]),
                tuple(slots["outputs"]), start or {})  # fmt: skip
    return compile_plan(h, steps, [step], [], [])


def run(plan: Plan, feed: dict[str, np.ndarray] | None = None) -> tuple[np.ndarray, Engine]:
    """All signals at the start and after every tick, (steps + 1, signals), and the open engine.

    `feed`: values of an input at every tick.
    """
    engine = Engine(plan)
    engine.initialize()
    slots = plan.slots()
    rows = [engine.signals.copy()]
    for k in range(plan.ticks):
        for name, values in (feed or {}).items():
            slot = slots[f"x.{name}"]
            engine.signals[slot.start : slot.start + slot.size] = np.ravel(values[k])
        engine.run(1)
        rows.append(engine.signals.copy())
    return np.array(rows), engine


def column(plan: Plan, rows: np.ndarray, name: str) -> np.ndarray:
    """One port of all rows."""
    slot = plan.slots()[f"x.{name}"]
    return rows[:, slot.start : slot.start + slot.size].reshape(len(rows), *slot.shape)


def outputs(plan: Plan, feed: dict[str, np.ndarray]) -> dict[str, list[float]]:
    """All outputs at the start and after every step."""
    rows, engine = run(plan, feed)
    engine.close()
    ports = plan.components[0].component.outputs
    return {p.name: column(plan, rows, p.name).tolist() for p in ports}


def by_command(folder: Path) -> subprocess.CompletedProcess[str]:
    """``cosim run bad.toml --out here`` in `folder`, in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", "from cosim.cli import main; main()", "run", "bad.toml",
         "--out", "here", "--no-plot", "-q"],
        cwd=folder, capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
    )  # fmt: skip


@contextmanager
def stopped_at(engine: Engine, tick: int) -> Iterator[None]:
    """Another thread asks the engine to stop at this tick, while the block runs it."""

    def stop() -> None:
        while engine.tick < tick:
            sleep(0.01)
        engine.stop()

    thread = threading.Thread(target=stop, daemon=True)
    thread.start()
    yield
    thread.join()
