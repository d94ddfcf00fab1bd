"""Certificates against closed conditions, an adversary, and changes of their files."""

from __future__ import annotations

import json
from collections.abc import Iterator
from fractions import Fraction
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.certify.certificate import Certificate, certificate, read, verify
from cosim.certify.model import CutLoop, LinkBounds
from cosim.certify.search import certify
from tests.cosim.certify.loops import both, cut, exact, growth, integrator, masses

pytest.importorskip("clarabel")
pytest.importorskip("scipy")


@pytest.mark.parametrize("d", [1, 2])
def test_an_integrator_up_to_the_law_of_three_halves(d: int) -> None:
    """Stable for g (d + 1) < 3/2 + 1/(2 (d + 1)), and not always above (Erbe, Xia and Yu 1995)."""
    limit = (1.5 + 0.5 / (d + 1)) / (d + 1)
    found = certify(integrator(0.99 * limit, d))
    assert found is not None and found.method == "lyapunov"
    assert verify(found, integrator(0.99 * limit, d)) == 0
    # beyond the limit of a constant delay there is nothing to find
    constant = 2.0 * np.sin(np.pi / (2 * (2 * d + 1)))
    assert growth(integrator(1.01 * constant, d), [[d]]) > 1.0
    assert certify(integrator(1.01 * constant, d)) is None


def closed_condition(there: float, back: float, K: float = 10.0, B: float = 3.0) -> bool:
    """4 B_l B_r > (T_l + T_r)^2 K_l K_r, with delays up to T that may vary, in continuous time.

    P+d of E. Nuño, L. Basañez, R. Ortega and M. W. Spong (2009).
    """
    return (there + back) ** 2 * K * K < 4.0 * B * B


@pytest.mark.parametrize("period", [0.001, 0.005, 0.01])
def test_coupled_masses_up_to_the_closed_condition(period: float) -> None:
    """Two samples below the limit; one sample, in order (not at 1 ms); nothing far above it."""
    limit = next(d for d in range(1000) if not closed_condition(d * period, d * period))
    assert limit == round(0.3 / period)
    found = certify(masses(period, both(0, limit - 2)))
    assert found is not None and found.method == "small gain"
    assert verify(found, masses(period, both(0, limit - 2))) < Fraction(1, 10**12)
    if period > 0.001:
        assert certify(masses(period, both(0, limit - 1, ordered=True))) is not None
        assert certify(masses(period, both(0, 2 * limit))) is None


@pytest.mark.parametrize("there", [0.4, 0.5, 0.55])
def test_the_sum_of_both_delays_counts(there: float) -> None:
    """98 % of the greatest delay the one way, for one of 0.6 s less that the other way."""
    back, h = 0.6 - there, 0.005
    assert closed_condition(0.999 * there, back) and not closed_condition(1.001 * there, back)
    ages = [int(0.98 * delay / h + 1e-9) for delay in (there, back)]
    links = [LinkBounds(name, 1, 0, n) for name, n in zip(("there", "back"), ages, strict=True)]
    assert certify(masses(h, links)) is not None


def test_ages_that_do_not_vary() -> None:
    """No delay at all, and one of 20 samples."""
    for age in (0, 20):
        found = certify(masses(0.01, both(age, age)))
        assert found is not None and found.method == "small gain"


def test_a_long_delay_takes_few_states() -> None:
    """Ages of 100 to 104 samples: a filter of a few sections stands for the delay."""
    heavy = masses(0.005, both(100, 104), spring=4.0, damping=4.0)
    found = certify(heavy)
    assert found is not None
    assert verify(found, heavy) < Fraction(1, 10**12)


@pytest.mark.parametrize("gain", [0.97, 1.03])
def test_peak_gains_of_two_lags(gain: float) -> None:
    """y+ = a y + b u has the peak gain b/(1 - a): stable for all ages if the product is below 1."""
    a, b = [0.9, 0.99], [0.2, 0.01 * gain / 2.0]
    links = [LinkBounds("there", 1, 0, None), LinkBounds("back", 1, 0, None)]
    loop = cut(np.diag(a), np.diag(b), [[0, 1], [1, 0]], links)
    found = certify(loop)
    assert (found is not None) == (gain < 1.0)
    if found is not None:
        assert found.method == "peak gain" and all(x.greatest is None for x in found.links)
        far = replace(loop, links=tuple(LinkBounds(x.name, 1, 3, 10_000) for x in links))
        assert verify(found, far) == 0


