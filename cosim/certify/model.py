"""A loop cut at its links, with bounds of their ages: what a certificate is about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from hashlib import sha256

from cosim.certify.exact import Exact, above, beside

#: The largest change of an entry of A or C, relative to the greatest of that matrix, that makes the
#: neutral directions exact.
ROUNDING = Fraction(1, 10**7)


@dataclass(frozen=True, slots=True)
class LinkBounds:
    """The ages of what a link holds: from `least` to `greatest` samples, at any time any of them.

    Samples are sent `sends` times a period, and the receiver looks once, as the first is sent.

    None as the greatest: as old as it may be, if only each sample is replaced in the end.
    `ordered`: no sample follows a newer one, so that an age grows by at most 1 a sample; the link
    carries `size` numbers.
    """

    name: str
    size: int
    least: int
    greatest: int | None
    ordered: bool = False
    sends: int = 1

    @property
    def most(self) -> int:
        """The greatest age. Raises ValueError if there is none."""
        if self.greatest is None:
            raise ValueError(f"links.{self.name} has no greatest age")
        return self.greatest

    def within(self, other: LinkBounds) -> bool:
        """True if every sequence of ages of this link is one of `other`, too."""
        mine, theirs = ((x.name, x.size, x.sends) for x in (self, other))
        if mine != theirs or self.least < other.least:
            return False
        if other.greatest is None:
            return self.ordered or not other.ordered
        if self.greatest is None or self.greatest > other.greatest:
            return False
        return self.ordered or not other.ordered or self.least == self.greatest


@dataclass(frozen=True, slots=True)
class CutLoop:
    """x[k+1] = `A` x[k] + `B` u[k], y[k] = `C` x[k] + `D` u[k], and the links u_i[k] = y_i[k-age].

    A (n, n), B (n, m), C (p, n), D (p, m). u are the numbers that the `links` hold, one link after
    the other, y those that they send in a period, of each link one sample after the other.
    `neutral` (n, k): columns x that stay as they are if all links hold what is sent; `period`: the
    time from k to k + 1, s.
    """

    A: Exact
    B: Exact
    C: Exact
    D: Exact
    neutral: Exact
    links: tuple[LinkBounds, ...]
    period: float = 1.0
    states: tuple[str, ...] = field(default=())

    @property
    def feeds_through(self) -> bool:
        """True if what is held acts at once on what is sent when the receiver looks."""
        return bool(self.D.take(_at_looks(self.links)).greatest())

    @property
    def digest(self) -> str:
        """SHA-256 of the matrices and of the names and sizes of the links, not of their bounds."""
        parts = [f"{len(x)} {x.width} {x.over} {x.rows}" for x in map(Exact.lowest, (
            self.A, self.B, self.C, self.D))]  # fmt: skip
        named = [f"{x.name} {x.size} {x.sends}" for x in self.links]
        return sha256("\n".join([*parts, *named, self.period.hex()]).encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class ClosedParts:
    """A loop with exact neutral directions, and without feed-through to what is sent at a look.

    x[k+1] = `A` x[k] + `B` u[k], y[k] = `C` x[k] + `D` u[k]; x = `X` a, u = `Y` a stays so. The
    rows `pivots` of X are the identity. `changed`: by how much entries of A and C were changed,
    relative to the greatest of each.
    """

    A: Exact
    B: Exact
    C: Exact
    D: Exact
    X: Exact
    Y: Exact
    pivots: tuple[int, ...]
    links: tuple[LinkBounds, ...]
    changed: Fraction

    def places(self) -> list[range]:
        """The places in u of each link."""
        return _ranges([x.size for x in self.links])

    def sent(self) -> list[range]:
        """The places in y of each link."""
        return _ranges([x.size * x.sends for x in self.links])


def _ranges(sizes: Sequence[int]) -> list[range]:
    ends = [sum(sizes[: i + 1]) for i in range(len(sizes))]
    return [range(e - x, e) for e, x in zip(ends, sizes, strict=True)]


def _sources(links: Sequence[LinkBounds]) -> list[int]:
    """For each row of y, the place in u of the same number."""
    ranges = _ranges([x.size for x in links])
    return [i for x, r in zip(links, ranges, strict=True) for _ in range(x.sends) for i in r]


def _at_looks(links: Sequence[LinkBounds]) -> list[int]:
    """The rows of y that are sent when the receiver looks."""
    return [i for x, r in zip(links, _ranges([x.size * x.sends for x in links]), strict=True)
            for i in r[: x.size]]  # fmt: skip


def closed_parts(loop: CutLoop, pivots: Sequence[int]) -> ClosedParts:
    """The loop with its neutral directions exactly neutral, and nothing sent at once.

    Where u acts on what is sent at a look, each link gives one sample of its age to the loop, whose
    states then include what receivers hold. The columns `pivots` of A and C are changed so that X
    and Y are neutral, which is a change in the size of rounding errors. Raises ValueError for a
    loop of which this is not true, or that depends on itself at once.
    """
    A, B, C, D, X, links = loop.A, loop.B, loop.C, loop.D, loop.neutral, loop.links
    _check_pivots(X, pivots, len(A))
    looks = _at_looks(links)
    Y = C.take(looks) @ X
    if D.take(looks).greatest():
        if any(x.least < 1 or x.sends > 1 for x in links):
            raise ValueError("a link without delay feeds through at once; expected 1 sample")
        m = len(C)
        # Y of the open loop is what receivers hold: the sum of C X + D Y, to rounding.
        Y = _held(D, Y)
        A = above(beside(A, B), Exact.zeros(m, len(A) + m))
        B = above(Exact.zeros(len(loop.A), m), Exact.eye(m))
        C, D, X = beside(C, D), Exact.zeros(m, m), above(X, Y)
        links = tuple(LinkBounds(x.name, x.size, x.least - 1, x.most - 1, x.ordered) for x in links)
    A, first = _with(A, X, X - B @ Y, pivots)
    C, second = _with(C, X, Y.take(_sources(links)) - D @ Y, pivots)
    return ClosedParts(A, B, C, D, X, Y, tuple(pivots), links, max(first, second))


@dataclass(frozen=True, slots=True)
class OpenParts:
    """The cut loop without states that stay as they are and are not sent: A X = X, C X = 0.

    `sources`: for each row of C and D the place in u of the same number. `changed`: by how much
    entries of A and C were changed, relative to the greatest of each.
    """

    A: Exact
    B: Exact
    C: Exact
    D: Exact
    sources: tuple[int, ...]
    changed: Fraction


def open_parts(loop: CutLoop, pivots: Sequence[int]) -> OpenParts:
    """The cut loop without its neutral directions, none of which may be sent.

    Raises ValueError for a loop that has others, as robots that agree on any place.
    """
    X = loop.neutral
    _check_pivots(X, pivots, len(loop.A))
    A, first = _with(loop.A, X, X, pivots)
    C, second = _with(loop.C, X, Exact.zeros(len(loop.C), X.width), pivots)
    full = quotient(beside(A, loop.B), X, pivots, loop.B.width, following=True)
    n = len(full)
    found = quotient(beside(C, loop.D), X, pivots, loop.B.width, following=False)
    rows, inputs = range(n), range(n, n + loop.B.width)
    return OpenParts(
        full.take(rows, rows).lowest(), full.take(rows, inputs).lowest(),
        found.take(range(len(C)), rows).lowest(), loop.D,
        tuple(_sources(loop.links)), max(first, second),
    )  # fmt: skip


def _check_pivots(X: Exact, pivots: Sequence[int], n: int) -> None:
    if len(X) != n or max(pivots, default=0) >= max(n, 1):
        raise ValueError(f"the neutral directions are not of {n} states")
    if X.width != len(pivots) or (X.take(pivots) - Exact.eye(X.width)).greatest():
        raise ValueError("the neutral directions are not the identity at their pivots")


def _with(matrix: Exact, X: Exact, product: Exact, pivots: Sequence[int]) -> tuple[Exact, Fraction]:
    """The matrix with its columns `pivots` so changed that it takes X to `product`, and how much.

    The change is relative to the greatest entry. Raises ValueError if it is more than rounding.
    """
    wrong = product - matrix @ X
    change = wrong.greatest() / (matrix.greatest() or Fraction(1))
    if change > ROUNDING:
        raise ValueError(
            f"the neutral directions need a change of the model by {float(change):.1g}, "
            f"relative; expected at most {float(ROUNDING):.1g}"
        )
    return matrix + _spread(wrong, pivots, matrix.width), change


def _held(D: Exact, sent: Exact) -> Exact:
    """Y = D Y + sent, to about 1e-15: a fixed point, which is exact where D is nilpotent."""
    found = sent
    for _ in range(len(D) + 1):
        found = Exact.of((D @ found + sent).floats(), sent.width)
    return found


def _spread(columns: Exact, places: Sequence[int], width: int) -> Exact:
    """A matrix of this width with `columns` at `places`, and 0 elsewhere."""
    if not places:
        return Exact.zeros(len(columns), width)
    where = {j: k for k, j in enumerate(places)}
    rows = tuple(
        tuple(row[where[j]] if j in where else 0 for j in range(width)) for row in columns.rows
    )
    return Exact(rows, columns.over, width)


def quotient(
    full: Exact, X: Exact, pivots: Sequence[int], inputs: int, *, following: bool
) -> Exact:
    """`full` (n or m, n + inputs), of states and inputs, on the states without their neutral part.

    A state is x = x~ + X a with a = x[pivots] and x~[pivots] = 0. `following`: the rows are next
    states, n of them, and become those of x~. No row may depend on a, else ValueError is raised.
    """
    n, k = len(X), len(pivots)
    rest = [i for i in range(n) if i not in set(pivots)]
    columns = [*rest, *range(n, n + inputs)]
    found = full
    if following:
        found = full.take(rest) - X.take(rest) @ full.take(pivots) if k else full.take(rest)
    moved = found.take(range(len(found)), range(n)) @ X if k else Exact.zeros(0, 0)
    if moved.greatest():
        raise ValueError("a neutral direction acts on the rest")
    return found.take(range(len(found)), columns)
