"""All cases and claims of the reproduction, section by section, and how a part of it is chosen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cosim.base.errors import ScenarioError
from fmus.paper import (
    equations,
    gains,
    lemmas,
    network,
    remarks,
    robustness,
    sampling,
    teaching,
    teleoperation,
    theory,
    upright,
)
from fmus.paper.claim import Claim
from fmus.paper.experiments import Document
from fmus.paper.figures import FIGURES, PaperFigure

#: The claims by section of the paper, in its order.
SECTIONS: Mapping[str, tuple[Claim, ...]] = {
    "Lemmas 1 to 3, friction that varies, degrees: Sec. II-B, III": lemmas.CLAIMS,
    "Point mass, damping, gravity: Sec. III, IV, Theorem 1, Remark 3": theory.CLAIMS,
    "The equations at every sample, Theorem 2 in numbers": (*equations.CLAIMS, *gains.CLAIMS),
    "Teaching a single robot: Sec. IV-B, VII-A, Figs 1-3, Theorem 2": teaching.CLAIMS,
    "Six networked robots: Sec. V, VII-B, Figs 6-11, Theorems 3 and 4": network.CLAIMS,
    "Bilateral teleoperation: Sec. VI, VII-C, Figs 12-15, Theorem 5": teleoperation.CLAIMS,
    "Remarks 5 and 6, Sec. VIII: hands of finite effort, delays of any bound": remarks.CLAIMS,
    "Gravity in Y, adapted from 0: Theorems 2, 3 and 5": upright.CLAIMS,
    "Beyond the paper: sampled time, passivity, stiff grips": (
        *sampling.CLAIMS,
        *robustness.CLAIMS,
    ),
}
#: Figures without a run: the interaction graphs.
GRAPHS = {"fig4", "fig5"}


def cases(seed: int) -> dict[str, Document]:
    """Every case by name, as a scenario document; `seed` of delays and switching graphs."""
    parts = (
        lemmas,
        theory,
        equations,
        gains,
        teaching,
        network,
        teleoperation,
        remarks,
        upright,
        sampling,
        robustness,
    )
    return {name: document for part in parts for name, document in part.cases(seed).items()}


@dataclass(frozen=True, slots=True)
class ClaimSelection:
    """The selection to be reproduced: claims by section, figures, whether the graphs are drawn."""

    sections: Mapping[str, tuple[Claim, ...]]
    figures: tuple[PaperFigure, ...]
    graphs: bool

    @property
    def claims(self) -> tuple[Claim, ...]:
        """The claims of all sections."""
        return tuple(claim for claims in self.sections.values() for claim in claims)

    @property
    def cases(self) -> frozenset[str]:
        """Names of the cases that claims and figures need."""
        needed = {case for claim in self.claims for case in claim.cases}
        return frozenset(needed | {figure.case for figure in self.figures})


def select(wanted: Sequence[str] = ()) -> ClaimSelection:
    """The claims and figures about `wanted`: ``6`` is ``fig6``; ``thm2``, ``o5``, ``robust``, or a
    claim's name.

    All claims if `wanted` is empty. Raises ScenarioError for a topic without claims.
    """
    keys = {_key(text) for text in wanted}
    unknown = sorted(keys - topics() - {c.name for part in SECTIONS.values() for c in part})
    if unknown:
        known = ", ".join(sorted(topics(), key=_order))
        raise ScenarioError(f"no claim is about {unknown[0]!r}; the topics are {known}", "--only")
    chosen = {
        title: tuple(c for c in claims if not keys or keys & {*c.about, c.name})
        for title, claims in SECTIONS.items()
    }
    figures = tuple(f for f in FIGURES if not keys or f"fig{f.number}" in keys)
    sections = {title: claims for title, claims in chosen.items() if claims}
    return ClaimSelection(sections, figures, not keys or bool(keys & GRAPHS))


def topics() -> set[str]:
    """The topics of claims or figures."""
    about = {topic for claims in SECTIONS.values() for c in claims for topic in c.about}
    return about | {f"fig{figure.number}" for figure in FIGURES} | GRAPHS


def _key(text: str) -> str:
    key = text.strip().lower()
    return f"fig{key}" if key.isdigit() else key


def _order(topic: str) -> tuple[str, int]:
    head = topic.rstrip("0123456789")
    return head, int(topic[len(head) :] or 0)
