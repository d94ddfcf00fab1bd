"""Sec. II-B and III: Lemmas 1 to 3 on linear agents, friction that varies, degree one and two."""

from __future__ import annotations

from math import exp, log, sqrt
from typing import Any

import numpy as np

from cosim.record import Run
from fmus.paper import measure as m
from fmus.paper.claim import Claim, absolute, at_least, at_most, relative
from fmus.paper.experiments import DELAY, Document, document

#: Friction that alternates, N.s/m, and for how long each, s; the mass is 1 kg.
LOW, HIGH, HALF = 0.5, 2.0, 5.0
#: Rate of the chirp, rad/s²; of the coupling, 1/s; how long the lemmas run, s.
CHIRP, RATE, STOP = 0.25, 1.0, 40.0
CONSTANT = {"law": "constant", "delay": 0.75}
ROUND_TRIP = 1.5
#: How long the mass is pushed with 1 N, and too long, s; and when we look, s.
PULSE, TOO_LONG, LATER = 2.0, 2.2, 60.0


def cases(seed: int) -> dict[str, Document]:
    """The runs by name; `seed` is that of the delays."""
    chirp = _wave("chirp", rate=CHIRP)
    fading = _wave("chirp", rate=CHIRP, fading=True)
    one = {"model": "fmus.models.push"}
    pulses = {
        f"pulse-{b:g}-{length:g}": _mass(LATER, b, {**one, "start": {"t_1": length}})
        for b in (1.0, 0.0)
        for length in (PULSE, TOO_LONG)
    }
    return pulses | {
        "varying-push": _mass(100.0, None, one),
        "varying-fading": _mass(600.0, None, _wave("fading", size=1.0)),
        "lemma2-chirp": _mass(STOP, None, chirp),
        "lemma2-fading": _mass(STOP, 1.0, fading),
        "lemma1-chirp": _agents(chirp, DELAY, seed),
        "lemma1-fading": _agents(fading, CONSTANT, seed),
        "lemma3-constant": _agents(_wave("steady", size=1.0), CONSTANT, seed),
        "lemma3-fading": _agents(_wave("fading", size=1.0), CONSTANT, seed),
    }


def _wave(name: str, **options: Any) -> Document:
    return {"model": f"fmus.paper.components:{name}", "options": options}


def _mass(stop: float, b: float | None, hand: Document) -> Document:
    """The point mass with friction `b` (N.s/m), or one that alternates, under a hand."""
    step = 0.005 if "chirp" in hand["model"] else 0.01 if "push" in hand["model"] else 0.05
    port = "f" if "push" in hand["model"] else "u"
    mass: Document = {
        "model": "fmus.models.pointmass",
        "period": step,
        "start": {"b": 0.0 if b is None else b},
        "inputs": {"f": f"hand.{port}"},
    }
    components = {"mass": mass, "hand": {**hand, "period": step}}
    record = ["mass.x", "mass.dx", f"hand.{port}"]
    if b is None:
        mass["inputs"]["b_add"] = "friction.b"
        options = {"low": LOW, "high": HIGH, "half": HALF}
        components["friction"] = {**_wave("square", **options), "period": step}
        record.append("friction.b")
    return document("Point mass", stop, components, record, step=step)


def _agents(hand: Document, delay: Any, seed: int) -> Document:
    """Two agents that hear each other over links with `delay`; the first has an input."""
    options: dict[str, Any] = {"rate": RATE}
    step = 0.005 if "chirp" in hand["model"] else 0.05
    agent = {"model": "fmus.paper.components:LinearAgent", "period": step, "options": options}
    unit = {**hand["options"], "unit": "m/s"}
    components: Document = {
        "one": {**agent, "inputs": {"u": "hand.u"}},
        "two": dict(agent),
        "hand": {**hand, "period": step, "options": unit},
    }
    links = [
        {"from": f"{a}.x", "to": f"{b}.x_in", "delay": dict(delay)}
        for a, b in (("one", "two"), ("two", "one"))
    ]
    names = [f"{a}.{x}" for a in ("one", "two") for x in ("x", "dx", "F")]
    return document(
        "Two linear agents", STOP, components, [*names, "hand.u"], links=links, seed=seed, step=step
    )


# ---- Sec. III: friction that varies --------------------------------------------------------------


