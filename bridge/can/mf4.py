"""MF4 logs of python-can without their price for everything else.

python-can imports asammdf, and with it pandas and polars, wherever it finds it: half a second and
90 MiB for each process that opens a bus. Here that import waits until an MF4 log is opened.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import ModuleType
from typing import Any, cast

_MODULE = "can.io.mf4"


class _Loader(SourceFileLoader):
    """Runs python-can's module as if asammdf was missing, and again when it is first used."""

    def exec_module(self, module: ModuleType) -> None:
        modules = cast(dict[str, Any], sys.modules)
        if "asammdf" in modules:
            super().exec_module(module)
            return
        modules["asammdf"] = None
        try:
            super().exec_module(module)
        finally:
            del modules["asammdf"]
        kinds = {kind: kind.__init__ for kind in (module.MF4Reader, module.MF4Writer)}

        def begin(log: Any, *arguments: Any, **options: Any) -> None:
            """Open a log; functions of its class find asammdf in their module from here on."""
            for kind, own in kinds.items():
                kind.__init__ = own
            super(_Loader, self).exec_module(module)
            log.__init__(*arguments, **options)

        for kind in kinds:
            kind.__init__ = begin


class _Finder(MetaPathFinder):
    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name != _MODULE:
            return None
        found = PathFinder.find_spec(name, path, target)
        if found is not None and type(found.loader) is SourceFileLoader:
            found.loader = _Loader(found.loader.name, found.loader.path)
        return found


def import_late() -> None:
    """Let asammdf wait for the first MF4 log, where python-can is not imported yet."""
    if _MODULE not in sys.modules and not any(isinstance(x, _Finder) for x in sys.meta_path):
        sys.meta_path.insert(0, _Finder())
