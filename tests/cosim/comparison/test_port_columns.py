"""Measures of the port in a comparison, against the impedance of an LTI pair in closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import ScenarioError
from cosim.comparison.port_columns import FREQUENCIES
from cosim.comparison.rows import columns, rows
from cosim.comparison.variants_file import read
from cosim.predict.frequency import MultiSine, PortGain
from cosim.predict.transparency import (
    free_impedance,
    passivity_margin,
    spring_impedance,
    transparency_error,
    z_width,
)
from fmus.arms.dynamics import inertia
from fmus.models.planar2r import PRESETS
from tests.cosim.comparison.parts import SMALL, compared, written

Q, BAND = (0.5, 1.0), (1.0, 20.0)
SPRING, RIGID = (100.0, 2.0), (2000.0, 60.0)
KINDS = {
    "transparency": "transparency", "width": "z_width", "free": "free_impedance",
    "margin": "passivity", "margin-spring": "passivity",
}  # fmt: skip
PORT = f"""
[port]
operator = "master"
environment = "slave"
q = {list(Q)}
band = {list(BAND)}
spring = {{ stiffness = {SPRING[0]}, damping = {SPRING[1]} }}
rigid = {{ stiffness = {RIGID[0]}, damping = {RIGID[1]} }}
""" + "".join(
    f'[columns.{name}]\nkind = "{kind}"\n'
    + ('environment = "spring"\n' if name == "margin-spring" else "")
    for name, kind in KINDS.items()
)  # fmt: skip
COUPLED = """
[controllers.coupled]
model = "fmus.models.p_d"
parameters = { K = 40.0, B = 15.0 }
receives = { q_j = "arm.q" }
[controllers.apart]
model = "fmus.models.pd"
preset = "free"
receives = { q_j = "arm.q", dq_j = "arm.dq" }
[stable]"""
K, B, T = 40.0, 15.0, 0.1


def variants(folder: Path, step: str = "1 ms") -> Path:
    text = SMALL.replace("run.step=5 ms", f"run.step={step}").replace("[stable]", COUPLED)
    text = text.replace('["run.step', '["components.master_control.period=1 ms", '
                        '"components.slave_control.period=1 ms", "run.step')  # fmt: skip
    return written(folder, text + PORT)


def closed(environment: tuple[float, float]) -> PortGain:
    """The port of two arms coupled by K q_j(t - T) - K q - B dq, the slave at a spring."""
    omega = MultiSine.spread(*BAND, 1e-3, FREQUENCIES, 1.0).omega
    M = inertia(np.array(PRESETS["SL91"]["theta"]), np.array(Q))
    s = 1j * omega[:, None, None]
    own = M * s + (B + K / s) * np.eye(2)
    D = own + (environment[0] / s + environment[1]) * np.eye(2)
    Z = own - (K / s * np.exp(-s * T)) ** 2 * np.linalg.inv(D)
    return PortGain(omega, np.linalg.inv(Z) / s, 1e-9)


def test_the_measures_are_those_of_the_closed_form(tmp_path: Path) -> None:
    """To 2 %, or 0.15 dB: what is left is sampling, 1 ms against a frequency of 20 rad/s."""
    found = compared(variants(tmp_path), ["coupled"])
    (outcome,) = found.outcomes
    value = {name: number for name, (number, _) in outcome.numbers.items()}
    free, spring, rigid = (closed(x) for x in ((0.0, 0.0), SPRING, RIGID))
    ideal = spring_impedance(spring.omega, *SPRING)
    assert value["transparency"] == pytest.approx(transparency_error(spring, ideal)[0], abs=0.15)
    assert value["width"] == pytest.approx(z_width(free, rigid)[0], abs=0.15)
    assert value["free"] == pytest.approx(free_impedance(free)[0], rel=0.02)
    assert value["margin"] == pytest.approx(passivity_margin(free)[0], abs=0.02)
    assert value["margin-spring"] == pytest.approx(passivity_margin(spring)[0], abs=0.02)
    assert all(0 <= error < 0.05 for error in outcome.errors.values())
    assert outcome.remark == ""


def test_an_arm_that_nothing_couples_shows_its_inertia(tmp_path: Path) -> None:
    """Exactly, also sampled: Z = M (2/h) (z - 1)/(z + 1); the passivity of a mass is 0."""
    found = compared(variants(tmp_path), ["apart"])
    value = {name: number for name, (number, _) in found.outcomes[0].numbers.items()}
    omega = MultiSine.spread(*BAND, 1e-3, FREQUENCIES, 1.0).omega
    M = inertia(np.array(PRESETS["SL91"]["theta"]), np.array(Q))
    size = 2 / 1e-3 * np.tan(omega * 1e-3 / 2)
    w = np.gradient(np.log(omega))
    w[[0, -1]] /= 2
    expected = np.exp(np.average(np.log(size), weights=w)) * np.sqrt(np.linalg.det(M))
    assert value["free"] == pytest.approx(expected, rel=1e-3)
    assert value["width"] == pytest.approx(0.0, abs=1e-3)
    assert value["margin"] == pytest.approx(0.0, abs=1e-4)


def test_columns_are_chosen_and_ports_are_measured_once(tmp_path: Path) -> None:
    path = variants(tmp_path)
    text = path.read_text(encoding="utf-8") + "[operators.free]\nmaster = { k_p = 0, k_d = 0 }\n"
    text += '[default]\ncolumns = ["effort", "margin"]\n'
    found = compared(written(tmp_path, text), ["apart"])
    assert [c.name for c, _ in columns(found)] == ["effort", "margin"]
    assert len(found.outcomes) == 2
    first, second = (o.numbers["margin"] for o in found.outcomes)
    assert first == second
    assert all(row.cell(columns(found)[1][0], "1") for row in rows(found))
    with pytest.raises(ScenarioError, match="no column 'marign'; did you mean 'margin'"):
        read(path).with_columns(["marign"])
    assert [c.name for c in read(path).with_columns(["margin", "effort"]).columns] == [
        "margin", "effort"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("[port]\n", "[other]\n"), "unknown|no key 'other'"),
        (('environment = "slave"\nq', 'environment = "slav"\nq'), "no role 'slav'"),
        ((f"band = {list(BAND)}", "band = [3.0, 1.0]"), "two frequencies in rad/s"),
        (('environment = "spring"\n', 'environment = "springy"\n'), "free, spring, rigid"),
        (('kind = "z_width"', 'kind = "z_width"\nof = ["master.q"]'), "no key 'of'"),
    ],
)
def test_what_the_file_cannot_say(tmp_path: Path, change: tuple[str, str], says: str) -> None:
    text = variants(tmp_path).read_text(encoding="utf-8")
    assert change[0] in text
    with pytest.raises(ScenarioError, match=says):
        read(written(tmp_path, text.replace(*change)))


def test_a_measure_of_the_port_needs_the_table(tmp_path: Path) -> None:
    text = SMALL + '[columns.margin]\nkind = "passivity"\n'
    with pytest.raises(ScenarioError, match=r"kind 'passivity' needs a table \[port\]"):
        read(written(tmp_path, text))


def test_arms_that_do_not_come_to_rest_have_no_number_but_a_reason(tmp_path: Path) -> None:
    """PD(50, 10) over 0.1 s each way swings up without a hand."""
    text = variants(tmp_path, "5 ms").read_text(encoding="utf-8")
    text = text.replace("PD(10,4)", "PD(50,10)").replace("100 ms", "300 ms")
    text = text.replace("control.period=1 ms", "control.period=5 ms")
    found = compared(written(tmp_path, text), ["pd"])
    (outcome,) = found.outcomes
    assert np.isnan(outcome.numbers["margin"][0])
    assert "do not come to rest" in outcome.remark
