"""Attacks on certified loops: constant, periodic and random ages, waves, and a greedy adversary.

What is certified is broken by none; what a wrong proof certifies is broken by some.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import pytest

from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.certify import certificate, checker, lyapunov, nominal, search
from cosim.certify.certificate import Certificate, verify
from cosim.certify.model import CutLoop, LinkBounds, OpenParts
from cosim.certify.peaks import peaks_hold
from cosim.certify.search import certify
from cosim.certify.switched import Ages, modes
from cosim.certify.witness import adversary
from tests.cosim.certify.loops import cut, growth, integrator

pytest.importorskip("clarabel")
pytest.importorskip("scipy")

#: The greatest age of an attack on what is certified for all ages.
FAR = 9
#: Growth per step that is not a rounding error.
GROWS = 1.0 + 1e-9


def random_loops(count: int) -> Iterator[CutLoop]:
    rng = np.random.default_rng(7)
    for _ in range(count):
        n, m = int(rng.integers(1, 5)), int(rng.integers(1, 3))
        A = rng.normal(size=(n, n))
        A *= rng.uniform(0.3, 0.98) / np.abs(np.linalg.eigvals(A)).max()
        B, C = rng.normal(size=(n, m)), rng.normal(size=(m, n))
        B *= (
            rng.uniform(0.3, 4.0) * (1 - np.abs(np.linalg.eigvals(A)).max()) / np.linalg.norm(B @ C)
        )
        links = []
        for i in range(m):
            least = int(rng.integers(0, 3))
            ordered = bool(rng.integers(2))
            links.append(LinkBounds(f"{i}", 1, least, least + int(rng.integers(0, 3)), ordered))
        yield cut(A, B, C, links)


def random_ages(loop: CutLoop, rng: np.random.Generator) -> list[list[int]]:
    """A period of up to eight steps."""
    every = list(product(*(range(x.least, x.most + 1) for x in loop.links)))
    return [list(every[i]) for i in rng.integers(len(every), size=int(rng.integers(2, 9)))]


def square(loop: CutLoop, rng: np.random.Generator) -> list[list[int]]:
    """The least and the greatest age in turn, each for some steps; each link from another step."""
    high, low = (int(x) for x in rng.integers(1, 12, size=2))
    shifts = rng.integers(high + low, size=len(loop.links))
    return [
        [x.most if (k + s) % (high + low) < high else x.least
         for x, s in zip(loop.links, shifts, strict=True)]
        for k in range(high + low)
    ]  # fmt: skip


def sawtooth(loop: CutLoop, rng: np.random.Generator) -> list[list[int]]:
    """A sample is held for some steps; then a new one, or, with `turn`, from old to new."""
    turn = bool(rng.integers(2))
    teeth = [int(rng.integers(x.least, x.most + 1)) for x in loop.links]  # where a tooth begins
    length = max(x.most - t + 1 for x, t in zip(loop.links, teeth, strict=True))
    shifts = rng.integers(length, size=len(loop.links))
    found = []
    for k in range(length):
        at = [(k + int(s)) % length for s in shifts]
        found.append([min(t + a, x.most) for x, t, a in zip(loop.links, teeth, at, strict=True)])
    return found[::-1] if turn else found


ATTACKS: dict[str, Callable[[CutLoop, np.random.Generator], list[list[int]]]] = {
    "random": random_ages, "square": square, "sawtooth": sawtooth,
}  # fmt: skip


def in_order(loop: CutLoop, ages: list[list[int]]) -> list[list[int]]:
    """The nearest cycle that keeps the order, of the links that do."""
    for i, link in enumerate(loop.links):
        if link.ordered:
            for k in [*range(len(ages)), *range(len(ages))]:
                ages[k][i] = min(ages[k][i], ages[k - 1][i] + 1)
    return ages


def broken_by(loop: CutLoop, cycles: int) -> list[str]:
    """The attacks with which a motion grows; `cycles` of them are cycles of ages."""
    rng = np.random.default_rng(1)
    every = product(*(range(x.least, x.most + 1) for x in loop.links))
    found = ["constant"] if any(growth(loop, [ages]) > GROWS for ages in every) else []
    for name, attack in ATTACKS.items():
        some = (in_order(loop, attack(loop, rng)) for _ in range(cycles // len(ATTACKS)))
        if any(growth(loop, ages) > GROWS for ages in some):
            found.append(name)
    return [*found, "greedy"] if adversary(loop, 600) is not None else found


def claimed(loop: CutLoop, found: Certificate) -> CutLoop:
    """The loop with the ages of its certificate, up to FAR where it is for all."""
    links = (replace(x, greatest=FAR) if x.greatest is None else x for x in found.links)
    return replace(loop, links=tuple(links))


def widened(loop: CutLoop, found: Certificate) -> tuple[CutLoop, Certificate]:
    """Two samples more than was proven."""
    links = tuple(replace(x, greatest=x.most + 2) for x in found.links)
    return replace(loop, links=links), replace(found, links=links)


def no_counterexample(count: int, cycles: int) -> dict[str, int]:
    """Attack certified loops. Counts of them, of attacks on the others, and of wider claims."""
    counts = dict.fromkeys(("certified", "constant", *ATTACKS, "greedy", "refused", "wider"), 0)
    for loop in random_loops(count):
        found = certify(loop)
        if found is None:
            for name in broken_by(loop, cycles):
                counts[name] += 1
            continue
        counts["certified"] += 1
        verify(found, loop)
        assert broken_by(claimed(loop, found), cycles) == [], loop
        if found.method == "peak gain":
            continue
        wide, wider = widened(loop, found)
        try:
            verify(wider, wide)
        except ScenarioError:
            counts["refused"] += 1
        else:
            counts["wider"] += 1
            assert broken_by(wide, cycles) == [], wide
    return counts


def test_no_attack_breaks_a_certified_loop() -> None:
    assert no_counterexample(16, 12)["certified"] > 5


@pytest.mark.slow
def test_no_attack_breaks_two_hundred_certified_loops() -> None:
    counts = no_counterexample(200, 300)
    assert counts["certified"] > 100 and counts["refused"] > 20 and counts["wider"] < 5, counts
    assert all(counts[name] > 80 for name in ("constant", *ATTACKS, "greedy")), counts


# ---- wrong proofs -------------------------------------------------------------------------------


def two_samples_less(patch: pytest.MonkeyPatch) -> CutLoop:
    """The gain of an age is taken for one of two samples less."""
    right = nominal.squared_gamma

    def wrong(link: LinkBounds, c: int) -> Fraction:
        return right(replace(link, greatest=link.most - 2), c)

    patch.setattr(nominal, "squared_gamma", wrong)
    return integrator(0.36, 4)


def two_ages_less(patch: pytest.MonkeyPatch) -> CutLoop:
    """The two greatest ages have no matrix."""

    def wrong(links: Any) -> list[Ages]:
        return [m for m in modes(links) if max(m) < max(x.most for x in links) - 1]

    for module in (certificate, checker, lyapunov, search):
        patch.setattr(module, "modes", wrong)
    d = 6
    return integrator(1.15 * (1.5 + 0.5 / (d + 1)) / (d + 1), d)


def a_tenth_less(patch: pytest.MonkeyPatch) -> CutLoop:
    """Impulse responses are taken for smaller ones; the gain at rest is 1.03."""

    def wrong(parts: OpenParts, *given: Any) -> bool:
        return peaks_hold(replace(parts, B=parts.B.times(Fraction(9, 10))), *given)

    patch.setattr(search, "peaks_hold", wrong)
    patch.setattr(certificate, "peaks_hold", wrong)
    patch.setattr("cosim.certify.peak_gain._ROOM", -0.05)
    links = [LinkBounds("there", 1, 0, 4), LinkBounds("back", 1, 0, 4)]
    return cut(np.diag([0.9, 0.9]), np.diag([0.1, 0.103]), [[0, 1], [1, 0]], links)


@pytest.mark.parametrize("mutant", [two_samples_less, two_ages_less, a_tenth_less])
def test_attacks_break_what_a_wrong_proof_certifies(
    mutant: Callable[[pytest.MonkeyPatch], CutLoop], monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = mutant(monkeypatch)
    wrong = certify(loop)
    assert wrong is not None
    verify(wrong, loop)
    assert "greedy" in broken_by(claimed(loop, wrong), 60)
    monkeypatch.undo()
    assert certify(loop) is None
    with pytest.raises(ScenarioError):
        verify(wrong, loop)
