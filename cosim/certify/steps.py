"""The way from a scenario to a certificate, or its verification, with the result as text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from math import isfinite
from pathlib import Path

from cosim.base.errors import ScenarioError
from cosim.base.extras import require
from cosim.base.files import write_file
from cosim.base.names import listed
from cosim.certify.certificate import Certificate, read, span, verify
from cosim.certify.model import CutLoop, LinkBounds
from cosim.certify.scenario import cut_loop
from cosim.certify.search import certify
from cosim.certify.theorem import theorem
from cosim.certify.witness import adversary
from cosim.linear.opened import OpenLoop
from cosim.record.folder import held_folder
from cosim.scenario.spec import Scenario

#: The file of a certificate in its folder.
FILE = "certificate.json"
#: Change of a state a second, in its unit, from which a loop is not at rest.
_MOVES = 1e-3


def verified(scenario: Scenario, certificate: Path) -> list[str]:
    """Verify the certificate of a scenario. Raises ScenarioError for one that does not hold."""
    found, (loop, opened) = read(certificate), cut_loop(scenario)
    return [*_claim(found, verify(found, loop), loop), *_moves(opened)]


def certified(scenario: Scenario, delays: str, folder: Path) -> tuple[bool, list[str]]:
    """Certify a scenario and write the proof into `folder`; True: there is one.

    `delays`: "LOW,HIGH", the ages of what all links hold (s), or "", those that the links allow.
    Raises ScenarioError for a scenario that cannot be certified.
    """
    require("clarabel")
    loop, opened = cut_loop(scenario, _delays(delays))
    try:
        proof = certify(loop)
    except ValueError as error:
        found = f"the linear loop at t = {opened.time:g} s cannot be certified: {error}"
        raise ScenarioError("; ".join([found, *_moves(opened)])) from None
    if proof is None:
        return False, [*_unproven(loop, scenario), *_moves(opened)]
    changed = verify(proof, loop)
    with held_folder(folder):
        write_file(folder / FILE, proof.text())
    return True, [*_claim(proof, changed, loop), *_moves(opened), f"{'proof':<12} {folder / FILE}"]


def _delays(text: str) -> tuple[float, float] | None:
    """Two times of one option, s. Raises ScenarioError."""
    if not text:
        return None
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        low = high = -1.0
    if not (0.0 <= low <= high and isfinite(high)):
        raise ScenarioError(f"--delays {text}: expected LOW,HIGH in s, such as 0.1,0.5")
    return low, high


def _claim(found: Certificate, changed: Fraction, loop: CutLoop) -> Iterator[str]:
    yield "certified: the linear loop is stable for all delays, however they vary"
    yield from _links(found.links, found.period)
    yield f"{'method':<12} {found.method}, checked in integers"
    if found.pivots:
        names = sorted({loop.states[i].partition("[")[0] for i in found.pivots})
        yield f"{'apart from':<12} {listed(names)}: any value is an equilibrium"
        yield f"{'model':<12} changed by {float(changed):.1g} of its greatest entry for that"
    yield f"{'not covered':<12} large motions: this is the linear loop at the end of the run"


def _unproven(loop: CutLoop, scenario: Scenario) -> Iterator[str]:
    bounded = all(x.greatest is not None for x in loop.links)
    if bounded and adversary(loop) is not None:
        yield "broken: some delays within these bounds make a motion of the linear loop grow"
    else:
        yield "unknown: no certificate was found, which does not mean that the loop is unstable"
    yield from _links(loop.links, loop.period)
    if said := theorem(scenario):
        yield f"{'theorem':<12} {said}"
    if bounded:
        yield "    -> shorter delays, --delays LOW,HIGH, or semantics that keep the order"
    else:
        yield "    -> ages without a bound need a loop of small gain; try --delays LOW,HIGH"


def _moves(opened: OpenLoop) -> Iterator[str]:
    if opened.speed > _MOVES:
        yield (
            f"{'not at rest':<12} at t = {opened.time:g} s states still change by up to "
            f"{opened.speed:.2g} of their units a second; set run.stop to a later time"
        )


def _links(links: Sequence[LinkBounds], period: float) -> Iterator[str]:
    """A line for all links with the same bounds."""
    alike: dict[str, list[str]] = {}
    for link in links:
        alike.setdefault(span(link, period), []).append(link.name)
    for text, names in alike.items():
        yield f"{'ages':<12} {text}: {listed(names)}"
