"""Sine and cosine of the kernels: against exact arithmetic, and the same bits everywhere."""

from __future__ import annotations

import ctypes
from fractions import Fraction
from functools import cache
from math import inf, isnan, nan, pi, ulp
from pathlib import Path

import numpy as np
import pytest

import fmus
from fmus.build import toolchain

C = Path(fmus.__file__).parent / "c"
BITS = 320  # of the exact arithmetic, after the point
LIMIT = 2.0**20  # rad, TRIG_RANGE

WRAPPER = """
#include "export.h"
#include "trig.h"

EXPORT void sines_cosines(const double *x, double *sines, double *cosines, int n) {
    for (int i = 0; i < n; i++) sine_cosine(x[i], sines + i, cosines + i);
}
"""


def built(folder: Path) -> ctypes.CDLL:
    """The functions of trig.c for many arguments, in a library of its own."""
    folder.mkdir()
    (folder / "wrapper.c").write_text(WRAPPER)
    sources = [folder / "wrapper.c", C / "trig.c"]
    name = "trig" + toolchain.shared_suffix()
    return ctypes.CDLL(str(toolchain.compile_shared(sources, folder / name, include=[C])))


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return built(tmp_path_factory.mktemp("trig") / "host")


def evaluated(library: ctypes.CDLL, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x = np.ascontiguousarray(x, dtype=np.float64)
    sines, cosines = np.empty_like(x), np.empty_like(x)
    pointers = [ctypes.c_void_p(array.ctypes.data) for array in (x, sines, cosines)]
    library.sines_cosines(*pointers, ctypes.c_int(len(x)))
    return sines, cosines


@cache
def half_pi() -> int:
    """pi / 2 in fixed point, after Machin: pi = 16 atan(1/5) - 4 atan(1/239)."""

    def atan_of_one_over(n: int) -> int:
        power, total, k = (1 << (BITS + 32)) // n, 0, 0
        while power:
            total += (-1) ** k * power // (2 * k + 1)
            power, k = power // (n * n), k + 1
        return total

    return (8 * atan_of_one_over(5) - 2 * atan_of_one_over(239)) >> 32


def exact(x: float) -> tuple[Fraction, Fraction]:
    """sin x and cos x to about 300 bits, |x| a multiple of 2^-BITS."""
    numerator, denominator = x.as_integer_ratio()
    fixed = (numerator << BITS) // denominator
    k = (2 * fixed + half_pi()) // (2 * half_pi())
    r = fixed - k * half_pi()
    parts, term, n = [0, 0], 1 << BITS, 0
    while term:
        parts[n % 2] += term if n % 4 < 2 else -term
        n += 1
        term = ((abs(term) * abs(r)) >> BITS) // n
    c, s = parts[0], parts[1] if r >= 0 else -parts[1]
    s, c = [(s, c), (c, -s), (-s, -c), (-c, s)][k % 4]
    return Fraction(s, 1 << BITS), Fraction(c, 1 << BITS)


def arguments() -> np.ndarray:
    rng = np.random.default_rng(20)
    multiples = rng.integers(1, 667_000, 700) * (pi / 2)
    return np.concatenate(
        [
            rng.uniform(-pi / 4, pi / 4, 1500),
            rng.uniform(-10, 10, 1500),
            rng.uniform(-LIMIT, LIMIT, 1500),
            10.0 ** rng.uniform(-25, 0, 300),
            np.arange(-40, 41) * (pi / 4),
            multiples,
            np.nextafter(multiples, inf),
            [LIMIT, -LIMIT, 3.5, 3.0],
        ]
    )


def test_within_one_unit_in_the_last_place(library: ctypes.CDLL) -> None:
    x = arguments()
    for value, *computed in np.stack([x, *evaluated(library, x)], axis=1).tolist():
        for result, truth in zip(computed, exact(value), strict=True):
            error = abs(Fraction(result) - truth) / Fraction(ulp(float(truth)))
            assert error < 0.8, (value, result, float(error))


def test_odd_and_even(library: ctypes.CDLL) -> None:
    x = arguments()
    (s, c), (minus_s, minus_c) = evaluated(library, x), evaluated(library, -x)
    assert np.array_equal(minus_s, -s)
    assert np.array_equal(minus_c, c)


@pytest.mark.parametrize("tiny", [0.0, -0.0, 5e-324, -5e-324, 1e-310, 1e-40, 1e-9])
def test_tiny_arguments_come_back(library: ctypes.CDLL, tiny: float) -> None:
    s, c = evaluated(library, np.array([tiny]))
    assert s[0] == tiny
    assert c[0] == 1.0


@pytest.mark.parametrize("x", [nan, inf, -inf, np.nextafter(LIMIT, inf), -1e7, 1e300])
def test_beyond_the_range_there_is_no_number(library: ctypes.CDLL, x: float) -> None:
    s, c = evaluated(library, np.array([x]))
    assert isnan(s[0])
    assert isnan(c[0])


@pytest.mark.slow
def test_the_same_bits_from_another_compiler(
    library: ctypes.CDLL, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(toolchain, "host_compiler", lambda: None)
    other = built(tmp_path / "zig")
    x = np.concatenate([arguments(), np.random.default_rng(21).uniform(-100, 100, 100_000)])
    for here, there in zip(evaluated(library, x), evaluated(other, x), strict=True):
        assert here.tobytes() == there.tobytes()
