"""The scenario of a case: what is replaced, what stays, and what does not fit."""

from __future__ import annotations

from copy import deepcopy
from pathlib import Path
from typing import Any

import msgspec
import pytest

from cosim.base.errors import ScenarioError
from cosim.comparison.documents import Case, check, read_base, scenario
from cosim.comparison.variants_file import read
from tests.cosim.comparison.parts import CONFIG, SMALL, VARIANTS, loaded, push, written
from tests.fmus.bilateral import PAIRS, controls, links

PAPER = {"law": "uniform", "low": "300 ms", "high": "1200 ms", "hold": "30 ms"}


def plain(value: Any) -> Any:
    return msgspec.to_builtins(value, enc_hook=str)


def test_every_shipped_controller_is_wired_as_its_models_say() -> None:
    """The variants file is data of its own; the models' table of pairs says the same."""
    variants, base = loaded(VARIANTS)
    assert set(variants.controllers) == set(PAIRS)
    for name, pair in PAIRS.items():
        made = plain(scenario(base, variants, Case(name, "light", "paper", 0)))
        expected = controls(pair, ("master", "slave"), "5 ms")
        for component, spec in expected.items():
            found = made["components"][component]
            assert found["model"] == spec["model"]
            assert found["inputs"] == spec["inputs"]
            assert found["period"] == spec["period"]
            module = __import__(spec["model"], fromlist=["PRESETS"])
            presets = getattr(module, "PRESETS", {})
            values = {**presets.get(found["preset"], {}), **found["parameters"]}
            assert values == spec["parameters"], (name, component)
        wires = links(pair, ("master", "slave"), PAPER, semantics="signal")
        keys = ("from", "to", "channel", "delay", "semantics")
        found_links = [{key: x[key] for key in keys} for x in made["links"]]
        assert sorted(found_links, key=lambda x: x["to"]) == sorted(wires, key=lambda x: x["to"])


def test_what_is_not_replaced_stays() -> None:
    variants, base = loaded(VARIANTS)
    before = deepcopy(base.document)
    made = scenario(base, variants, Case("pd", "tight", "constant", 7))
    assert base.document == before
    assert made.run.seed == 7
    assert made.run.stop == "120 s"
    assert made.components["slave"].preset == "SL91"
    assert made.components["slave"].start["q"] == before["components"]["slave"]["start"]["q"]
    assert made.components["master"].inputs == {"tau": "master_control.tau"}
    assert not made.metrics
    assert not made.figures


def test_the_operators_values_replace_those_of_either_table() -> None:
    variants, base = loaded(VARIANTS, ["components.master.start.k_p=3.0"])
    made = scenario(base, variants, Case("pd", "tight", "constant", 0))
    master = made.components["master"]
    assert master.parameters["k_p"] == 200.0
    assert "k_p" not in master.start


def test_both_ways_are_one_channel_each_whatever_is_sent() -> None:
    variants, base = loaded(VARIANTS)
    for name in variants.controllers:
        made = scenario(base, variants, Case(name, "light", "paper", 0))
        channels = {(x.target.partition(".")[0], x.channel) for x in made.links}
        assert channels == {
            ("slave_control", "master->slave"),
            ("master_control", "slave->master"),
        }


def test_links_between_others_stay(tmp_path: Path) -> None:
    other = '[[links]]\nfrom = "master.q"\nto = "logger.u"\ndelay = { law = "constant", delay = 0 }'
    base_path = written(tmp_path, CONFIG.read_text(encoding="utf-8") + other, "base.toml")
    text = base_path.read_text(encoding="utf-8").replace(
        "[components.slave]", '[components.logger]\nmodel = "tests.x:y"\n[components.slave]'
    )
    base_path.write_text(text, encoding="utf-8")
    variants = read(VARIANTS)
    made = scenario(read_base(base_path, variants), variants, Case("p+d", "light", "paper", 0))
    assert [x.target for x in made.links] == [
        "logger.u", "master_control.q_j", "slave_control.q_j"
    ]  # fmt: skip


