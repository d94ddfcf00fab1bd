"""The loop about one fixed lateness of each link, and the gain that bounds every other one.

Notation: v[k] = y[k] - y[k-1] is the increase of what is sent, `least` <= age <= `greatest` the age
of what is held, c the centre. What is held is::

    u[k] = y[k - age[k]] = (R y)[k] + w[k],     |w|_X <= (gamma + epsilon) |v|_X

in the norm of sequences weighted by any X > 0, where R is a filter of gain 1 at rest.

`gamma` bounds y[k - age[k]] - y[k - c], a sum of at most |age - c| increments:

* any sequence of ages: gamma^2 = (greatest - c)^2 + (c - least)^2
* ordered samples (no sample follows a newer one): gamma = max(greatest - c, c - least)

with a term left out where c is beyond that end (Shustin and Fridman 2006, Kao and Rantzer 2007, in
continuous time: their factor goes from 1 for a rate of the delay up to 1 to sqrt(2) for any rate).

`epsilon` bounds y[k-c] - R y. R is p all-pass sections (1 - a z)/(z - a), a = (c - p)/(c + p), of
c/p samples each at rest: exact for p = c, else epsilon^2 = 1 + (kappa^6 b^2)^(1/3) with
b = c ((c/p)^2 - 1)/3 and kappa^6 = max sin(x)^6/x^2 < 0.4743.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import isqrt

from cosim.certify.exact import Exact, above, beside
from cosim.certify.model import ClosedParts, LinkBounds, quotient

#: Upper bound of max sin(x)^6/x^2, which is 0.47427.
_KAPPA6 = Fraction(4743, 10000)
#: Roots are rounded up to 1/_FINE.
_FINE = 1 << 20


@dataclass(frozen=True, slots=True)
class Centre:
    """The fixed lateness of a link: `samples` of a period, made of `sections` all-pass filters."""

    samples: int
    sections: int

    def __post_init__(self) -> None:
        if not 0 <= self.sections <= self.samples or (self.samples and not self.sections):
            raise ValueError(f"{self.sections} sections for {self.samples} samples")

    @property
    def a(self) -> Fraction:
        """The coefficient of a section; 0: a section is a delay of one sample."""
        return Fraction(self.samples - self.sections, self.samples + self.sections)


@dataclass(frozen=True, slots=True)
class Nominal:
    """x[k+1] = F (x[k], w[k]) and v[k+1] = V (x[k], w[k]) without neutral directions.

    `F` (n, n + m), `V` (p, n + m); `places`: the places in w of each link, `steps` those in v, the
    increments from one sample that is sent to the next.
    """

    F: Exact
    V: Exact
    places: tuple[range, ...]
    steps: tuple[range, ...]


def nominal(parts: ClosedParts, centres: Sequence[Centre]) -> Nominal:
    """The loop with each link late by its centre, from the errors w to the increments v."""
    n, m, places, sent = len(parts.A), parts.B.width, parts.places(), parts.sent()
    late = sum(c.sections * len(p) for c, p in zip(centres, places, strict=True))
    width = n + late + m
    y = beside(parts.C, Exact.zeros(len(parts.C), late + m))
    held, next_rows, rest, first = [], [], [parts.X], n
    for centre, place, rows in zip(centres, places, sent, strict=True):
        a, r = centre.a if centre.sections else Fraction(0), y.take(rows[: len(place)])
        for _ in range(centre.sections):
            state = _unit(len(place), first, width)
            next_rows.append(state.times(a) + r)
            rest.append(parts.Y.take(place).times(1 / (1 - a)))
            r = r.times(-a) + state.times(1 - a * a)
            first += len(place)
        held.append(r + _unit(len(place), n + late + place.start, width))
    x = beside(parts.A, Exact.zeros(n, late + m))
    after = x + parts.B @ above(*held)
    y = y + parts.D @ above(*held)
    next_y = parts.C @ after  # of the samples at a look, on which u does not act
    steps = []
    for place, rows in zip(places, sent, strict=True):
        size = len(place)
        ends = above(y.take(rows[size:]), next_y.take(rows[:size]))
        steps.append(ends - y.take(rows))
    V = above(*steps)
    F = above(after, *next_rows)
    X = above(*rest)
    return Nominal(
        quotient(F, X, parts.pivots, m, following=True).lowest(),
        quotient(V, X, parts.pivots, m, following=False).lowest(),
        tuple(places),
        tuple(sent),
    )


def _unit(rows: int, first: int, width: int) -> Exact:
    """Ones from the column `first` on, one a row."""
    return Exact(tuple(tuple(int(j == first + i) for j in range(width)) for i in range(rows)),
                 1, width)  # fmt: skip


def squared_gain(link: LinkBounds, centre: Centre) -> Fraction:
    """An upper bound of (gamma + epsilon)^2, samples squared, rational."""
    return _square_of_sum(squared_gamma(link, centre.samples), squared_epsilon(centre) * link.sends)


def squared_gamma(link: LinkBounds, c: int) -> Fraction:
    """gamma^2: of what is held from what was sent c periods before.

    An increment is in the sums of at most one look in `sends` samples.
    """
    middle = c * link.sends
    over, under = (
        x * -(-x // link.sends) for x in (max(0, link.most - middle), max(0, middle - link.least))
    )
    return Fraction(max(over, under) if link.ordered else over + under)


def squared_epsilon(centre: Centre) -> Fraction:
    """epsilon^2, rounded up: of a delay of c samples from its filter; 0 if that is exact."""
    c, p = centre.samples, centre.sections
    if p == c:
        return Fraction(0)
    b = c * (Fraction(c * c, p * p) - 1) / 3
    return 1 + _root_up(_KAPPA6 * b * b, 3)


def _square_of_sum(a: Fraction, b: Fraction) -> Fraction:
    """(sqrt(a) + sqrt(b))^2, rounded up."""
    return a + b + 2 * _root_up(a * b, 2)


def _root_up(x: Fraction, degree: int) -> Fraction:
    """A rational number that is no less than the root of x, to 1/_FINE."""
    scaled = -(-x.numerator * _FINE**degree // x.denominator)
    low, high = 0, 1 << (scaled.bit_length() // degree + 1)
    if degree == 2:
        low = max(0, isqrt(scaled) - 1)
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if middle**degree >= scaled else (middle + 1, high)
    return Fraction(low, _FINE)