def test_directions_that_do_not_act_are_left_out() -> None:
    """An estimate that stays as it is, with a rounding error, beside two lags."""
    links = [LinkBounds("link", 1, 0, None)]
    A = [[0.5, 0.0], [1e-14, 1.0 + 1e-13]]
    loop = cut(A, [[0.4], [0.0]], [[1.0, 1e-15]], links, [[0.0], [1.0]])
    found = certify(loop)
    assert found is not None
    assert 0 < verify(found, loop) < Fraction(1, 10**11)
    slow = replace(loop, A=exact([[0.5, 0.0], [0.0, 1.0001]]))
    with pytest.raises(ScenarioError, match="model"):
        verify(found, slow)
    with pytest.raises(ValueError, match="change of the model"):
        certify(replace(slow, links=(LinkBounds("link", 1, 0, 3),)))


def test_a_loop_with_feed_through_counts_a_sample_less() -> None:
    """y = x + u/4 over a link of 1 to 3 samples."""
    links = (LinkBounds("link", 1, 1, 3),)
    plain = cut([[0.9]], [[-0.02]], [[1.0]], links)
    loop = replace(plain, D=exact([[-0.25]]))
    found = certify(loop)
    assert found is not None
    assert verify(found, loop) == 0


@pytest.fixture(scope="module")
def proofs() -> list[tuple[CutLoop, Certificate]]:
    """One of each method."""
    loops = [
        cut([[0.5]], [[0.25]], [[1.0]], [LinkBounds("link", 1, 0, None)]),
        masses(0.01, both(0, 20)),
        integrator(0.85, 1),
    ]
    found = [(loop, certify(loop)) for loop in loops]
    assert [c.method for _, c in found if c] == ["peak gain", "small gain", "lyapunov"]
    return [(loop, c) for loop, c in found if c]


def test_a_file_is_read_as_it_was_written(
    proofs: list[tuple[CutLoop, Certificate]], tmp_path: Path
) -> None:
    for loop, found in proofs:
        (tmp_path / "c.json").write_text(found.text())
        assert read(tmp_path / "c.json") == found
        verify(found, loop)


