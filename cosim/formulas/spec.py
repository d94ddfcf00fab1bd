"""A requirement as a scenario declares it."""

from __future__ import annotations

from math import inf

from cosim.base.convert import Number, Struct, number
from cosim.base.errors import ScenarioError
from cosim.formulas.syntax import Formula, Temporal, TimeInterval, names, read

_FORMS = ("metric", "always", "eventually", "formula")


class RequirementSpec(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A requirement ``[require.NAME]``: one of the first four keys, each a text.

    `metric`: a comparison of metrics (``"sync.settle_s <= 15 s"``); `always`, `eventually`: a
    formula that holds all the time, or at least once, in an interval; `formula`: a whole formula
    with intervals of its own. The interval is `within` a time or [begin, end], or `after` a time,
    from the start of the run on, s; default: the whole run.
    """

    metric: str = ""
    always: str = ""
    eventually: str = ""
    formula: str = ""
    within: Number | tuple[Number, Number] | None = None
    after: Number | None = None

    @property
    def form(self) -> str:
        """The key that is given."""
        return next((key for key in _FORMS if getattr(self, key)), "")

    @property
    def text(self) -> str:
        """The formula of that key, as it is written."""
        return str(getattr(self, self.form, ""))

    @property
    def condition(self) -> str:
        """The requirement on one line."""
        if self.form in ("metric", "formula"):
            return self.text
        begin, end = self.within if isinstance(self.within, tuple) else (0, self.within)
        if self.after is not None:
            when = f" after {_time(self.after)}"
        elif end is None:
            when = ""
        elif isinstance(self.within, tuple):
            when = f" within [{_time(begin)}, {_time(end)}]"
        else:
            when = f" within {_time(end)}"
        return f"{self.form}{when}: {self.text}"

    @property
    def names(self) -> tuple[str, ...]:
        """The names in its formula: of metrics, or of signals."""
        return tuple(dict.fromkeys(name.text for name in names(read(self.text))))

    def tree(self, place: str) -> Formula:
        """The formula. Raises ScenarioError at `place` for what cannot be read."""
        given = [key for key in _FORMS if getattr(self, key)]
        if len(given) != 1:
            found = " and ".join(given) or "none"
            raise ScenarioError(f"found {found}, expected one of {', '.join(_FORMS)}", place)
        interval = self._interval(place)
        try:
            inner = read(self.text)
        except ScenarioError as error:
            raise ScenarioError(str(error), f"{place}.{self.form}") from None
        if self.form in ("always", "eventually"):
            return Temporal(self.form, interval or TimeInterval(), (inner,), 1)  # type: ignore[arg-type]
        if interval is not None:
            key = "after" if self.within is None else "within"
            cure = "it is of the whole run" if self.form == "metric" else "write it in the formula"
            raise ScenarioError(f"{self.form!r} takes no {key!r}; {cure}", place)
        return inner

    def _interval(self, place: str) -> TimeInterval | None:
        """The interval from the start of the run on, s; None: none is given."""
        if self.within is None:
            return (
                None if self.after is None else TimeInterval(_seconds(self.after, f"{place}.after"))
            )
        if self.after is not None:
            raise ScenarioError("found 'within' and 'after', expected one of them", place)
        given = self.within if isinstance(self.within, tuple) else (0.0, self.within)
        begin, end = (_seconds(x, f"{place}.within") for x in given)
        if not begin <= end:
            text = f"the interval from {begin:g} s to {end:g} s is empty"
            raise ScenarioError(f"{text}; expected its begin before its end", f"{place}.within")
        return TimeInterval(begin, end)


def _seconds(value: Number, place: str) -> float:
    found = number(value, "s", place)
    if not 0.0 <= found < inf:
        raise ScenarioError(f"found {found:g} s, expected a time from the start on", place)
    return found


def _time(value: Number | None) -> str:
    return value if isinstance(value, str) else f"{value:g} s"
