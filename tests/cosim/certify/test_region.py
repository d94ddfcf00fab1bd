"""The region over the bounds of the delays, against certificates and closed conditions."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.certify import region as certified
from cosim.certify.model import CutLoop, LinkBounds
from cosim.certify.page import Mark, drawing, failure, said, write
from cosim.certify.region import Region
from cosim.certify.witness import adversary
from tests.cli.command import CONFIG
from tests.cosim.certify.loops import both, cut, exact, growth, integrator, masses

REGION = Region((0, 2, 4, 6), 0.5, (1, 2, -1, -1), (False, False, False, True), frozenset({(0, 2)}))


def test_intervals_have_one_of_three_states() -> None:
    """Certified up to the greatest, broken if a witness is within, else unknown."""
    states = {(i, j): REGION.state(i, j) for i in range(4) for j in range(i, 4)}
    assert {k for k, s in states.items() if s == "certified"} == {(0, 0), (0, 1), (1, 1), (1, 2)}
    assert {k for k, s in states.items() if s == "unknown"} == {(2, 2)}


def test_the_region_in_words() -> None:
    expected = "certified from 0 s up to 1 s; broken by a constant delay of 3 s and by an adversary"
    assert said(REGION) == f"{expected} up to 2 s"
    nothing = Region((0, 2), 0.5, (-1, -1), (False, False), frozenset())
    assert said(nothing) == "nothing is certified from 0 s on; not broken"


def test_the_map_has_a_cell_for_each_interval(tmp_path: Path) -> None:
    mark, far = Mark("○", "the links", 0.5, 1.5), Mark("×", "beyond", 0.0, 9.0)
    svg = drawing(REGION, [mark, far])
    assert svg.count("<rect") == 10 and "0 to 1 s: certified" in svg
    assert "the links" in svg and "beyond" not in svg
    (hatched,) = re.findall(r'<path d="([^"]+)"', svg)
    assert hatched.count("M") == 3 * svg.count("s: broken")
    colours = set(re.findall(r'fill="(#\w+)"', svg))
    text = write(REGION, "A pair", [mark], tmp_path).read_text(encoding="utf-8")
    assert len(colours) == 3 and all(c in text for c in colours) and "A pair" in text


@pytest.mark.parametrize("d", [3, 6])
def test_an_adversary_finds_what_no_constant_delay_does(d: int) -> None:
    """Above the law of three halves, below the limit 2 sin(pi/(4 d + 2)) of a constant delay."""
    law = (1.5 + 0.5 / (d + 1)) / (d + 1)
    constant = 2.0 * np.sin(np.pi / (2 * (2 * d + 1)))
    assert 1.06 * law < constant
    found = adversary(integrator(1.06 * law, d))
    assert found is not None and found.min() >= 0 and found.max() <= d
    assert adversary(integrator(0.97 * law, d)) is None


def test_an_adversary_drives_the_slowest_mode() -> None:
    """x+ = -0.775 x - 0.264 x[k - age] alternates: its mode tells that an age of 2 drives it."""
    loop = cut([[-0.775]], [[-0.264]], [[1.0]], [LinkBounds("link", 1, 2, 3)])
    found = adversary(loop)
    assert found is not None and (found[-100:] == 2).all() and growth(loop, [[2]]) > 1.0


def test_an_adversary_keeps_to_the_order() -> None:
    loop = masses(0.05, both(0, 9, ordered=True))
    found = adversary(loop)
    assert found is not None and (np.diff(found, axis=0) <= 1).all()
    assert growth(loop, found[-300:].tolist()) > 1.0
    assert adversary(masses(0.05, both(0, 5))) is None


def test_an_adversary_of_receivers_that_look_at_some_samples() -> None:
    """The same loop of one sample a period, and of two: ages in halves of a period."""
    plain = integrator(1.0, 3)
    twice = replace(
        plain, C=exact([[1.0], [1.0]]), D=exact([[0.0], [-0.5]]),
        links=(LinkBounds("link", 1, 0, 6, sends=2),),
    )  # fmt: skip
    for loop, most in ((plain, 3), (twice, 6)):
        found = adversary(loop)
        assert found is not None and found.max() == most
    assert adversary(replace(twice, links=(LinkBounds("link", 1, 0, 1, sends=2),))) is None


def test_the_least_intervals_that_an_adversary_breaks_are_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An adversary that needs 3 samples between the ends, and a constant delay of 8 that is bad."""
    asked = []

    def grows(loop: CutLoop) -> object:
        asked.append((loop.links[0].least, loop.links[0].most))
        return 1 if loop.links[0].most - loop.links[0].least >= 3 else None

    monkeypatch.setattr(certified, "adversary", grows)
    plain = Region(tuple(range(9)), 1.0, (1,) * 9, (False,) * 8 + (True,), frozenset())
    loop = integrator(0.1, 8)
    found = set(certified._grown(loop, plain, lambda text: None))
    assert found == {(i, i + 3) for i in range(5)} and len(asked) < 2 * 9
    monkeypatch.setattr(certified, "adversary", lambda loop: None)
    quiet = replace(plain, unstable=(False,) * 9)
    assert not set(certified._grown(loop, quiet, lambda text: None))


def test_a_failure_of_the_search_is_a_mark(tmp_path: Path) -> None:
    law = """{ law = "segments", delay = "750 ms", segments = [
        { from = "0.2 s", to = "0.3 s", delay = "1.2 s" }] }"""
    uniform = re.compile(r"{ law = .*}")
    text = uniform.sub(law.replace("\n", " "), CONFIG.read_text(encoding="utf-8"))
    (tmp_path / "failing.toml").write_text(text, encoding="utf-8")
    found = failure(tmp_path)
    assert (found.least, found.greatest) == (0.75, 1.2)
    with pytest.raises(ScenarioError, match="no failing"):
        failure(tmp_path / "none")
