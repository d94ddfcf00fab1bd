"""The values of a scenario that a page can move, and the numbers of its image that they write."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from cosim.live.candidates import Fixed, Slider, slider_step
from cosim.live.plan_image import PlanImage


@dataclass(frozen=True)
class Write:
    """Numbers of the image that follow from keys: at each place of `at`.

    `rule`: "value" of the key; "difference" of two keys or numbers; "ratio": `at` are the places of
    numerator, denominator and the rest of a table, and `choices` has (value, numerator,
    denominator).
    """

    rule: str
    of: tuple[str | float, ...]
    at: tuple[int, ...]
    choices: tuple[tuple[float, int, int], ...] = ()


@dataclass
class Movable:
    """The keys of a scenario: those of sliders, with what they write, and the fixed ones.

    `image`: of the scenario, with room for all values. `added`: tables and lists that are not in
    the file, and how each is set (:func:`cosim.live.candidates.written_out`).
    """

    image: PlanImage
    keys: list[Slider] = field(default_factory=list)
    ends: dict[str, tuple[float, float]] = field(default_factory=dict)
    writes: list[Write] = field(default_factory=list)
    fixed: list[Fixed] = field(default_factory=list)
    added: dict[str, list[str]] = field(default_factory=dict)

    def facts(self) -> dict[str, Any]:
        """The entries of a bundle."""
        pairs: dict[str, dict[str, str]] = {c.pair: {} for c in self.keys if c.pair}
        for c in self.keys:
            if c.pair:
                pairs[c.pair][c.last] = c.key
        return {
            "keys": [self._key(c) for c in self.keys],
            "fixed": [{"key": x.key, "reason": x.reason} for x in self.fixed],
            "ordered": [pair for pair in pairs.values() if len(pair) == 2],
            "added": self.added,
            "writes": [
                {"rule": w.rule, "of": w.of, "at": w.at, "choices": w.choices} for w in self.writes
            ],
        }

    def _key(self, c: Slider) -> dict[str, Any]:
        low, high = self.ends[c.key]
        step = c.choices[0] if c.choices else slider_step(low, high)
        return {
            "key": c.key, "label": c.label, "about": c.about, "unit": c.unit, "group": c.group,
            "value": c.value, "low": low, "high": high, "step": step,
            "choices": c.choices,
        }  # fmt: skip
