"""Each change that is listed as one without a difference is a change of today's source."""

from __future__ import annotations

from tests.mutants.__main__ import ROOT
from tests.mutants.changes import equivalent
from tests.mutants.groups import GROUPS


def test_each_is_one_of_those_that_can_be_made() -> None:
    """Where a line was formatted or written anew, its reason has to be looked at again."""
    made = {mutant.key(ROOT) for group in GROUPS.values() for mutant in group.mutants(ROOT)}
    assert not [change for change in equivalent() if change not in made]
