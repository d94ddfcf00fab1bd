"""Fixed-step co-simulation of controllers and FMU plants over links with real latency.

The package handles ticks, ports, wires and links. It contains no robots, buses or networks:
models are in :mod:`fmus`, real time is in :mod:`bridge`. Importing it is cheap on purpose: the
names below are imported when they are used, and NumPy, Parquet and plotting with them
(docs/running.md)::

    run, open              run a scenario; open a run folder: a RunResult
    check                  the findings about a scenario
    compare, sweep         controllers side by side; a parameter study
    component              a component from a plain function
    RunResult              signals, metrics, tables for other libraries, pictures
    CosimError             the base of all errors
"""

from typing import Any

__version__ = "0.1.0"

#: Where each public name is defined.
_PUBLIC = {
    "CosimError": "cosim.base.errors",
    "RunResult": "cosim.api.results",
    "check": "cosim.api.running",
    "compare": "cosim.api.running",
    "component": "cosim.api.functions",
    "open": "cosim.api.running",
    "run": "cosim.api.running",
    "sweep": "cosim.api.running",
}
__all__ = [*_PUBLIC, "__version__"]


def __getattr__(name: str) -> Any:
    """A public name, imported when it is first used (PEP 562)."""
    if name not in _PUBLIC:
        raise AttributeError(f"module 'cosim' has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The public names, and no others."""
    return sorted(__all__)
