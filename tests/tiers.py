"""Cases of a test that belong to the fast tests."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def first_fast(cases: Iterable[Any], n: int = 1) -> list[Any]:
    """The first `n` cases for every run of the tests, the others marked as slow.

    A tuple holds the values of several arguments.
    """
    several = [case if isinstance(case, tuple) else (case,) for case in cases]
    return [
        pytest.param(*values, marks=[pytest.mark.slow] if i >= n else [])
        for i, values in enumerate(several)
    ]
