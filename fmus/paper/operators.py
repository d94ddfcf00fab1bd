"""Changes to an experiment: a hand as a separate component, more signals, a fixed graph."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fmus.paper.experiments import Document

#: The component that such a hand is, and what it is recorded as.
HAND = "hand"
FORCE = f"{HAND}.tau_h"


def decaying(document: Document, arm: str, tau_0: Sequence[float]) -> Document:
    """The document with the hand tau_0/(t + 1) of Remark 5 on `arm`; `tau_0` (2,), N.m."""
    return held_by(document, arm, {"model": "fmus.models.decaying_push", "start": {"tau_0": tau_0}})


def pushing(document: Document, arm: str, tau_p: Sequence[float], until: float) -> Document:
    """The document with a push on `arm` from t = 0 to `until` (s); `tau_p` (2,), N.m."""
    values = {"tau_p": tau_p, "t_1": until}
    return held_by(document, arm, {"model": "fmus.models.push", "start": values})


def held_by(document: Document, arm: str, hand: Document) -> Document:
    """The document with the component `hand`, of output `tau_h`, wired to `arm` and recorded."""
    components: dict[str, Any] = dict(document["components"])
    robot = components[arm]
    start = {key: value for key, value in robot["start"].items() if key != "tau_ext"}
    inputs = {**robot["inputs"], "tau_ext": FORCE}
    components[arm] = {**robot, "start": start, "inputs": inputs}
    components[HAND] = {"period": robot["period"], **hand}
    return recording({**document, "components": components}, FORCE)


def recording(document: Document, *names: str) -> Document:
    """The document with further signals in the record."""
    run = document["run"]
    signals = sorted({*run["record"]["signals"], *names})
    return {**document, "run": {**run, "record": {**run["record"], "signals": signals}}}


def on_mean_graph(document: Document) -> Document:
    """The network with all edges of all its graphs for ever: no topology, every weight is 1.

    With `lambda` = 1/3 this is the mean of the three graphs of `ring`.
    """
    return {key: value for key, value in document.items() if key != "topology"}
