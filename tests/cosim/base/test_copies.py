"""Copies of dataclasses and of structs: the same for both, also of one in the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import pytest

from cosim.base.convert import Struct
from cosim.base.copies import asdict, field_names, replace


class Pair(NamedTuple):
    a: int
    b: int


@dataclass(frozen=True, slots=True)
class Kept:
    x: int
    others: tuple[Any, ...] = ()


class Made(Struct, frozen=True):
    x: int
    others: tuple[Any, ...] = ()

    def __post_init__(self) -> None:
        if self.x < 0:
            raise ValueError("x")


@pytest.mark.parametrize("kind", [Kept, Made])
def test_a_copy_has_what_was_not_changed(kind: type[Kept]) -> None:
    one = kind(1, others=(2,))
    assert replace(one, x=3) == kind(3, (2,)) and one == kind(1, (2,))
    with pytest.raises(TypeError):
        replace(one, y=3)  # type: ignore[call-arg]


def test_a_copy_is_checked_as_what_it_is_made_of() -> None:
    with pytest.raises(ValueError, match="x"):
        replace(Made(1), x=-1)


@pytest.mark.parametrize("kind", [Kept, Made])
def test_the_fields_of_a_value_and_of_what_is_in_it(kind: type[Kept]) -> None:
    value = kind(1, ({"k": [Made(2), Kept(3)]}, Pair(4, 5)))
    plain = {"k": [{"x": 2, "others": ()}, {"x": 3, "others": ()}]}
    assert asdict(value) == {"x": 1, "others": (plain, Pair(4, 5))}


@pytest.mark.parametrize("of", [Kept, Made, Kept(1), Made(1)])
def test_names_of_fields(of: Any) -> None:
    assert field_names(of) == ("x", "others")


def test_another_type_has_no_fields() -> None:
    assert field_names(int) == () == field_names(3)
