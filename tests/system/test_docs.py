"""docs/running.md and docs/links.md list every key; the examples of the pages run."""

from __future__ import annotations

import re
import tomllib
from importlib import import_module
from pathlib import Path
from runpy import run_path
from typing import get_args

import msgspec
import pytest

from cosim.links import spec as link_spec
from cosim.record import Run
from cosim.scenario import spec
from tests.cli.command import options_of
from tests.system.runs import ROOT, plan, run

RUNNING = (ROOT / "docs" / "running.md").read_text(encoding="utf-8")
LINKS = (ROOT / "docs" / "links.md").read_text(encoding="utf-8")
KEYS = RUNNING + LINKS
OWN = (ROOT / "docs" / "own-component.md").read_text(encoding="utf-8")

STRUCTS = [
    *(
        found
        for found in vars(spec).values()
        if isinstance(found, type)
        and issubclass(found, msgspec.Struct)
        and found.__module__ == spec.__name__
        and found is not spec.Scenario
    ),
    *(
        getattr(import_module(f"cosim.links.{module}"), name)
        for module, name in (
            place.split(":") for place in (*link_spec.LAWS.values(), *link_spec.LOSSES.values())
        )
    ),
]


def blocks(page: str, language: str) -> list[str]:
    """What stands between fences."""
    return re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)


def test_every_page_stands_in_a_group_of_the_site() -> None:
    site = run_path(str(ROOT / "docs" / "site.py"))
    assert site["misplaced"](site["written_pages"]()) == set()


@pytest.mark.parametrize("struct", STRUCTS, ids=lambda struct: struct.__name__)
def test_every_key_of_a_scenario_is_explained(struct: type[msgspec.Struct]) -> None:
    code = " ".join(re.findall(r"`[^`]*`", re.sub(r"```.*?```", "", KEYS, flags=re.DOTALL)))
    words = set(re.findall(r"[\w-]+", code))
    config = msgspec.structs.fields(struct)
    missing = {field.encode_name for field in config} - words
    assert not missing
    tag = struct.__struct_config__.tag
    assert tag is None or f"`{tag}`" in KEYS


def test_every_table_of_a_scenario_is_explained() -> None:
    fields = msgspec.structs.fields(spec.Scenario)
    tables = {field.encode_name for field in fields} - {"path", "title"}
    assert {"run", "components", "links", "topology", "metrics", "figures"} <= tables
    assert all(f"[{name}" in RUNNING for name in tables)


def test_every_semantics_is_explained() -> None:
    assert all(f"| `{name}` |" in LINKS for name in get_args(link_spec.Semantics))


def test_every_option_is_explained() -> None:
    options = options_of("run") - {"--plot", "--help"}
    assert {"--set", "--force", "--csv", "--no-plot", "--quiet", "--seed", "--out"} <= options
    assert all(f"`{option}" in RUNNING for option in options)


def test_the_scenario_of_the_page_runs(tmp_path: Path) -> None:
    (text,) = blocks(RUNNING, "toml")
    document = tomllib.loads(text)
    result = run(document, tmp_path / "run", path=tmp_path / "page.toml")
    assert result.array("arm.q")[0, 0] == pytest.approx(0.5235987755982988)


def test_the_component_of_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (code,), (text, *_) = blocks(OWN, "python"), blocks(OWN, "toml")
    (tmp_path / "springs.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    document = tomllib.loads(text)
    result = run(document, tmp_path / "run", path=tmp_path / "springs.toml")
    assert isinstance(result, Run)
    assert abs(result.array("arm.q")[-1]).max() < 2.0
    component = plan(document, tmp_path / "springs.toml").component("spring").component
    component.initialize({})
    component.set_state(component.get_state())
