"""Each wrong law is noticed by the claims that are there for it."""

from __future__ import annotations

from pathlib import Path

import pytest

from fmus.paper.claims import select
from tests.paper.mutants import WRONG, WrongLaw, changed, failing
from tests.tiers import first_fast

pytestmark = pytest.mark.usefixtures("compiled_once")


def test_every_wrong_law_changes_the_code_as_it_is() -> None:
    assert all(changed(law) for law in WRONG if law.file)


@pytest.mark.parametrize("law", first_fast(WRONG, 4), ids=lambda law: law.name)
def test_a_wrong_law_is_noticed(law: WrongLaw, tmp_path: Path) -> None:
    claims = select(law.noticed).claims
    assert {claim.name for claim in claims} == set(law.noticed)
    assert set(failing(law, claims, tmp_path)) == set(law.noticed)
