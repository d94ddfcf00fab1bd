"""Start values that are passed on along wires: who is asked for them, and how often."""

from __future__ import annotations

from typing import Any

from cosim.base.component import Port
from cosim.engine.engine import Engine
from tests.cosim.scenarios import plan


class Asked:
    """Sampled: `through` is u, `y` is 5 whatever u is; it keeps the inputs of each question."""

    kind = "sampled"
    inputs = (Port("u"),)
    outputs = (Port("y"), Port("through"))
    parameters = ()

    def initialize(self, values: dict[str, Any]) -> None:
        self.questions: list[float] = []

    def initial(self, u: dict[str, Any]) -> dict[str, float]:
        self.questions.append(float(u["u"]))
        return {"y": 5.0, "through": float(u["u"])}

    def step(self, t: float, h: float, u: dict[str, Any]) -> dict[str, float]:
        return {"y": 5.0, "through": float(u["u"])}

    def get_state(self) -> None: ...

    def set_state(self, state: None) -> None: ...


def questions(**wires: str) -> dict[str, list[float]]:
    """The inputs with which each component is asked at the start, in the order of their names."""
    model = f"{Asked.__module__}:Asked"
    p = plan({name: {"model": model, "inputs": {"u": of}} if of else {"model": model}
              for name, of in wires.items()})  # fmt: skip
    with Engine(p) as engine:
        engine.initialize()
    return {step.name: step.component.questions for step in p.components}  # type: ignore[attr-defined]


def test_each_is_asked_once_for_each_value_of_its_input() -> None:
    """Against the order of components a value takes a pass for each wire, along it none."""
    found = questions(a="b.through", b="c.through", c="d.y", d="")
    assert found == {"a": [0.0, 5.0], "b": [0.0, 5.0], "c": [0.0, 5.0], "d": [0.0]}
    found = questions(a="", b="a.y", c="b.through", d="c.through")
    assert found == {"a": [0.0], "b": [5.0], "c": [5.0], "d": [5.0]}


def test_who_is_fed_by_what_changes_is_not_asked_again_for_the_same_value() -> None:
    """c changes in an output that b does not take."""
    found = questions(a="", b="c.y", c="d.through", d="e.y", e="")
    assert found["c"] == [0.0, 5.0] and found["b"] == [0.0, 5.0]
    assert found["a"] == [0.0]
