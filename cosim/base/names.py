"""The sentence for a name that is not known, with the known name that it resembles."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

_INDEX = re.compile(r"(?:\[[\d, ]+\])+$")  # q[0], xi_in[1,0], xi_in[1][0]
_NUMBER = re.compile(r"(\d+)")


def signal_of(scalar: str) -> str:
    """The signal that a scalar is an entry of: ``arm.q`` for ``arm.q[0]``; ``a.b[1].y`` is one."""
    return _INDEX.sub("", scalar)


def extent(shape: Sequence[int], base: int = 0) -> str:
    """``[2,3]`` behind the name of an array; ``[1..2,1..3]`` if its entries count from 1; "" of one
    number.
    """
    sizes = [str(n) if base == 0 else f"{base}..{base + n - 1}" for n in shape]
    return f"[{','.join(sizes)}]" if sizes else ""


def counted(name: str) -> list[str | int]:
    """A key to sort names by so that their numbers count: ``robot2`` stands before ``robot10``."""
    return [int(part) if i % 2 else part for i, part in enumerate(_NUMBER.split(name))]


def nearest(name: str, known: Iterable[str]) -> str:
    """The known name that is most like `name`, also if only its case differs; "": none is."""
    names = sorted(known)
    folded = {other.casefold(): other for other in reversed(names)}
    if name.casefold() in folded:
        return folded[name.casefold()]
    import difflib  # only a wrong name needs it

    return next(iter(difflib.get_close_matches(name, names, 1)), "")


def hint(name: str, known: Iterable[str]) -> str:
    """``; did you mean 'X'?`` for a name that is not known, or "" where none is like it."""
    found = nearest(name, known)
    return f"; did you mean {found!r}?" if found else ""


def unknown(name: str, known: Iterable[str], what: str) -> str:
    """The sentence for a name that is not there, with the nearest that is."""
    names = sorted(set(known))
    there = listed(names, most=CHOICES) or "none"
    return f"no {what} {name!r}{hint(name, names)} (there are: {there})"


#: Most names in a list, and most of those to choose from; of more the first ones and their number.
NAMES, CHOICES, SHOWN = 12, 200, 4


def listed(names: Sequence[str], separator: str = ", ", most: int = NAMES) -> str:
    """Names in a sentence: up to `most` of them, or the first ones and how many more there are."""
    if len(names) <= most:
        return separator.join(names)
    return f"{separator.join(names[:SHOWN])} and {len(names) - SHOWN} more"
