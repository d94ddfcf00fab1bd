"""``fmus build path/to/model.py``: a C model declared in a Python file at any place.

The function ``model()`` of the file returns a :class:`fmus.model.Model` with an absolute path of
its C source, such as ``str(Path(__file__).with_name("law.c"))``. The other layers are those of all
models of this project.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

from cosim.base.errors import ScenarioError


def load_module(path: Path) -> ModuleType:
    """The module of a file with a function ``model()``. Raises ScenarioError."""
    if not path.is_file():
        raise ScenarioError("no such file; expected a Python file that declares a model", str(path))
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise ScenarioError("is not a Python file; expected .py", str(path))
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise ScenarioError(f"{type(error).__name__}: {error}", str(path)) from error
    if not callable(vars(module).get("model")):
        raise ScenarioError("has no function model()", str(path))
    return module