def test_files_are_relative_to_the_variants_file(tmp_path: Path) -> None:
    text = SMALL.replace('"fmus.models.pd"', '"own.fmu"').replace('preset = "PD(10,4)"\n', "")
    text = text.replace(
        'delay = { law = "constant", delay = "100 ms" }',
        'delay = { law = "trace", file = "t.csv" }',
    )
    variants, base = loaded(written(tmp_path, text))
    made = scenario(base, variants, Case("pd", "light", "constant", 0))
    assert made.components["master_control"].model == str(tmp_path / "own.fmu")
    assert made.links[0].delay["file"] == str(tmp_path / "t.csv")


def test_settings_of_the_file_come_before_those_of_the_user(tmp_path: Path) -> None:
    _, base = loaded(written(tmp_path, SMALL), ["run.stop=1 s"])
    assert base.document["run"]["step"] == "5 ms"
    assert base.document["run"]["stop"] == "1 s"
    assert base.seed == 0


# ---- what does not fit -------------------------------------------------------------------------

#: The first case is made of these three, and any of them may be what does not fit.
FIRST = "at controllers.pd, operators.light, links.constant: "
UNFIT = {
    "a role": (
        ('arm = "slave"', 'arm = "slve"'),
        "at roles.slave.arm: ",
        "no component 'slve'; did you mean 'slave'?",
    ),
    "a setting": (('"run.stop=2 s"', '"run"'), "at set[1]: ", "expected path=value"),
    "a model": (
        ("fmus.models.pd", "fmus.models.pdd"),
        f"{FIRST}does not fit into the scenario: ",
        "cannot import 'fmus.models.pdd'",
    ),
    "a preset": (("PD(10,4)", "PD(9,9)"), FIRST, "no preset 'PD(9,9)'"),
    "an input": (
        ('q_j = "arm.q", ', 'q_k = "arm.q", '),
        FIRST,
        "no input of master_control 'q_k'",
    ),
    "what is sent": (
        ('dq_j = "arm.dq"', 'dq_j = "arm.ddq"'),
        FIRST,
        "no output of slave 'ddq'",
    ),
    "a shape": (
        ('q_j = "arm.q"', 'q_j = "arm.q[0]"'),
        FIRST,
        "slave.q[0] has shape []",
    ),
    "an operator's value": (
        ("{ k_p = 10.0,", "{ k_q = 10.0,"),
        FIRST,
        "no parameter or start 'k_q'",
    ),
    "a second operator's value": (
        ("[links.constant]", "[operators.soft]\nmaster = { k_q = 1.0 }\n[links.constant]"),
        "at operators.soft: ",
        "no parameter or start 'k_q'",
    ),
    "a second link": (
        ("[columns.effort]", '[links.odd]\ndelay = { law = "sometimes" }\n[columns.effort]'),
        "at links.odd: ",
        "sometimes",
    ),
    "a column's signal": (
        ('of = ["master.tau_h"]', 'of = ["master.tau_x"]'),
        "at columns.effort: ",
        "with controllers.pd, operators.light, links.constant, no signal 'master.tau_x'; did you",
    ),
    "a second controller's signal": (
        ("[operators.light]", f"{push('push')}[operators.light]\n"),
        "at columns.extra: ",
        "with controllers.push, no signal 'master_control.q_j'",
    ),
}


@pytest.mark.parametrize("case", UNFIT)
def test_what_does_not_fit_is_told_before_anything_runs(case: str, tmp_path: Path) -> None:
    change, place, expected = UNFIT[case]
    text = SMALL.replace(*change, 1)
    if case == "a second controller's signal":
        text += '[columns.extra]\nkind = "norm"\nof = ["master_control.q_j"]\n'
    path = written(tmp_path, text)
    with pytest.raises(ScenarioError) as caught:
        variants, base = loaded(path)
        check(base, variants, variants.select((), (), ()))
    assert str(caught.value).startswith(f"{path} {place}")
    assert expected in str(caught.value)
