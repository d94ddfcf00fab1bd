"""A comparison's page has what it needs to run controllers again: bundles, values, reasons."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.base.errors import ScenarioError
from cosim.comparison import page
from cosim.comparison.comparison import compare
from cosim.comparison.documents import Case, scenario
from cosim.comparison.live_part import live_cases, section
from cosim.comparison.variants_file import of_laws, read
from cosim.engine.simulate import simulate
from cosim.live import digest
from cosim.record import Run
from tests.cosim.comparison.parts import SMALL, loaded, push, written
from tests.cosim.live.node import computed

#: One law whose ways differ, one that is drawn beforehand, and a controller in Python.
MORE = (
    SMALL
    + push("push")
    + """
[links.ways]
delay = { law = "constant", delay = "100 ms" }
[links.ways.slave]
delay = { law = "uniform", low = "20 ms", high = "60 ms", hold = "20 ms" }
[links.wifi]
delay = { law = "preset", name = "wifi5" }
semantics = "newest-stamp"
"""
)


def test_a_value_of_a_law_moves_all_links_that_are_made_from_it(tmp_path: Path) -> None:
    variants, base = loaded(written(tmp_path, MORE), ["run.stop=1"])
    found = live_cases(base, variants, variants.select(["pd"], ["light"], ["constant", "ways"]))
    assert found.moves[Case("pd", "light", "constant", 0)] == {
        "delay.delay": [f"links.{i}.delay.delay" for i in range(4)]
    }
    ways = found.moves[Case("pd", "light", "ways", 0)]
    assert ways.keys() == {
        "delay.delay", "slave.delay.low", "slave.delay.high", "slave.delay.hold"
    }  # fmt: skip
    assert all(len(keys) == 2 for keys in ways.values())
    slider = found.sliders["ways"]["slave.delay.high"]
    assert slider["value"] == 0.06 and slider["label"] == "greatest delay, to the slave"


def test_a_moved_law_is_that_of_the_option_set_bit_for_bit(tmp_path: Path) -> None:
    path = written(tmp_path, MORE)
    variants, base = loaded(path, ["run.stop=1"])
    case = Case("pd", "light", "ways", 0)
    found = live_cases(base, variants, variants.select(["pd"], ["light"], ["ways"]))
    moved = {"delay.delay": 0.15, "slave.delay.high": 0.085}
    keys = {key: x for name, x in moved.items() for key in found.moves[case][name]}
    laws, others = of_laws([*(f"links.ways.{k}={x}" for k, x in moved.items()), "links.0.name=x"])
    assert others == ["links.0.name=x"]
    changed = read(path, laws)
    assert changed.links["ways"].title == "ways; delay.delay=0.15; slave.delay.high=0.085"
    digests = []
    for i, known in enumerate((changed, variants)):
        simulate(scenario(base, known.with_columns(()), case), tmp_path / str(i))
        digests.append(digest(Run.open(tmp_path / str(i))))
    assert [x["digest"] for x in computed(found.bundles[case], [keys, {}])] == digests
    assert digests[0] != digests[1]


def test_an_unknown_law_is_refused_with_those_that_exist(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"no link 'nowhere'.*constant"):
        read(written(tmp_path, MORE), ["links.nowhere.delay.delay=0.1"])


def test_what_a_page_cannot_run_is_named_with_its_reason(tmp_path: Path) -> None:
    variants, base = loaded(written(tmp_path, MORE), ["run.stop=0.1"])
    chosen = variants.select(["pd", "push"], ["light"], ["constant", "wifi"])
    found = live_cases(base, variants, chosen)
    assert [case.name for case in found.bundles] == ["constant/light/pd-seed0"]
    reasons = {(case.controller, case.link): why for case, why in found.reasons.items()}
    assert "is a Python component" in reasons["push", "constant"]
    assert "drawn beforehand" in reasons["pd", "wifi"]
    outcomes = compare(base, variants, chosen, [0])
    part = section(outcomes, found, "cosim compare x --live")
    assert "What cannot be run here, and why" in part and "is a Python component" in part
    assert "<td>push</td><td>constant, wifi</td>" in part and "<td>pd</td><td>wifi</td>" in part
    assert next(o.digest for o in outcomes.outcomes if o.case.controller == "pd") in part
    with pytest.raises(ScenarioError, match=r"no page can run constant/light/push.* leave out"):
        live_cases(base, variants, variants.select(["push"], ["light"], ["constant"]))


def test_a_page_that_is_too_large_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    variants, base = loaded(written(tmp_path, MORE), ["run.stop=0.1"])
    outcomes = compare(base, variants, variants.select(["pd"], ["light"], ["constant"]), [0])
    page.write(outcomes, tmp_path, "cosim compare x", "<section></section>")
    monkeypatch.setattr(page, "MOST", 1000)
    with pytest.raises(page.PageSizeError, match=r"expected at most 0\.0 MB"):
        page.write(outcomes, tmp_path, "cosim compare x", "<section></section>")
    page.write(outcomes, tmp_path, "cosim compare x")
