"""The sentence for a name that is not known."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def unknown(name: str, known: Iterable[str], what: str) -> str:
    """The sentence for a name that is not there, with the nearest that is."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, 1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    return f"no {what} {name!r}{hint} (there are: {', '.join(names) or 'none'})"
