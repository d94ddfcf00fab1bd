"""The bridge's C library (``bridge/c``) through ctypes: one module per header.

Input: numbers and pointers. Output: structs, arrays and counts as C has them. A build writes
`structs` and `enums` from the headers; the other modules give them to callers, by header, with the
functions. `journal` reads and writes the files of rows that C fills. This package makes no
decisions of its own. If a Python class has the same name as a C struct, the ctypes struct ends in
``Struct``: `InletStruct` is C's ``inlet_t``.
"""

from bridge.native.library import library, library_path

__all__ = ["library", "library_path"]
