"""Two arms coupled by a pair of controllers: models, values, and the signals that each side sends.

The module has a table of data for comparisons of controllers in one scenario, and two functions
that express it in the form of a scenario: the controllers as components, their exchange as links.

In the table of a pair ``plant`` denotes the arm of a side and ``control`` its controller. A sent
signal is connected to the component of the other side. The operator is at the first side.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType
from typing import Any

from fmus.model import Model
from fmus.models import (
    abdessameud2014,
    chopra,
    lee_spong,
    nuno_adaptive,
    p_d,
    pd,
    tdpa_admittance,
    tdpa_impedance,
    wang2014,
    wave_admittance,
    wave_impedance,
    wave_integral_admittance,
    wave_integral_impedance,
)

#: (source on this side, target on the other side) of each signal that one side sends.
Exchange = tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class BilateralSide:
    """One side: a model by its module's name, values of its parameters, and its sent signals."""

    model: str
    values: Mapping[str, float]
    sends: Exchange


@dataclass(frozen=True, slots=True)
class Pair:
    """Two sides; `constant_delay`: the law needs a delay that does not vary to be passive."""

    title: str
    first: BilateralSide
    second: BilateralSide
    constant_delay: bool = False


#: What a side sends to the other one; the others send the motion of their arm.
_MOTION = (("plant.q", "control.q_j"), ("plant.dq", "control.dq_j"))
_SENDS: dict[ModuleType, Exchange] = {
    abdessameud2014: (("plant.q", "control.q_j"),),
    chopra: (("control.r", "control.r_j"),),
    p_d: (("plant.q", "control.q_j"),),
    tdpa_admittance: (("control.f", "control.f_j"), ("control.E", "control.E_j")),
    tdpa_impedance: (
        ("control.v", "control.v_j"),
        ("control.E", "control.E_j"),
        ("plant.q", "control.q_j"),
    ),
    wave_admittance: (("control.v", "control.v"),),
    wave_impedance: (("control.u", "control.u"),),
    wave_integral_admittance: (("control.U", "control.U_j"), ("control.E", "control.E_j")),
    wave_integral_impedance: (("control.U", "control.U_j"), ("control.E", "control.E_j")),
}


def _side(model: ModuleType, preset: str) -> BilateralSide:
    return BilateralSide(model.__name__, model.PRESETS[preset], _SENDS.get(model, _MOTION))


def _paper(lambda_M: float) -> BilateralSide:
    """The paper's controller, eqs (76)-(81), with the gains of Sec. VII-C."""
    values = {"K": 16.0, "Gamma": 1.0, "alpha": 0.5, "lambda": 2.0, "lambda_M": lambda_M}
    return BilateralSide("fmus.models.teleoperation", values, (("control.xi", "control.xi_in[0]"),))


def _same(title: str, side: BilateralSide, *, constant_delay: bool = False) -> Pair:
    return Pair(title, side, side, constant_delay)


def _wave(title: str, preset: str) -> Pair:
    return Pair(title, _side(wave_impedance, preset), _side(wave_admittance, preset), True)


def _tdpa(title: str, preset: str) -> Pair:
    return Pair(title, _side(tdpa_impedance, preset), _side(tdpa_admittance, preset))


#: By the name a comparison calls them.
PAIRS: dict[str, Pair] = {
    "paper": _same("Dynamic feedback, lambda_M = 10 (Theorem 5)", _paper(10.0)),
    "paper-1": _same("Dynamic feedback, lambda_M = 1 (Theorem 5)", _paper(1.0)),
    "cascade": _same("Integral cascade: dynamic feedback, lambda_M = 0", _paper(0.0)),
    "pd": _same("Plain PD(10, 4)", _side(pd, "PD(10,4)")),
    "pd-stiff": _same("Plain PD(50, 10)", _side(pd, "PD(50,10)")),
    "p+d": _same("P+d, B = 12.5", _side(p_d, "P+d")),
    "p+d-violating": _same("P+d, B = 3: condition violated", _side(p_d, "P+d violating")),
    "lee-spong": _same(
        "PD with dissipation (Lee, Spong 2006)", _side(lee_spong, "Lee-Spong"), constant_delay=True
    ),
    "nuno": _same(
        "Adaptive synchronisation (Nuño, Ortega, Basañez 2010)",
        _side(nuno_adaptive, "Nuno"),
        constant_delay=True,
    ),
    "chopra": _same(
        "Adaptive synchronisation (Chopra, Spong, Lozano 2008)",
        _side(chopra, "Chopra"),
        constant_delay=True,
    ),
    "wang": _same("Static feedback (Wang 2014)", _side(wang2014, "Wang"), constant_delay=True),
    "abdessameud": _same(
        "Reference filter (after Abdessameud, Polushin, Tayebi 2014)",
        _side(abdessameud2014, "Abdessameud"),
    ),
    "abdessameud-violating": _same(
        "Reference filter, k_d² < 4 k_p: condition violated",
        _side(abdessameud2014, "Abdessameud violating"),
    ),
    "wave": _wave("Wave variables, b = 10 (Niemeyer, Slotine 1991)", "wave(b=10)"),
    "wave-integral": Pair(
        "Integrals of waves, b = 10 (after Niemeyer, Slotine 1998)",
        _side(wave_integral_impedance, "wave integrals(b=10)"),
        _side(wave_integral_admittance, "wave integrals(b=10)"),
    ),
    "scattering": _wave("Scattering, n = 3 (Anderson, Spong 1989)", "scattering(n=3)"),
    "tdpa": _tdpa("Time-domain passivity (Ryu, Artigas, Preusche 2010)", "TDPA"),
    "tdpa-drift": _tdpa("Time-domain passivity with drift compensation", "TDPA drift"),
    "copy": Pair(
        "Unilateral copy: PD(10, 4) on the second side only",
        _side(pd, "free"),
        _side(pd, "PD(10,4)"),
    ),
    "free": _same("No coupling (zero force)", _side(pd, "free")),
}


def controls(
    pair: Pair, arms: tuple[str, str], period: float | str = 5e-3
) -> dict[str, dict[str, Any]]:
    """The two controllers as components of a scenario, called like their arms and ``_control``.

    The component of an arm takes its torque from the output ``tau`` of its controller. `period` is
    in s, or a text with a unit.
    """
    return {
        f"{arm}_control": {
            "model": side.model,
            "period": period,
            "parameters": dict(side.values),
            "inputs": {name: f"{arm}.{name}" for name in ("q", "dq") if name in _inputs(side)},
        }
        for arm, side in zip(arms, (pair.first, pair.second), strict=True)
    }


def _inputs(side: BilateralSide) -> set[str]:
    model: Model = import_module(side.model).model()
    return {port.name for port in model.inputs()}


def links(
    pair: Pair, arms: tuple[str, str], delay: Mapping[str, Any], **options: Any
) -> list[dict[str, Any]]:
    """The links of a scenario between the controllers: one channel each way.

    `delay` and `options` (semantics, playout, loss) are those of every link; see
    :mod:`cosim.scenario.spec`.
    """
    here, there = arms
    made = []
    for side, a, b in ((pair.first, here, there), (pair.second, there, here)):
        for source, target in side.sends:
            ends = {"from": _endpoint(source, a), "to": _endpoint(target, b)}
            made.append({**ends, "channel": f"{a}->{b}", "delay": dict(delay), **options})
    return made


def _endpoint(text: str, arm: str) -> str:
    owner, _, port = text.partition(".")
    return f"{arm if owner == 'plant' else f'{arm}_control'}.{port}"
