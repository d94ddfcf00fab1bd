"""Texts as signals: each text or binary value of a run has a number, which signals carry."""

from __future__ import annotations


class NumberedTexts:
    """Texts (Binary: hexadecimal), each known by its number, in the order of their appearance.

    A number is a whole number from 0, which is the empty text. Nothing is forgotten in a run.
    """

    def __init__(self) -> None:
        self._texts = [""]
        self._numbers = {"": 0}

    def number(self, text: str) -> float:
        """The number of a text, without a unit."""
        found = self._numbers.get(text)
        if found is None:
            found = self._numbers[text] = len(self._texts)
            self._texts.append(text)
        return float(found)

    def text(self, number: float) -> str:
        """The text of a number (without a unit)."""
        return self._texts[int(number)]
