"""The search for a certificate: methods that take little time first, the exact check last."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from cosim.base.copies import replace
from cosim.base.extras import require
from cosim.certify import lyapunov, peak_gain, small_gain
from cosim.certify.certificate import (
    Certificate,
    GainProof,
    PeakProof,
    Proof,
    SwitchedProof,
)
from cosim.certify.checker import lyapunov_holds, small_gain_holds
from cosim.certify.exact import Exact
from cosim.certify.inequalities import Matrix
from cosim.certify.model import ClosedParts, CutLoop, LinkBounds, closed_parts, open_parts
from cosim.certify.nominal import Centre, nominal, squared_gain
from cosim.certify.peaks import peaks_hold
from cosim.certify.switched import modes

#: States of the loop with the filters of its links, at most: the exact check takes seconds.
LARGEST = 90
#: Sections of the filter of a link that are tried.
_SECTIONS = (4, 8, 16)
#: Bits of the numbers of a certificate; rounding is repeated with more if that is too few.
_BITS = 32
#: Neutral directions and their parts below this are rounding errors.
_SMALL = 1e-11


def certify(loop: CutLoop, *, peaks: bool = True) -> Certificate | None:
    """A certificate for the bounds of the links of `loop`, or None if none was found.

    By peak gains, if `peaks`, it is for all ages, whatever the bounds. Raises ScenarioError without
    the solver (the extra `certify`), ValueError for a loop that cannot be certified.
    """
    require("clarabel")
    neutral, pivots = echelon(np.array(loop.neutral.floats()).reshape(len(loop.A), -1))
    loop = replace(loop, neutral=Exact.of(neutral.tolist(), neutral.shape[1]))
    every = tuple(LinkBounds(x.name, x.size, 0, None, sends=x.sends) for x in loop.links)
    given = loop.digest, loop.period
    proof: Proof
    for proof in _by_peaks(loop, pivots) if peaks else ():
        return Certificate(*given, every, loop.neutral, pivots, proof)
    if any(x.greatest is None for x in loop.links):
        return None
    parts = closed_parts(loop, pivots)
    for method in (_by_gain, _by_lyapunov):
        for proof in method(parts):
            return Certificate(*given, loop.links, loop.neutral, pivots, proof)
    return None


def echelon(X: Matrix) -> tuple[Matrix, tuple[int, ...]]:
    """The span of X (n, k) with the identity at some rows, the pivots, and these.

    In the units of the states.

    Raises ValueError if the columns of X are not independent.
    """
    found, pivots = X.copy(), list[int]()
    for k in range(X.shape[1]):
        row = int(np.abs(found[:, k]).argmax())
        if abs(found[row, k]) < _SMALL:
            raise ValueError("neutral directions are not independent")
        found[:, k] /= found[row, k]
        for j in range(X.shape[1]):
            if j != k:
                found[:, j] -= found[row, j] * found[:, k]
        pivots.append(row)
    found[np.abs(found) < _SMALL] = 0.0
    found[pivots] = np.eye(X.shape[1])
    return found, tuple(pivots)


def _by_peaks(loop: CutLoop, pivots: Sequence[int]) -> Iterator[PeakProof]:
    try:
        parts = open_parts(loop, pivots)
    except ValueError:  # robots that agree on any place: their gain is 1
        return
    for P, rho, weights in peak_gain.candidates(parts):
        proof = PeakProof(_exact(P), rho, Exact.of([[w] for w in weights], 1))
        if peaks_hold(parts, proof.P, rho, weights):
            yield proof


def _by_gain(parts: ClosedParts) -> Iterator[GainProof]:
    for centres in _centres(parts):
        squared = [float(squared_gain(x, c)) for x, c in zip(parts.links, centres, strict=True)]
        for P, X in small_gain.candidates(nominal(parts, centres), squared):
            proof = GainProof(_exact(P), tuple(map(_exact, X)), tuple(centres))
            if small_gain_holds(parts, centres, proof.P, proof.X):
                yield proof


def _by_lyapunov(parts: ClosedParts) -> Iterator[SwitchedProof]:
    every = modes(parts.links) if lyapunov.few(parts) else []
    for P in lyapunov.candidates(parts):
        known = list({id(x): x for x in P.values()}.values())
        exact = [_exact(x) for x in known]
        index = {id(x): i for i, x in enumerate(known)}
        of = tuple(index[id(P[m])] for m in every)
        if lyapunov_holds(parts, {m: exact[i] for m, i in zip(every, of, strict=True)}):
            yield SwitchedProof(tuple(exact), of)


def _centres(parts: ClosedParts) -> Iterator[Sequence[Centre]]:
    """Centres of all links: none, least ages, middles; with filters from small to large."""
    seen = set[tuple[Centre, ...]]()
    for place in (_none, _least, _middle):
        samples = [place(x) for x in parts.links]
        for sections in (*_SECTIONS, max(samples, default=0)):
            found = tuple(Centre(c, min(c, sections)) for c in samples)
            late = sum(c.sections * x.size for c, x in zip(found, parts.links, strict=True))
            if found not in seen and len(parts.A) + late - len(parts.pivots) <= LARGEST:
                seen.add(found)
                yield found


def _none(link: LinkBounds) -> int:
    return 0


def _least(link: LinkBounds) -> int:
    return link.least // link.sends


def _middle(link: LinkBounds) -> int:
    return (link.least + link.most) // (2 * link.sends)


def _exact(matrix: Matrix) -> Exact:
    """The matrix, symmetric, with short numbers: a change that is small beside its diagonal."""
    half = np.exp2(np.round(np.log2(np.abs(np.diag(matrix)) + 1e-300) / 2) - _BITS / 2)
    unit = np.outer(half, half)
    found = np.round((matrix + matrix.T) / 2 / unit) * unit
    return Exact.of(found.tolist(), matrix.shape[1]).lowest()
