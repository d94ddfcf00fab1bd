"""A certificate as a file: what it claims, of which model, and the integers that prove it.

::

    {"format": "cosim certificate 1", "claim": "...", "model": SHA-256 of the cut loop,
     "period": s, "links": [{"name", "size", "least", "greatest", "ordered"}, ...],
     "neutral": matrix, "pivots": [...], "method": "...", its numbers (see the proofs),
     "seal": SHA-256 of all of this}

A matrix is `rows` of integers over the integer `over`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from hashlib import sha256
from pathlib import Path
from typing import Any

from cosim.base.copies import asdict, replace
from cosim.base.errors import ScenarioError
from cosim.base.names import listed
from cosim.certify.checker import lyapunov_holds, small_gain_holds
from cosim.certify.exact import Exact
from cosim.certify.model import CutLoop, LinkBounds, closed_parts, open_parts
from cosim.certify.nominal import Centre
from cosim.certify.peaks import peaks_hold
from cosim.certify.switched import modes

FORMAT = "cosim certificate 1"


@dataclass(frozen=True, slots=True)
class PeakProof:
    """The method "peak gain": see :func:`cosim.certify.peaks.peaks_hold`. `weights` (m, 1)."""

    P: Exact
    rho: Fraction
    weights: Exact

    def holds(self, loop: CutLoop, pivots: Sequence[int]) -> tuple[bool, Fraction]:
        """If it proves stability, and by how much the model was changed. Raises ValueError."""
        parts = open_parts(loop, pivots)
        weights = [self.weights.at(i, 0) for i in range(len(self.weights))]
        return peaks_hold(parts, self.P, self.rho, weights), parts.changed

    def as_data(self) -> dict[str, Any]:
        """Its numbers."""
        rho = list(self.rho.as_integer_ratio())
        return {"P": _plain(self.P), "rho": rho, "weights": _plain(self.weights)}


@dataclass(frozen=True, slots=True)
class GainProof:
    """The method "small gain": see :func:`cosim.certify.checker.small_gain_holds`."""

    P: Exact
    X: tuple[Exact, ...]
    centres: tuple[Centre, ...]

    def holds(self, loop: CutLoop, pivots: Sequence[int]) -> tuple[bool, Fraction]:
        """If it proves stability, and by how much the model was changed. Raises ValueError."""
        parts = closed_parts(loop, pivots)
        return small_gain_holds(parts, self.centres, self.P, self.X), parts.changed

    def as_data(self) -> dict[str, Any]:
        """Its numbers."""
        centres = [asdict(x) for x in self.centres]
        return {"P": _plain(self.P), "X": [_plain(x) for x in self.X], "centres": centres}


@dataclass(frozen=True, slots=True)
class SwitchedProof:
    """The method "lyapunov": see :func:`cosim.certify.checker.lyapunov_holds`.

    `P[of[k]]` belongs to the k-th combination of ages.
    """

    P: tuple[Exact, ...]
    of: tuple[int, ...]

    def holds(self, loop: CutLoop, pivots: Sequence[int]) -> tuple[bool, Fraction]:
        """If it proves stability, and by how much the model was changed. Raises ValueError."""
        parts = closed_parts(loop, pivots)
        chosen = zip(modes(parts.links), self.of, strict=True)
        return lyapunov_holds(parts, {m: self.P[i] for m, i in chosen}), parts.changed

    def as_data(self) -> dict[str, Any]:
        """Its numbers."""
        return {"P": [_plain(x) for x in self.P], "of": list(self.of)}


Proof = PeakProof | GainProof | SwitchedProof
METHODS = {PeakProof: "peak gain", GainProof: "small gain", SwitchedProof: "lyapunov"}


@dataclass(frozen=True, slots=True)
class Certificate:
    """A proof that the loop with the digest `model` is stable, whatever the ages of its links.

    The ages are samples of `period` (s) within `links`, and vary in any way. Stable: every motion
    ends in the span of `neutral`. `pivots`: rows of `neutral` that are the identity.
    """

    model: str
    period: float
    links: tuple[LinkBounds, ...]
    neutral: Exact
    pivots: tuple[int, ...]
    proof: Proof

    @property
    def method(self) -> str:
        """The method of its proof."""
        return METHODS[type(self.proof)]

    @property
    def claim(self) -> str:
        """The claim in words."""
        ages = "; ".join(f"{x.name} {span(x, self.period)}" for x in self.links)
        return (
            "near its operating point the loop is stable for all ages of what its links hold, "
            f"however they vary, within: {ages}"
        )

    def holds(self, loop: CutLoop) -> Fraction:
        """By how much entries of the model were changed, relative. Raises ValueError if it fails.

        `loop` gives the matrices; bounds and neutral directions are those of the certificate.
        """
        if loop.digest != self.model:
            raise ValueError(
                f"it is for the model {self.model[:12]}..., and this model is {loop.digest[:12]}..."
            )
        given = replace(loop, neutral=self.neutral, links=self.links)
        fine, changed = self.proof.holds(given, self.pivots)
        if not fine:
            raise ValueError("its numbers do not prove what it claims")
        return changed

    def as_data(self) -> dict[str, Any]:
        """The content of the file, with its seal."""
        data: dict[str, Any] = {
            "format": FORMAT,
            "claim": self.claim,
            "model": self.model,
            "period": self.period,
            "links": [asdict(x) for x in self.links],
            "neutral": _plain(self.neutral),
            "pivots": list(self.pivots),
            "method": self.method,
            **self.proof.as_data(),
        }
        return {**data, "seal": _seal(data)}

    def text(self) -> str:
        """The file, a line for each key."""
        lines = [f"{json.dumps(k)}: {json.dumps(v)}" for k, v in self.as_data().items()]
        return "{" + ",\n ".join(lines) + "}\n"


def read(path: Path) -> Certificate:
    """The certificate in a file. Raises ScenarioError if it is not one, or was changed."""
    try:
        return certificate(json.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise ScenarioError(f"cannot be read: {error.strerror}", str(path)) from None
    except UnicodeDecodeError:
        reason = "it is not text"
    except json.JSONDecodeError as error:
        reason = f"its JSON ends or is wrong at line {error.lineno}, column {error.colno}"
    except KeyError as error:
        reason = f"it has no key {error}"
    except (TypeError, AttributeError, ArithmeticError):
        reason = "a number, text or list of it is of another kind"
    except ValueError as error:
        reason = str(error)
    raise ScenarioError(
        f"not a certificate: {reason}; expected a file that cosim check --certify wrote", str(path)
    )


def certificate(data: Mapping[str, Any]) -> Certificate:
    """The certificate with this content. Raises ValueError, TypeError or KeyError if it is none."""
    given = {k: v for k, v in data.items() if k != "seal"}
    if given["format"] != FORMAT:
        raise ValueError(f"found the format {given['format']!r}, expected {FORMAT!r}")
    if data["seal"] != _seal(given):
        raise ValueError("its seal does not fit its content, which was changed")
    found = Certificate(
        _text(given["model"]), float(given["period"]), tuple(map(_link, given["links"])),
        _exact(given["neutral"]), tuple(map(_natural, given["pivots"])), _proof(given),
    )  # fmt: skip
    if found.as_data() != data:
        raise ValueError("it contains what no certificate does")
    return found


def _proof(data: Mapping[str, Any]) -> Proof:
    if data["method"] == "peak gain":
        return PeakProof(_exact(data["P"]), Fraction(*data["rho"]), _exact(data["weights"]))
    if data["method"] == "small gain":
        centres = tuple(
            Centre(_natural(x["samples"]), _natural(x["sections"])) for x in data["centres"]
        )
        return GainProof(_exact(data["P"]), tuple(_exact(x) for x in data["X"]), centres)
    if data["method"] != "lyapunov":
        raise ValueError(f"found the method {data['method']!r}, expected one of the three")
    return SwitchedProof(tuple(_exact(x) for x in data["P"]), tuple(map(_natural, data["of"])))


def _link(data: Mapping[str, Any]) -> LinkBounds:
    _text(data["name"])
    for key in ("size", "least", "sends"):
        _natural(data[key])
    if data["greatest"] is not None:
        _natural(data["greatest"])
        if data["greatest"] < data["least"]:
            raise ValueError(f"a link has ages of {data['least']} to {data['greatest']} samples")
    if type(data["ordered"]) is not bool or min(data["size"], data["sends"]) < 1:
        raise ValueError(f"a link is {dict(data)}")
    return LinkBounds(**data)


def _text(value: Any) -> str:
    """The value if it is a text. Raises ValueError."""
    if type(value) is not str:
        raise ValueError(f"found {value!r}, expected a text")
    return value


def _natural(value: Any) -> int:
    """The value if it is an integer of 0 or more, not a float. Raises ValueError."""
    if type(value) is not int or value < 0:
        raise ValueError(f"found {value!r}, expected an integer of 0 or more")
    return value


def verify(found: Certificate, loop: CutLoop) -> Fraction:
    """By how much entries of the model were changed, relative, if the certificate covers `loop`.

    Every age that the links of `loop` may have must be within its bounds. Raises ScenarioError.
    """
    names = [x.name for x in loop.links]
    if [x.name for x in found.links] != names or found.period != loop.period:
        raise ScenarioError(
            f"the certificate is for the links {listed([x.name for x in found.links])} at "
            f"{found.period:g} s, and the scenario has {listed(names)} at {loop.period:g} s"
        )
    for link, covered in zip(loop.links, found.links, strict=True):
        if not link.within(covered):
            raise ScenarioError(
                f"the certificate does not cover links.{link.name}: found {_ages(link)}, "
                f"and it covers {_ages(covered)}; certify this scenario"
            )
    try:
        return found.holds(loop)
    except (ValueError, IndexError) as error:
        reason = "its matrices have other sizes" if isinstance(error, IndexError) else error
        raise ScenarioError(f"the certificate does not hold for this scenario: {reason}") from None


def span(link: LinkBounds, period: float) -> str:
    """The bounds of a link in words, with times in s."""
    sent = period / link.sends
    least, order = link.least * sent, ", in order" if link.ordered else ""
    if link.greatest is None:
        return f"from {least:g} s up to any{order}"
    return f"{least:g} to {link.greatest * sent:g} s{order}"


def _ages(link: LinkBounds) -> str:
    most = "any number of" if link.greatest is None else link.greatest
    return f"ages of {link.least} to {most} samples{' in order' if link.ordered else ''}"


def _plain(matrix: Exact) -> dict[str, Any]:
    return {"over": matrix.over, "width": matrix.width, "rows": [list(r) for r in matrix.rows]}


def _exact(data: Mapping[str, Any]) -> Exact:
    rows: Sequence[Sequence[int]] = data["rows"]
    numbers = [data["over"], data["width"], *(x for row in rows for x in row)]
    if not all(type(x) is int for x in numbers) or data["over"] <= 0:
        raise ValueError("a matrix is not one of integers over a positive integer")
    if any(len(row) != data["width"] for row in rows):
        raise ValueError("the rows of a matrix differ in length")
    return Exact(tuple(map(tuple, rows)), data["over"], data["width"])


def _seal(data: Mapping[str, Any]) -> str:
    return sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
