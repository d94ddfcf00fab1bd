"""FMUs of models outside ``fmus.models``: a Python class, or a C model declared in a file."""

from fmus.python.declared import load_module
from fmus.python.slave import build_class

__all__ = ["build_class", "load_module"]
