"""An ``.fmu`` as a Component: its library, its start, its clocks, its steps."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cosim.fmi.component import FmuComponent
    from cosim.fmi.file.description import Description, read, structural_sizes
    from cosim.fmi.options import FmuOptions

__all__ = ["Description", "FmuComponent", "FmuOptions", "read", "structural_sizes"]

#: Where each name is defined. The process of an isolated FMU needs none of them, nor NumPy.
_PUBLIC = {
    "FmuComponent": "component",
    "FmuOptions": "options",
    "Description": "file.description",
    "read": "file.description",
    "structural_sizes": "file.description",
}


def __getattr__(name: str) -> Any:
    """A name, imported when it is first used (PEP 562)."""
    if name not in _PUBLIC:
        raise AttributeError(f"module 'cosim.fmi' has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f"cosim.fmi.{_PUBLIC[name]}"), name)
    globals()[name] = value
    return value
