"""The bridge's C library (``bridge/c``) as ctypes sees it: one module a header.

In come numbers and pointers, out come structs, arrays and counts as C has them. `journal` reads and
writes the files of rows that C fills. Nothing above C is decided here. A ctypes struct whose C name
a Python class bears as well ends in ``Struct``: `InletStruct` is C's ``inlet_t``.
"""

from bridge.native.library import library, library_path

__all__ = ["library", "library_path"]
