"""Texts and binary values from one FMU to another, by wires and links, with clocks and without."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cosim.base.errors import CosimError, RunError, ScenarioError
from cosim.engine.engine import Engine
from cosim.fmi.file.values import NumberedTexts
from cosim.scenario.assemble import assemble
from cosim.ssp.export import write
from tests.cosim.fmi.exporter import export
from tests.cosim.scenarios import plan, scenario

H, STEPS = 0.1, 10


def mail3(flags: str = 'hasEventMode="true"') -> str:
    clocks = "" if not flags else (
        '<Clock name="tick" valueReference="1" causality="input" intervalVariability="constant" '
        'intervalDecimal="0.2"/><Clock name="sent" valueReference="2" causality="output" '
        'intervalVariability="triggered" clocks="1"/><Clock name="go" valueReference="3" '
        'causality="input" intervalVariability="triggered"/>'
        '<Binary name="letter" valueReference="10" causality="input" clocks="3"/>'
        '<Binary name="message" valueReference="11" causality="output" clocks="1"/>'
        '<Binary name="heard" valueReference="12" causality="output" clocks="3"/>'
    )  # fmt: skip
    return f"""<fmiModelDescription fmiVersion="3.0" modelName="mail" instantiationToken="t">
<CoSimulation modelIdentifier="mail3" canHandleVariableCommunicationStepSize="true" {flags}/>
<ModelVariables>{clocks}<Binary name="note" valueReference="13" causality="input"/>
<Binary name="echo" valueReference="14" causality="output"/>
<String name="word" valueReference="20" causality="input"><Start value="hello"/></String>
<String name="said" valueReference="21" causality="output"/>
<Float64 name="number" valueReference="30" causality="local"/>
</ModelVariables><ModelStructure/></fmiModelDescription>"""


@pytest.fixture(scope="module")
def mail(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(mail3(), tmp_path_factory.mktemp("fmu") / "mail3.fmu")


def followed(components: dict[str, Any], *signals: str, links: Any = (), **run: Any) -> list[list]:
    """The texts of signals at the start and after every step."""
    p = plan(components, links, **{"step": H, "stop": H * STEPS, **run})
    rows = []
    with Engine(p) as engine:
        engine.initialize()
        slots = p.slots()
        numbered = p.components[0].component.numbered
        for k in range(STEPS + 1):
            if k:
                engine.run(1)
            rows.append([numbered.text(engine.signals[slots[s].start]) for s in signals])
    return rows


@pytest.mark.parametrize(("kind", "late"), [("sampled", 0), ("continuous", 1)])
def test_a_clocked_value_arrives_with_the_tick_of_its_clock(mail: Path, kind, late: int) -> None:
    """The sender ticks in steps 0, 2, 4 and so on; a plant sees that one step later."""
    a = {"model": str(mail), "kind": kind}
    b = {**a, "inputs": {"go": "a.sent", "letter": "a.message"}}
    z = {"model": str(mail), "inputs": {"note": "b.heard"}}
    found = followed({"a": a, "b": b, "z": z}, "a.message", "b.heard")
    for k in range(1, STEPS + 1):
        assert found[k][0] == f"{(k + 1) // 2:02x}"
        heard = (k + 1 - late) // 2
        assert found[k][1] == (f"{heard:02x}ff" if heard else "ff")  # of an empty letter


@pytest.mark.parametrize("flags", ['hasEventMode="true"', ""])
def test_texts_without_a_clock_are_wires_as_others(tmp_path: Path, flags: str) -> None:
    path = export(mail3(flags), tmp_path / "x.fmu")
    a = {"model": str(path), "kind": "sampled"}
    components = {
        "a": {**a, "start": {"word": "hello"}},
        "b": {**a, "inputs": {"word": "a.said"}},
        "c": {"model": str(path), "inputs": {"word": "b.said"}},
        "z": {"model": str(path), "inputs": {"word": "c.said"}},
    }
    found = followed(components, "a.said", "b.said", "c.said")
    assert found[3] == ["hello 3", "hello 3 3", "hello 3 3 3"]
    found = followed(components, "a.said", "b.said", "c.said", algorithm="jacobi")
    assert found[3] == ["hello 3", "hello 2 3", "hello 1 2 3"]


def test_binary_values_pass_as_they_are_also_over_a_link(mail: Path) -> None:
    """`note` in Event Mode, when it has changed; two steps late over the link."""
    a = {"model": str(mail), "kind": "sampled"}
    b = {**a, "inputs": {"note": "a.message"}}
    z = {**a, "inputs": {"note": "c.echo"}}
    link = {"from": "b.echo", "to": "c.note", "delay": {"law": "constant", "delay": 0.2}}
    found = followed(
        {"a": a, "b": b, "c": {**a}, "z": z}, "a.message", "b.echo", "c.echo", links=[link]
    )
    for k in range(1, STEPS + 1):
        assert found[k][1] == found[k][0]
        assert k < 4 or found[k][2] == found[k - 2][1]


def test_what_is_connected_is_of_one_type(mail: Path) -> None:
    a = {"model": str(mail)}
    for source, message in (
        ("a.said", "a.said is a String variable, b.note expects a Binary variable"),
        ("a.sent", "a.sent is a number, b.note expects a Binary variable"),
        ("a.number", "a.number is a number, b.note expects a Binary variable"),
    ):
        with pytest.raises(ScenarioError, match=message):
            plan({"a": a, "b": {**a, "inputs": {"note": source}}}, step=H, stop=H)
    wire = {"from": "a.echo", "gain": 2.0}
    with pytest.raises(ScenarioError, match="found gain or offset, which texts do not have"):
        plan({"a": a, "b": {**a, "inputs": {"note": wire}}}, step=H, stop=H)
    with pytest.raises(ScenarioError, match=r"b.word is a String or Binary variable.* no output"):
        plan({"a": a, "b": {**a, "inputs": {"word": "b.word"}}}, step=H, stop=H)


def test_texts_are_not_exported(mail: Path, tmp_path: Path) -> None:
    a = {"model": str(mail)}
    made = scenario({"a": a, "b": {**a, "inputs": {"note": "a.echo"}}}, step=H, stop=H)
    with pytest.raises(ScenarioError, match=r"a.echo is a Binary variable, which is not exported"):
        write(made, assemble(made), tmp_path / "x.ssp")


def test_an_isolated_fmu_is_refused(mail: Path) -> None:
    a = {"model": str(mail)}
    b = {**a, "isolate": True, "inputs": {"note": "a.echo"}}
    made = plan({"a": a, "b": b}, step=H, stop=H)
    with pytest.raises(CosimError, match="b does not start: the texts note are connected, which"):
        Engine(made).initialize()


def test_a_value_that_is_refused_is_a_sentence(mail: Path) -> None:
    """What the receiver cannot take; each round makes `heard` one byte longer."""
    a = {"model": str(mail), "kind": "sampled"}
    components = {"clock": a, "b": {**a, "inputs": {"go": "clock.sent"}}}
    delay = {"law": "constant", "delay": 0.1}
    link = {"from": "b.heard", "to": "b.letter", "delay": delay, "initial": 0.0}  # 0: empty
    p = plan(components, [link], step=H, stop=20.0)
    with Engine(p) as engine:
        engine.initialize()
        with pytest.raises(RunError, match=r"b: setting inputs returned error \(too long\)"):
            engine.run(200)


def test_numbers_of_texts_are_those_of_their_appearance() -> None:
    numbered = NumberedTexts()
    assert [numbered.number(t) for t in ("b", "a", "b", "")] == [1.0, 2.0, 1.0, 0.0]
    assert [numbered.text(n) for n in (0.0, 1.0, 2.0)] == ["", "b", "a"]
