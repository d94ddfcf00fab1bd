"""Kernels and engine give the same bits whatever the compiler does; on other processors, see
``python -m tests.bits``, which `.ci/long bits` runs.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bits.programs import CONTRACTED, NATIVE, PAGES, Toolchain, digests, golden

SOME = ("planar2r", "teleoperation", "nuno_adaptive", "engine")


@pytest.mark.parametrize("toolchain", NATIVE[:3], ids=lambda t: t.name)
def test_a_level_of_optimisation_does_not_change_a_bit(
    tmp_path: Path, toolchain: Toolchain
) -> None:
    found = digests(toolchain, tmp_path, SOME)
    assert len(found) == len(SOME)
    assert found == {name: golden()[name] for name in found}


@pytest.mark.parametrize("toolchain", PAGES, ids=lambda t: t.name)
def test_webassembly_has_the_same_bits(tmp_path: Path, toolchain: Toolchain) -> None:
    found = digests(toolchain, tmp_path, SOME)
    assert found == {name: golden()[name] for name in SOME}


def test_contraction_does(tmp_path: Path) -> None:
    """The control: digests notice that a sum and a product are rounded once."""
    found = digests(CONTRACTED, tmp_path, SOME)
    assert all(found[name] != golden()[name] for name in found)
