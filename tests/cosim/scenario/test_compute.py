"""The key `compute`: results of a component are as late as over a link with that delay."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cosim.base.errors import CosimError
from cosim.base.toml import read
from cosim.engine.simulate import simulate
from cosim.record.run import Run
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build

EXAMPLE = Path(__file__).parents[3] / "examples/policy/policy.toml"
LATE = {"law": "constant", "delay": "150 ms"}


def document() -> dict[str, Any]:
    """The example with a policy in Python, so that it needs no ONNX Runtime."""
    found: dict[str, Any] = read(EXAMPLE)
    found["run"]["stop"] = "3 s"
    policy = found["components"]["policy"]
    del policy["options"]
    policy["model"] = f"{__name__}:Policy"
    return found


class Policy:
    """target = q + 1.5 (goal - q) - 0.1 dq."""

    def __init__(self) -> None:
        from cosim.base.component import Port

        self.kind = "sampled"
        self.inputs = (Port("q", (2,), "rad"), Port("dq", (2,), "rad/s"))
        self.outputs = (Port("target", (2,), "rad"),)
        self.parameters = ()

    def initialize(self, values: Any) -> None:
        """It has no state."""

    def initial(self, u: Any) -> dict[str, Any]:
        """The outputs for these inputs."""
        return {"target": u["q"] + 1.5 * (0.8 - u["q"]) - 0.1 * u["dq"]}

    def step(self, t: float, h: float, u: Any) -> dict[str, Any]:
        """The same in a step."""
        return self.initial(u)


def recorded(data: dict[str, Any], folder: Path) -> Run:
    """The run of a document."""
    simulate(build(data, EXAMPLE), folder)
    return Run.open(folder)


def same(a: Run, b: Run) -> bool:
    """True if the signals of two runs have the same bits."""
    return all(a.column(name).tobytes() == b.column(name).tobytes() for name in a.names)


def test_a_wire_is_late_like_a_link_of_packets_to_the_bit(tmp_path: Path) -> None:
    computing, linked = document(), document()
    del linked["components"]["policy"]["compute"]
    del linked["components"]["servo"]["inputs"]["q_j"]
    link = {"from": "policy.target", "to": "servo.q_j", "delay": LATE}
    linked["links"] = [link | {"semantics": "newest-stamp"}]
    a = recorded(computing, tmp_path / "a")
    assert same(a, recorded(linked, tmp_path / "b"))
    del computing["components"]["policy"]["compute"]
    assert not same(a, recorded(computing, tmp_path / "c"))  # a frozen world differs


def test_a_link_is_later_by_the_time_that_its_sender_computes(tmp_path: Path) -> None:
    law = {"law": "uniform", "low": "5 ms", "high": "60 ms"}
    link = {"from": "policy.target", "to": "servo.q_j", "delay": law, "semantics": "newest-stamp"}
    computing, summed = document(), document()
    for data in (computing, summed):
        del data["components"]["servo"]["inputs"]["q_j"]
    computing["links"] = [link]
    del summed["components"]["policy"]["compute"]
    summed["links"] = [link | {"delay": {"law": "sum", "of": [LATE, law]}}]
    assert same(recorded(computing, tmp_path / "a"), recorded(summed, tmp_path / "b"))


def test_a_frame_on_a_bus_is_handed_over_when_the_result_is_there(tmp_path: Path) -> None:
    runs = []
    for compute, offset in (("150 ms", "2 ms"), (0, "152 ms")):
        data = document()
        del data["components"]["servo"]["inputs"]["q_j"]
        data["components"]["policy"]["compute"] = compute
        data["bus"] = {"can": {"bitrate": 500000}}
        frame = {"id": 0x123, "bytes": 8, "offset": offset}
        data["links"] = [{"from": "policy.target", "to": "servo.q_j", "bus": "can", "frame": frame}]
        runs.append(recorded(data, tmp_path / str(offset).split()[0]))
    assert same(*runs)


@pytest.mark.parametrize(
    ("where", "value", "words"),
    [
        (
            "policy",
            "400 ms",
            r"components\.policy\.compute: found 0\.4 s, expected 0 to the period",
        ),
        ("policy", -0.1, r"components\.policy\.compute: found -0\.1 s"),
        ("arm", "1 ms", r"components\.arm\.compute: found a continuous component"),
        ("policy", "soon", r"components\.policy\.compute"),
    ],
)
def test_times_that_cannot_be_are_refused(where: str, value: Any, words: str) -> None:
    data = document()
    data["components"][where]["compute"] = value
    with pytest.raises(CosimError, match=words):
        assemble(build(data, EXAMPLE))


def test_a_link_that_rounds_its_delay_to_samples_is_refused() -> None:
    data = document()
    del data["components"]["servo"]["inputs"]["q_j"]
    data["links"] = [{"from": "policy.target", "to": "servo.q_j", "delay": LATE}]
    with pytest.raises(CosimError, match=r'links\.0\.semantics: found semantics = "signal"'):
        assemble(build(data, EXAMPLE))
