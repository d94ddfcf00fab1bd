"""``docs/evidence/bus-load.md`` agrees with the DBC files and the formulas."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

DOCS = Path(__file__).parents[3] / "docs" / "evidence"


def page() -> ModuleType:
    spec = importlib.util.spec_from_file_location("bus_load_page", DOCS / "bus_load.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_is_what_its_script_writes() -> None:
    written = (DOCS / "bus-load.md").read_text(encoding="utf-8")
    assert written == page().page(), "run: python docs/evidence/bus_load.py"


def test_loads_are_those_known_for_a_few_sets() -> None:
    """Seven joints at 1 kHz on 1 and 5 Mbit/s: four nodes fit, six do not."""
    module = page()
    shares = {
        n: module.bus_share(module.messages("link_fd", ("LINK",), n, 1e-3), module.FAST).worst
        for n in (2, 4, 6)
    }
    assert 0.38 < shares[2] < 0.42
    assert 0.70 < shares[4] < 0.77
    assert shares[6] > 1
