"""The region of delays that is certified, broken, or unknown, over the bounds of all links."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from cosim.base.copies import replace
from cosim.base.errors import RunError
from cosim.certify.certificate import Certificate
from cosim.certify.model import CutLoop
from cosim.certify.search import certify
from cosim.certify.witness import adversary
from cosim.linear.opened import OpenLoop

State = Literal["certified", "unknown", "broken"]
#: Growth from which a constant delay counts as unstable, 1/s: slower poles are neutral.
_GROWTH = 1e-3


@dataclass(frozen=True, slots=True)
class Region:
    """The states of all intervals between some `delays` (of `period` s each), in order.

    `highest`: for each least delay the index of the greatest up to which it is certified, -1: none.
    `unstable`: constant delays with which all links make the loop unstable. `grown`: pairs of
    indices between which an adversary found delays with which a motion grows.
    """

    delays: tuple[int, ...]
    period: float
    highest: tuple[int, ...]
    unstable: tuple[bool, ...]
    grown: frozenset[tuple[int, int]]

    def state(self, least: int, greatest: int) -> State:
        """The state of all delays between two, by their indices."""
        if greatest <= self.highest[least]:
            return "certified"
        inside = any(least <= i and j <= greatest for i, j in self.grown)
        return "broken" if inside or any(self.unstable[least : greatest + 1]) else "unknown"


def region(
    loop: CutLoop,
    opened: OpenLoop,
    delays: Sequence[int],
    say: Callable[[str], None] = lambda text: None,
) -> Region:
    """The region over `delays` (periods), the same bounds for all links.

    What is certified between two delays is so between any within, so that 2 n searches find it of
    n delays. Raises ScenarioError without the solver.
    """
    n = len(delays)
    found: list[int] = []
    top, peaks = -1, True
    for i in range(n):
        top = max(top, i - 1)
        while top + 1 < n:
            say(f"certificate for {delays[i]} to {delays[top + 1]} samples")
            proof = _proof(_bounded(loop, delays[i], delays[top + 1]), peaks=peaks)
            peaks = False
            if proof is None:
                break
            top = n - 1 if proof.method == "peak gain" else top + 1
        found.append(top if top >= i else -1)
    unstable = tuple(_unstable(opened, d * opened.ticks) for d in delays)
    plain = Region(tuple(delays), opened.period, tuple(found), unstable, frozenset())
    return replace(plain, grown=frozenset(_grown(loop, plain, say)))


def _grown(loop: CutLoop, found: Region, say: Callable[[str], None]) -> Iterator[tuple[int, int]]:
    """For each least delay the least interval in which an adversary makes a motion grow."""
    n = len(found.delays)

    def grows(i: int, j: int) -> bool:
        state = found.state(i, j)
        if state != "unknown":
            return state == "broken"
        say(f"adversary for {found.delays[i]} to {found.delays[j]} samples")
        return adversary(_bounded(loop, found.delays[i], found.delays[j])) is not None

    j = 0
    for i in range(n if grows(0, n - 1) else 0):
        j = max(i, j)  # what contains a broken interval is broken
        while j < n and not grows(i, j):
            j += 1
        if j == n:
            return
        if not any(found.unstable[i : j + 1]):
            yield i, j


def _proof(loop: CutLoop, *, peaks: bool) -> Certificate | None:
    try:
        return certify(loop, peaks=peaks)
    except ValueError:
        return None


def _bounded(loop: CutLoop, least: int, greatest: int) -> CutLoop:
    """The loop with these bounds of all links, in periods."""
    links = tuple(
        replace(x, least=least * x.sends, greatest=greatest * x.sends) for x in loop.links
    )
    return replace(loop, links=links)


def _unstable(opened: OpenLoop, delay: int) -> bool:
    try:
        return opened.unstable([delay] * len(opened.links), _GROWTH) > 0
    except RunError:  # a pole on the limit
        return False