def _turn() -> tuple[float, float]:
    """Mean velocity and root mean square velocity (m/s) of a push of 1 N, friction alternating.

    In each half v goes to 1/b with exp(-bt): v = 1/b + c exp(-bt), and it is periodic.
    """
    fall = exp(-LOW * HALF), exp(-HIGH * HALF)
    # v_1 at the start of the half with LOW, v_2 at the start of that with HIGH
    v_1 = (1 / HIGH * (1 - fall[1]) + fall[1] / LOW * (1 - fall[0])) / (1 - fall[0] * fall[1])
    v_2 = 1 / LOW + (v_1 - 1 / LOW) * fall[0]
    mean = square = 0.0
    for b, v, f in ((LOW, v_1, fall[0]), (HIGH, v_2, fall[1])):
        c = v - 1 / b
        mean += HALF / b + c * (1 - f) / b
        square += HALF / b**2 + 2 * c * (1 - f) / b**2 + c**2 * (1 - f**2) / (2 * b)
    return mean / (2 * HALF), sqrt(square / (2 * HALF))


def _ratio(r: Run) -> float:
    """Largest (V + ∫b/2 dx²)/∫f²/(2b) from 0.1 s on; V(0) = 0."""
    b, dx, f = (r.array(x)[:, 0] for x in ("friction.b", "mass.dx", "hand.f"))
    left = 0.5 * dx**2 + m.integral(b / 2 * dx**2, r.t)
    right = m.integral(f**2 / (2 * b), r.t)
    return float((left / np.maximum(right, 1e-12))[m.row(r, 0.1) :].max())


def _velocity_share(r: Run) -> float:
    """|dx|₂/|f|₂ over the last two turns of the friction, m/(N.s)."""
    rows = r.t > r.t[-1] - 4 * HALF + 1e-9
    return sqrt(float((r.array("mass.dx")[rows, 0] ** 2).mean()))


def _climb(r: Run) -> float:
    """Rise of x for each rise of ln(t + 1) by 1, from 100 s to the end, m."""
    x, first = r.array("mass.x")[:, 0], m.row(r, 100.0)
    return float((x[-1] - x[first]) / log((r.t[-1] + 1) / (r.t[first] + 1)))


_MEAN, _ROOT = _turn()
_VARYING = ("varying-push",)
_SEC_3 = (
    Claim("varying-speed", ("sec3", "varying"), "b(t) 0.5 or 2 N.s/m: 1 N moves the mass at",
          "m/s", relative(_MEAN, 2e-3), "periodic solution of m ddx + b(t) dx = f", _VARYING,
          lambda r: m.velocity(r, "mass.x", 4 * HALF)[0]),
    Claim("varying-gain", ("sec3", "varying"), "|dx|_2/|f|_2, at most 1/min b = 2", "m/(N.s)",
          relative(_ROOT, 5e-3), "the same solution: finite", _VARYING, _velocity_share),
    Claim("varying-energy", ("sec3", "varying"), "largest (V + ∫b/2 dx²)/(V(0) + ∫f²/(2b))", "1",
          at_most(1.0), "Sec. III, the inequality integrated", _VARYING, _ratio),
    Claim("varying-degree", ("sec3", "varying"), "slope of M^t of the push, 50 to 100 s", "1",
          absolute(1.0, 0.02), "degree one", _VARYING,
          lambda r: m.growth(r, "hand.f", ["mass.x"], 50.0, 100.0)),
    Claim("varying-fading", ("sec3", "varying"), "f = 1/(t + 1): x rises with each ln(t + 1) by",
          "m", relative(_MEAN, 0.02), "the mean velocity of 1 N; without bound",
          ("varying-fading",), _climb),
)  # fmt: skip


# ---- Sec. III: degree one and degree two ---------------------------------------------------------


def _further(right: Run, wrong: Run) -> float:
    """The additional distance by which the longer pulse takes the mass, m."""
    return float(m.final(wrong, "mass.x")[0] - m.final(right, "mass.x")[0])


_PULSE_1, _PULSE_0 = (tuple(f"pulse-{b:g}-{x:g}" for x in (PULSE, TOO_LONG)) for b in (1, 0))
_DEGREE = (
    Claim("degree-1-stays", ("sec3", "degree"), "b = 1: pushed for 2 s, the mass stays at", "m",
          relative(PULSE, 1e-3), "f t/b", _PULSE_1[:1], lambda r: m.final(r, "mass.x")[0]),
    Claim("degree-2-goes-on", ("sec3", "degree"), "b = 0: pushed for 2 s, it goes on at", "m/s",
          relative(PULSE, 1e-9), "f t/m: it must be stopped", _PULSE_0[:1],
          lambda r: m.final(r, "mass.dx")[0]),
    Claim("degree-1-error", ("sec3", "degree"), "b = 1: 0.2 s too long, at 60 s it is off by", "m",
          relative(TOO_LONG - PULSE, 1e-3), "f Δt/b", _PULSE_1, _further),
    Claim("degree-2-error", ("sec3", "degree"), "b = 0: 0.2 s too long, at 60 s it is off by", "m",
          relative(TOO_LONG * (LATER - TOO_LONG / 2) - PULSE * (LATER - PULSE / 2), 1e-3),
          "f (t_1 (T - t_1/2) - ...)/m: degree two is harder to position", _PULSE_0, _further),
)  # fmt: skip


