"""The page of models that the site shows has every model and variable."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

from fmus.build.archive import SHIPPED, shipped_models

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module")
def writer() -> ModuleType:
    spec = importlib.util.spec_from_file_location("models_page", DOCS / "models.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_model_and_every_variable_is_on_it(writer: ModuleType) -> None:
    page = writer.page()
    assert re.findall(r"^\| \[(\w+)\]\(#", page, re.MULTILINE) == list(SHIPPED)
    for name in SHIPPED:
        assert f"\n## {name}\n" in page
    for model in shipped_models():
        assert model.identifier in page
        for v in model.variables:
            assert v.causality == "local" or f"| `{v.name}` |" in page