def places(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The paths of all numbers and texts of a document."""
    if isinstance(data, dict | list):
        items = data.items() if isinstance(data, dict) else enumerate(data)
        for key, value in items:
            yield from places(value, (*path, key))
    else:
        yield path


@given(st.data())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=150)
def test_any_change_is_refused(
    proofs: list[tuple[CutLoop, Certificate]], data: st.DataObject
) -> None:
    _, found = data.draw(st.sampled_from(proofs))
    document = json.loads(found.text())
    *path, last = data.draw(st.sampled_from(list(places(document))))
    at = document
    for key in path:
        at = at[key]
    value = at[last]
    if isinstance(value, bool):
        at[last] = not value
    elif isinstance(value, int | float):
        at[last] = value + data.draw(st.integers(-5, 5).filter(bool))
    else:
        at[last] = None if value == "" else str(value)[:-1] + "x"
    with pytest.raises((ValueError, TypeError, KeyError)):
        certificate(document)


def forged(found: Certificate, **changes: Any) -> Certificate:
    """A certificate with a seal that fits its changed content."""
    return certificate(json.loads(replace(found, **changes).text()))


def test_a_seal_that_fits_proves_nothing(proofs: list[tuple[CutLoop, Certificate]]) -> None:
    """Wider bounds, or other matrices, with a new seal."""
    (_, _), (loop, gain), (few, switched) = proofs
    wide = tuple(replace(x, greatest=45) for x in gain.links)
    with pytest.raises(ScenarioError, match="do not prove"):
        verify(forged(gain, links=wide), loop)
    with pytest.raises(ScenarioError, match="does not hold"):
        verify(forged(switched, links=(replace(switched.links[0], greatest=4),)), few)
    twice = replace(switched.links[0], sends=2)
    doubled = replace(few, links=(twice,), C=exact([[1.0], [1.0]]), D=exact([[0.0], [0.0]]))
    with pytest.raises(ScenarioError, match="do not prove"):
        verify(forged(switched, links=(twice,), model=doubled.digest), doubled)
    negative = replace(gain.proof, P=-gain.proof.P)  # type: ignore[type-var, operator]
    with pytest.raises(ScenarioError, match="do not prove"):
        verify(forged(gain, proof=negative), loop)
    for changes in ({"links": gain.links[::-1]}, {"period": 0.001}):
        with pytest.raises(ScenarioError, match="is for the links"):
            verify(forged(gain, **changes), loop)
    for wrong in (float("nan"), 20.0, -1, True):
        with pytest.raises(ValueError, match="expected an integer"):
            forged(gain, links=tuple(replace(x, greatest=wrong) for x in gain.links))
    n = len(loop.A)
    every = exact(np.eye(n))
    with pytest.raises(ScenarioError, match="change of the model"):
        verify(forged(gain, neutral=every, pivots=tuple(range(n))), loop)


def test_a_certificate_covers_its_model_and_bounds_only(
    proofs: list[tuple[CutLoop, Certificate]],
) -> None:
    _, (loop, gain), _ = proofs
    verify(gain, masses(0.01, both(3, 20)))
    with pytest.raises(ScenarioError, match=r"cover links\.there: found ages of 0 to 21"):
        verify(gain, masses(0.01, both(0, 21)))
    with pytest.raises(ScenarioError, match="for the model"):
        verify(gain, masses(0.01, both(0, 20), spring=10.0 + 1e-12))
    with pytest.raises(ScenarioError, match="does not cover"):
        verify(gain, replace(loop, links=tuple(replace(x, greatest=None) for x in loop.links)))
    ordered = certify(masses(0.01, both(0, 20, ordered=True)))
    assert ordered is not None
    verify(gain, masses(0.01, both(0, 20, ordered=True)))
    with pytest.raises(ScenarioError, match="in order"):
        verify(ordered, loop)


def test_other_files_are_no_certificates(tmp_path: Path) -> None:
    for text in ("", "[]", "{}", '{"format": 3}', '{"format": "cosim certificate 1"}', "\xff"):
        (tmp_path / "c.json").write_bytes(text.encode("latin-1"))
        with pytest.raises(ScenarioError, match="not a certificate"):
            read(tmp_path / "c.json")
    with pytest.raises(ScenarioError, match="cannot be read"):
        read(tmp_path / "none.json")


#: A part of a certificate, another value of it, and words of the reason.
WRONG: list[tuple[tuple[Any, ...], Any, str]] = [
    (("model",), None, "expected a text"),
    (("links", 0, "name"), {"a": 1}, "expected a text"),
    (("links", 0, "greatest"), -1, "integer of 0 or more"),
    (("links", 0, "least"), 99, "ages of 99 to 20 samples"),
    (("links", 0, "colour"), "red", "of another kind"),
    (("method",), "magic", "'magic', expected one of"),
    (("P", "over"), 0, "over a positive integer"),
    (("P", "rows", 0, 0), "1", "a matrix is not one"),
    (("P", "rows", 0), [1], "differ in length"),
    (("X",), 3, "of another kind"),
    (("centres", 0), {"samples": 1}, "no key 'sections'"),
    (("period",), "fast", "convert"),
]


@pytest.mark.parametrize("place, value, words", WRONG)
def test_a_forged_part_is_named_in_a_sentence(
    proofs: list[tuple[CutLoop, Certificate]],
    place: tuple[Any, ...], value: Any, words: str, tmp_path: Path,
) -> None:  # fmt: skip
    document = json.loads(proofs[1][1].text())
    at = document
    for key in place[:-1]:
        at = at[key]
    at[place[-1]] = value
    given = {k: v for k, v in document.items() if k != "seal"}
    document["seal"] = sha256(json.dumps(given, sort_keys=True).encode()).hexdigest()
    (tmp_path / "c.json").write_text(json.dumps(document))
    with pytest.raises(ScenarioError, match=words) as refused:
        read(tmp_path / "c.json")
    assert "not a certificate" in str(refused.value) and "\n" not in str(refused.value)


def test_matrices_of_other_sizes_are_refused(proofs: list[tuple[CutLoop, Certificate]]) -> None:
    loop, gain = proofs[1]
    for changes in ({"pivots": (99,)}, {"neutral": gain.neutral.take([0])}):
        with pytest.raises(ScenarioError, match="neutral directions are not of 4 states"):
            verify(forged(gain, **changes), loop)
    of = replace(gain.proof, P=exact([[1.0]]))  # type: ignore[type-var]
    with pytest.raises(ScenarioError, match="does not hold"):
        verify(forged(gain, proof=of), loop)