# ---- Lemmas 1 to 3 ------------------------------------------------------------------------------


def _late(name: str) -> Any:
    """Largest |x| of a signal over the last 10 s."""
    return lambda r: np.abs(r.array(name)[m.row(r, STOP - 10.0) : -1]).max()


def _between(r: Run) -> m.Array:
    """The output y = x_1 - x_2 of the pair, m, (n,)."""
    return np.asarray((r.array("one.x") - r.array("two.x"))[:-1, 0])


def _tail(r: Run, y: m.Array) -> float:
    """∫y² from 20 s to the end."""
    square = m.integral(y**2, r.t[: len(y)])
    return float(square[-1] - square[m.row(r, 20.0)])


_FADED = 0.5 * (1 / 21 - 1 / 41)
_STEEP = 2 * CHIRP * STOP
_SHARE = 1 / (2 + RATE * ROUND_TRIP)
_LEMMAS = (
    Claim("lemma2-input", ("lemma2",), "u = d/dt sin(t²/4): largest |u| up to 40 s", "N",
          relative(_STEEP, 0.02), "t/2: not bounded, its integral is", ("lemma2-chirp",),
          _late("hand.u")),
    Claim("lemma2-bounded", ("lemma2",), "b(t): output dx of it, largest of the last 10 s", "m/s",
          absolute(1.0, 0.06), "the integral of u, filtered: bounded by 2, and 1 at high rates",
          ("lemma2-chirp",), _late("mass.dx")),
    Claim("lemma2-square", ("lemma2",), "∫u + c in L_2: ∫dx² dt from 20 to 40 s", "m2/s",
          relative(_FADED, 0.05), "½(1/21 - 1/41), while ∫u² grows", ("lemma2-fading",),
          lambda r: _tail(r, r.array("mass.dx")[:-1, 0])),
    Claim("lemma1-bounded", ("lemma1",), "delays redrawn: |x_1 - x_2| of the same u, last 10 s",
          "m", absolute(1.0, 0.3), "bounded: 1 at high rates, and what the network adds",
          ("lemma1-chirp",), lambda r: np.abs(_between(r)[m.row(r, STOP - 10.0):]).max()),
    Claim("lemma1-square", ("lemma1",), "dT/dt = 0, ∫u + c in L_2: ∫(x_1 - x_2)² from 20 to 40 s",
          "m2.s", relative(_FADED, 0.05), "½(1/21 - 1/41)", ("lemma1-fading",),
          lambda r: _tail(r, _between(r))),
    Claim("lemma3-bounded", ("lemma3",), "u = 1: dx_1 at 40 s, while x_1 grows", "m/s",
          relative(_SHARE, 0.02), "1/(2 + λ(T_12 + T_21)); samples are held for 50 ms",
          ("lemma3-constant",), lambda r: r.array("one.dx")[-2, 0]),
    Claim("lemma3-unbounded", ("lemma3",), "x_1 has gone by then", "m", at_least(10.0),
          "x is not bounded: marginally stable", ("lemma3-constant",),
          lambda r: m.final(r, "one.x")[0]),
    Claim("lemma3-vanishes", ("lemma3",), "u = 1/(t + 1) -> 0: dx_1 over u at 40 s", "1",
          relative(_SHARE, 0.08), "dx -> 0 as u does", ("lemma3-fading",),
          lambda r: r.array("one.dx")[-2, 0] / r.array("hand.u")[-2, 0]),
    Claim("lemma3-derivative", ("lemma3",), "u = d/dt sin(t²/4): |dx_1| of the last 10 s", "m/s",
          relative(_STEEP, 0.05), "dx follows u, and is not bounded", ("lemma1-chirp",),
          _late("one.dx")),
    Claim("lemma3-network", ("lemma3",), "but F_D(x) = dx_1 - u: largest of the last 10 s", "m/s",
          absolute(RATE, 0.3), "bounded as ∫u is: λ at high rates", ("lemma1-chirp",),
          _late("one.F")),
)  # fmt: skip

CLAIMS = (*_SEC_3, *_DEGREE, *_LEMMAS)
