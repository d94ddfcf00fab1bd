"""Subjects of the analysis: the paper's experiments as documents, at 5 ms, and small ones."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

from cosim.analysis.analysis import Analysis, analyse
from cosim.analysis.analyzed_port import Subject, find_port, record
from cosim.analysis.experiments import Bench
from cosim.analysis.quantity import Quantity
from cosim.predict.network import RobotNetwork, network
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from fmus.paper.experiments import single, teleoperator

Document = dict[str, Any]

CONSTANT = {"delay": {"law": "constant", "delay": 0.75}}

#: Documents by name; the numbers of each are in reading order of the paper's gains.
DOCUMENTS: dict[str, Document] = {
    "single-6": single(),
    "single-2": single(lambda_M=2.0),
    "single-0": single(lambda_M=0.0),
    "velocity": single(alpha=0.0) | {"analysis": {"response": "robot.dq"}},
    "no-alpha": single(alpha=0.0),
    "pair-10": teleoperator(link=CONSTANT),
    "pair-1": teleoperator(link=CONSTANT, lambda_M=1.0),
    "pair-10-wire": teleoperator(link={}),
    "pair-10-jitter": teleoperator(),
}


def pointmass(b: float) -> Document:
    """A point mass that a component pushes: nothing is known of it but its signals."""
    return {
        "run": {"step": 0.01, "stop": 5.0},
        "components": {
            "push": {"model": "fmus.models.push", "parameters": {"f_p": 2.0}},
            "mass": {
                "model": "fmus.models.pointmass",
                "parameters": {"m": 1.5, "b": b},
                "inputs": {"f": "push.f"},
            },
        },
        "analysis": {
            "force": "push.f",
            "response": "mass.x",
            "rate": "mass.dx",
            "inject": "mass.f",
        },
    }


def subject(document: Document, port: str = "") -> Subject:
    """A document, run in memory."""
    scenario = build(document, Path("test.toml"))
    plan = assemble(scenario)
    known, place = find_port(scenario, plan, port)
    return Subject(scenario.title, record(scenario, plan, place), place, known)


def net_of(document: Document, port: str = "") -> RobotNetwork:
    """The network at the port that is held, or chosen."""
    scenario = build(document, Path("test.toml"))
    known, place = find_port(scenario, assemble(scenario), port)
    found = network(known, place.arm)
    assert found is not None
    return found


def bench(document: Document, q: tuple[float, ...] = (0.3, 0.2), known: bool = False) -> Bench:
    """The port of a document on the bench."""
    scenario = build(document, Path("test.toml"))
    system, port = find_port(scenario, assemble(scenario))
    return Bench(system, port, q, known)


@lru_cache(maxsize=16)
def analysed(name: str) -> Analysis:
    """The whole analysis of a document, once."""
    return analyse(subject(DOCUMENTS[name]))


def number(found: Analysis, name: str) -> Quantity:
    """The quantity of a name."""
    (one,) = [q for q in found.quantities if q.name == name]
    return one
