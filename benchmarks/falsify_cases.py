"""Scenarios that ``cosim falsify`` breaks: the shipped teleoperation with other hands and laws."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cosim.base import toml

Document = dict[str, Any]

#: The teleoperation on links of 0.3 to 1.2 s.
SCENARIO = Path(__file__).resolve().parents[1] / "configs" / "teleoperation.toml"
#: Laws of wave variables: models of master and slave, preset, what each sends, and a suffix of
#: the inputs for it.
WAVES = {
    "wave": ("impedance", "admittance", "wave(b=10)", {"master": "v", "slave": "u"}, ""),
    "wave-integral": (
        "integral_impedance", "integral_admittance", "wave integrals(b=10)",
        {"master": "UE", "slave": "UE"}, "_j",
    ),
}  # fmt: skip


def stiff() -> Document:
    """A hand of 100 N.m/rad and 10 N.m.s/rad, which constant delays do not break."""
    document = _document("10 s")
    document["components"]["master"]["parameters"] |= {"k_p": 100.0, "k_d": 10.0}
    document["require"] = {"near": {"always": "abs(master.q) < 20 rad"}}
    return document


def settling() -> Document:
    """The shipped hand, whose arms meet in 13 s on all constant delays."""
    document = _document("30 s")
    _coarse(document)
    document["require"] = {
        "settled": {"always": "abs(master.q - slave.q) < 0.05 rad", "after": "14 s"}
    }
    return document


def waves(law: str = "wave", offset: float = 3.2) -> Document:
    """A law of :data:`WAVES`, and how far apart (rad) the arms may come to rest."""
    master, slave, preset, sent, suffix = WAVES[law]
    document = _document("30 s")
    _coarse(document)
    for role, kind, inputs in (("master", master, ("dq",)), ("slave", slave, ("q", "dq"))):
        document["components"][f"{role}_control"] = {
            "model": f"fmus.models.wave_{kind}", "preset": preset, "period": "5 ms",
            "inputs": {x: f"{role}.{x}" for x in inputs},
        }  # fmt: skip
    delay, links = document["links"][0]["delay"], []
    for a, b in (("slave", "master"), ("master", "slave")):
        for x in sent[b]:
            ends = {"from": f"{a}_control.{x}", "to": f"{b}_control.{x}{suffix}"}
            links.append({**ends, "delay": delay, "channel": f"{a} to {b}"})
    document["links"] = links
    document["require"] = {
        "offset": {"always": f"abs(master.q - slave.q) <= {offset} rad", "after": "29 s"}
    }
    return document


def _document(stop: str) -> Document:
    document = toml.read(SCENARIO)
    document["run"]["stop"] = stop
    document["metrics"] = {}
    document["figures"] = {}
    return document


def _coarse(document: Document) -> None:
    """Steps of 5 ms, those of the arms in five parts."""
    document["run"]["step"] = "5 ms"
    for role in ("master", "slave"):
        document["components"][role].setdefault("parameters", {})["substeps"] = 5
