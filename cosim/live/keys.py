"""The values of a scenario that a reader of a page can move, found out by trying.

A key is movable if the plan made with another value of it has the same image but for numbers that
are that value to the bit, or follow from it by a rule: the width of a law is ``high - low``, in
doubles, and a time between draws is a ratio of whole numbers. All keys are moved at once, and to
both ends of their sliders; where something else changes, halves of them are tried, until those are
found that do it. They are fixed then, with the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from functools import partial
from typing import Any

import numpy as np

from cosim.base.convert import number
from cosim.base.errors import CosimError
from cosim.base.toml import as_toml, change
from cosim.engine.initialization import exits
from cosim.links.laws import draws_per_sample
from cosim.links.table import DrawnTable
from cosim.live.candidates import Fixed, Slider, candidates, written_out
from cosim.live.layout import layout
from cosim.live.movable import Movable, Write
from cosim.live.plan_image import PlanImage, plan_image
from cosim.native import structs
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from cosim.schedule.plan import Plan

Values = Mapping[str, float]
#: By link: samples that it keeps, packets on their way.
Room = dict[str, tuple[int, int]]
_DIFFERS = "the plan changes with it in more than a number"
#: Plans that are made to find out which keys can be moved, at most; the rest is fixed then.
TRIES = 256
_TABLE = layout(structs.TableStruct)
_RATIO = ("draws", "samples", "rest")


def movable(
    document: Mapping[str, Any],
    path: Any,
    recorded: Sequence[str],
    tries: int = TRIES,
    only: str = "",
) -> Movable:
    """The keys of the scenario `document` of the file `path` that begin with `only`.

    `recorded`: the signals, as in ``run.record``; `tries`: plans made to find out, at most. Raises
    LiveError if a page cannot compute it, CosimError if it cannot be run.
    """
    search = _Search(document, path, recorded, tries)
    if not only:  # what is asked for by name is in the document
        search.write_out()
    return search.found(only)


class _Search:
    def __init__(
        self, document: Mapping[str, Any], path: Any, recorded: Sequence[str], tries: int
    ) -> None:
        self._document, self._path, self._recorded = document, path, recorded
        self._room: Room = {}
        self._plan = self._assembled({})
        self._base = self._made({})
        self._reasons: dict[str, str] = {}
        self._values: dict[str, float] = {}
        self._pairs: dict[str, str] = {}
        self._tries, self._most = 0, tries
        self._added: dict[str, list[str]] = {}

    def write_out(self) -> None:
        """Put values into the document that it leaves out, as far as that changes nothing."""
        for losses in (True, False):
            document, added = written_out(self._document, self._plan, losses=losses)
            if added and self._is_the_same(document):
                self._document, self._added = document, added
                break

    def _is_the_same(self, document: Mapping[str, Any]) -> bool:
        """True if another document makes the same image, with room for both."""
        before = self._document
        try:
            self._document = document
            self._made({})
            self._document = before
            self._base = self._made({})
            self._document = document
            return self._made({}).image.content() == self._base.image.content()
        except CosimError:
            return False
        finally:
            self._document = before

    def found(self, only: str) -> Movable:
        keys, fixed = candidates(self._document, self._plan)
        keys = [c for c in keys if c.key.startswith(only)]
        fixed = [x for x in fixed if x.key.startswith(only)]
        self._values = {c.key: c.value for c in keys}
        self._pairs = {c.key: c.pair for c in keys if c.pair}
        lows = self._ends(keys, [c.lows for c in keys])
        highs = self._ends(keys, [c.highs for c in keys])
        moving = [c for c in keys if lows[c.key] < highs[c.key]]
        apart = {c.key: (lows if c.last == "low" else highs)[c.key] for c in moving}
        self._made(apart)
        self._base = self._made({})  # with room for all of them
        writes: list[Write] = []
        while moving:
            writes = self._writes(moving)
            tried = [self._inside(moving), {c.key: lows[c.key] for c in moving}]
            tried.append({c.key: highs[c.key] for c in moving})
            wrong = set[str]()
            fits = partial(self._explained, writes)
            for values in tried:
                wrong |= self._offenders(values, fits)
            if not wrong:
                break
            moving = [c for c in moving if c.key not in wrong]
        kept = {c.key for c in moving}
        fixed += [
            Fixed(c.key, self._reasons.get(c.key, _DIFFERS)) for c in keys if c.key not in kept
        ]
        ends = {c.key: (lows[c.key], highs[c.key]) for c in moving}
        return Movable(self._base, moving, ends, writes, fixed, self._settings(kept))

    def _settings(self, kept: set[str]) -> dict[str, list[str]]:
        """The tables and lists that are set as a whole, with the numbers of entries that stay."""
        every = self._values
        return {
            path: [as_toml(every[x]) if x in every and x not in kept else x for x in parts]
            for path, parts in self._added.items()
            if kept.intersection(parts)
        }

    # ---- plans -------------------------------------------------------------------------------

    def _assembled(self, values: Values) -> Plan:
        document = deepcopy(dict(self._document))
        for key, value in values.items():
            change(document, f"{key}={as_toml(float(value))}")
        return assemble(build(document, self._path))

    def _made(self, values: Values) -> PlanImage:
        """The image with other values, and the room that it needs. Raises CosimError."""
        made = plan_image(self._assembled(values), self._recorded, self._room)
        for link, kept, pending in zip(made.plan.links, made.capacity, made.pending, strict=True):
            before = self._room.get(link.name, (0, 0))
            self._room[link.name] = max(before[0], kept), max(before[1], pending)
        return made

    # ---- ends --------------------------------------------------------------------------------

    def _ends(self, keys: Sequence[Slider], ends: Sequence[Sequence[float]]) -> dict[str, float]:
        """The widest ends, one way, at which the plan is that of the scenario but for numbers."""
        at = dict.fromkeys((c.key for c in keys), 0)
        of = {c.key: [*some, c.value] for c, some in zip(keys, ends, strict=True)}
        while True:
            values = {key: of[key][i] for key, i in at.items() if of[key][i] != of[key][-1]}
            wrong = self._offenders(values, self._alike)
            if not wrong:
                return {key: of[key][i] for key, i in at.items()}
            for key in wrong:
                at[key] += 1

    def _offenders(self, values: Values, fits: Callable[[Values], bool]) -> set[str]:
        """The keys with which values do not fit, found by halves."""
        self._tries += bool(values)
        if not values or (self._tries <= self._most and fits(values)):
            return set()
        keys = list(values)
        if len(keys) == 1 or self._tries > self._most:
            return set(keys)
        parts = [{k: values[k] for k in some} for some in self._halves(keys)]
        wrong = set[str]().union(*(self._offenders(part, fits) for part in parts))
        return wrong or set(keys)  # each half fits, both together do not

    def _halves(self, keys: Sequence[str]) -> tuple[list[str], list[str]]:
        """Two or more keys in two parts.

        Those of one name, which often fail for one reason, are in the same part, if there are
        others; so are the bounds of a law, which have to fit each other.
        """
        law = {key: self._pairs.get(key, key) for key in keys}
        name = {key: "" if key in self._pairs else key.rpartition(".")[2] for key in keys}
        for kind in (name, law, {key: key for key in keys}):
            kinds = list(dict.fromkeys(kind.values()))
            if len(kinds) > 1:
                first = set(kinds[: len(kinds) // 2])
                break
        return [k for k in keys if kind[k] in first], [k for k in keys if kind[k] not in first]

    def _alike(self, values: Values) -> bool:
        """True if the plan with these values is the same but for numbers."""
        try:
            made = self._made(values)
        except CosimError as error:
            if len(values) == 1:
                self._reasons[next(iter(values))] = str(error)
            return False
        return self._same_structure(made)

    def _same_structure(self, made: PlanImage) -> bool:
        base = self._base
        mine, other = base.image, made.image
        return (
            made.plan.operations == base.plan.operations
            and made.columns == base.columns
            and exits(made.plan) == exits(base.plan)
            and made.drawn == base.drawn
            and (mine.functions, mine.instances) == (other.functions, other.instances)
            and all(np.array_equal(base.frozen[i], made.frozen[i]) for i in base.frozen)
            and all(map(np.array_equal, base.played, made.played))
        )

    # ---- what keys write ---------------------------------------------------------------------

    def _inside(self, keys: Sequence[Slider]) -> dict[str, float]:
        """Values near those of the scenario, each another one; bounds of a law move apart."""
        found = {}
        for i, c in enumerate(keys):
            if c.choices:
                other = [x for x in c.choices if x != c.value]
                found[c.key] = other[i % len(other)]
                continue
            low, high = min(c.lows), max(c.highs)
            up = c.last == "high" or low == c.value
            part = 2**-6 * (0.3 + 0.3 * i / len(keys))
            found[c.key] = c.value + part * ((high if up else low) - c.value)
        return found

    def _writes(self, keys: Sequence[Slider]) -> list[Write]:
        """The numbers that are written for values of these keys."""
        values = self._inside(keys)
        plain = {c.key: values[c.key] for c in keys if not c.choices}
        writes = [] if not plain else self._of_numbers(plain, keys)
        for c in keys:
            if c.choices:
                writes += self._ratios(c, values[c.key])
        return writes

    def _of_numbers(self, values: Values, keys: Sequence[Slider]) -> list[Write]:
        try:
            changed = self._changed(self._made(values))
        except CosimError:
            return []
        given = {c.key: c.value for c in keys}
        at: dict[tuple[str, tuple[str | float, ...]], list[int]] = {}
        rules: dict[int, tuple[str, tuple[str | float, ...]]]
        rules = {_bits(v): ("value", (key,)) for key, v in values.items()}
        for low, high in self._bounds(keys):
            moved = [values.get(x, given.get(x, x)) for x in (high, low)]
            rules[_bits(moved[0] - moved[1])] = ("difference", (high, low))
        for place, word in changed.items():
            if word in rules:
                at.setdefault(rules[word], []).append(place)
        return [Write(rule, of, tuple(places)) for (rule, of), places in at.items()]

    def _bounds(self, keys: Sequence[Slider]) -> Iterable[tuple[Any, Any]]:
        """The bounds of each law, as keys, or numbers where they are fixed."""
        for pair in {c.pair for c in keys if c.pair}:
            mine = {c.last: c.key for c in keys if c.pair == pair}
            yield (
                mine.get("low", self._bound(pair, "low")),
                mine.get("high", self._bound(pair, "high")),
            )

    def _bound(self, pair: str, which: str) -> float:
        node: Any = self._document
        for part in pair.split("."):
            node = node[int(part)] if isinstance(node, list | tuple) else node[part]
        return number(node[which], "s", pair)

    def _ratios(self, c: Slider, value: float) -> list[Write]:
        """The tables whose draws a time between draws sets."""
        try:
            made = self._made({c.key: value})
        except CosimError:
            return []
        changed, writes = self._changed(made), list[Write]()
        first = self._base.places.get("tables", 0)
        for n, i in enumerate(self._base.drawn):
            table = self._plan.links[i].table
            assert isinstance(table, DrawnTable)
            places = [first + n * _TABLE.size + _TABLE.fields[name].offset for name in _RATIO]
            if not changed.keys() & set(places):
                continue
            period = table.rule.asks(table.grid, 0)[0]
            ratios = ((x, draws_per_sample(x, period)) for x in c.choices)
            choices = tuple((x, r.numerator, r.denominator) for x, r in ratios)
            writes.append(Write("ratio", (c.key,), tuple(places), choices))
        return writes

    def _changed(self, made: PlanImage) -> dict[int, int]:
        """Words of the image that differ from those of the scenario, by place."""
        if len(made.image.content()) != len(self._base.image.content()):
            return {}
        before, after = (np.frombuffer(x.image.content(), "<u8") for x in (self._base, made))
        return {8 * int(i): int(after[i]) for i in np.flatnonzero(before != after)}

    def _explained(self, writes: Sequence[Write], values: Values) -> bool:
        """True if the image with these values is that of the scenario with what is written."""
        try:
            made = self._made(values)
        except CosimError:
            return False
        if not self._same_structure(made) or made.image.inside != self._base.image.inside:
            return False
        content = np.frombuffer(self._base.image.content(), "<u8").copy()
        for write in writes:
            for place, word in self._words(write, values):
                content[place // 8] = word
        return made.image.content() == content.tobytes()

    def _words(self, write: Write, values: Values) -> Iterable[tuple[int, int]]:
        of = [x if isinstance(x, float) else values.get(x, self._values[x]) for x in write.of]
        if write.rule == "ratio":
            _, draws, samples = next(x for x in write.choices if x[0] == of[0])
            return zip(write.at, (draws, samples, samples), strict=True)
        value = of[0] if write.rule == "value" else of[0] - of[1]
        return ((place, _bits(value)) for place in write.at)


def _bits(x: float) -> int:
    return int(np.float64(x).view(np.uint64))
